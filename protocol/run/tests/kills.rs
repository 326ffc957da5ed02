//! Kills every writer of a file that others rely on, at every system call that touches files. Afterwards the
//! old or the new file must exist as a whole, and leftovers must be gone once the writer has been called again.
//!
//! Method: this program starts itself as a writer of one thread and traces it (ptrace). It counts how often an
//! undisturbed writer enters or leaves such a system call, and then kills it at the first, the second and so on, each
//! time in a freshly prepared folder. Each [`Scene`] has a writer, what it finds, and what must hold afterwards.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::io::{Write, stderr, stdin};
use std::path::Path;
use std::process::{Command, Stdio};
use std::{env, fs};

use mcap_log::{
    Contents, FileReader, FileWriter, Kind, Metadata, Record, Topic, log_files, repair,
};
use nix::errno::Errno;
use nix::libc;
use nix::sys::ptrace;
use nix::sys::wait::{WaitStatus, waitpid};
use nix::unistd::Pid;
use prost::Message;
use protocol::durable;
use protocol::messages::Score;
use protocol::tensors::Tensors;
use run::folder::{LEARNER_FILE, POLICY_FILE, PROXIMITY_FILE, RunFolder};

/// Environment variable that names the scene to the writer.
const WRITER: &str = "GOALWARD_TEST_WRITER";

/// Environment variable that names the folder to the writer.
const FOLDER: &str = "GOALWARD_TEST_WRITER_FOLDER";

/// System calls that touch files.
const OF_FILES: [libc::c_long; 23] = [
    libc::SYS_open,
    libc::SYS_openat,
    libc::SYS_creat,
    libc::SYS_write,
    libc::SYS_pwrite64,
    libc::SYS_writev,
    libc::SYS_fsync,
    libc::SYS_fdatasync,
    libc::SYS_ftruncate,
    libc::SYS_flock,
    libc::SYS_rename,
    libc::SYS_renameat,
    libc::SYS_renameat2,
    libc::SYS_link,
    libc::SYS_linkat,
    libc::SYS_unlink,
    libc::SYS_unlinkat,
    libc::SYS_mkdir,
    libc::SYS_mkdirat,
    libc::SYS_rmdir,
    libc::SYS_copy_file_range,
    libc::SYS_fchmod,
    libc::SYS_close,
];

/// Number of messages in a log.
const MESSAGES: u64 = 40;

/// A writer, and what must hold when it is killed.
struct Scene {
    name: &'static str,
    /// Prepares what it finds.
    before: fn(&Path),
    /// The writer; called again, it cleans up and reaches the same end.
    write: fn(&Path),
    /// Checks what must hold at every moment.
    holds: fn(&Path),
    /// Names in the folder at the end.
    names: &'static [&'static str],
}

const SCENES: [Scene; 8] = [
    Scene {
        name: "a file that is there",
        before: |folder| fs::write(folder.join("summary.json"), "old").unwrap(),
        write: write_file,
        holds: |folder| assert!(["old", "new"].contains(&text(folder).unwrap().as_str())),
        names: &["summary.json"],
    },
    Scene {
        name: "a file that is not there",
        before: |_| {},
        write: write_file,
        holds: |folder| assert!([None, Some("new")].contains(&text(folder).as_deref())),
        names: &["summary.json"],
    },
    Scene {
        name: "a checkpoint",
        before: |folder| checkpoint(&RunFolder::new(folder), 1),
        write: |folder| checkpoint(&RunFolder::new(folder), 2),
        holds: checkpoints_are_whole,
        names: &["checkpoints"],
    },
    Scene {
        name: "a log file",
        before: |_| {},
        write: record,
        holds: |folder| {
            read(folder);
        },
        names: &["trajectories-00000.mcap"],
    },
    Scene {
        name: "repair of a file that was not sealed",
        before: |folder| abandon(folder, MESSAGES),
        write: repair_all,
        holds: |folder| assert_eq!(read(folder), MESSAGES),
        names: &["trajectories-00000.mcap"],
    },
    Scene {
        name: "repair of a damaged file that was not sealed",
        before: |folder| spoil(folder, "trajectories-00000.mcap.active"),
        write: repair_all,
        holds: nothing_more_is_lost,
        names: &["trajectories-00000.mcap", "trajectories-00000.mcap.active.damaged"],
    },
    Scene {
        name: "repair of a damaged file that was sealed",
        before: |folder| {
            spoil(folder, "trajectories-00000.mcap.active");
            let [from, to] = ["mcap.active", "mcap"]
                .map(|ending| folder.join("trajectories-00000").with_extension(ending));
            fs::rename(from, to).unwrap();
        },
        write: |folder| drop(repair(&folder.join("trajectories-00000.mcap")).unwrap()),
        holds: nothing_more_is_lost,
        names: &["trajectories-00000.mcap", "trajectories-00000.mcap.damaged"],
    },
    Scene {
        name: "a recording in the place of an older one",
        before: |folder| demonstrate(folder, 3),
        write: |folder| demonstrate(folder, 5),
        holds: |folder| {
            let mut reader = FileReader::open(&folder.join("demonstrations.mcap")).unwrap();
            assert!([3, 5].contains(&reader.by_ref().count()));
            assert!(!reader.ending().unwrap().lost());
        },
        names: &["demonstrations.mcap"],
    },
];

fn write_file(folder: &Path) {
    durable::clear(folder).unwrap();
    durable::write(&folder.join("summary.json"), "new").unwrap();
}

fn text(folder: &Path) -> Option<String> {
    fs::read_to_string(folder.join("summary.json")).ok()
}

/// Writes a checkpoint as the learner does, and removes the older ones.
fn checkpoint(run: &RunFolder, iteration: u64) {
    durable::clear(&run.checkpoints()).unwrap();
    let folder = run.checkpoint_folder(iteration);
    if !folder.exists() {
        let unfinished = durable::unfinished(&folder);
        durable::create_folder(&unfinished).unwrap();
        let mut tensors = Tensors::default();
        tensors.put_u64("iteration", [iteration]);
        for file in [POLICY_FILE, LEARNER_FILE, PROXIMITY_FILE] {
            tensors.save(&unfinished.join(file)).unwrap();
        }
        durable::rename(&unfinished, &folder).unwrap();
    }
    for (_, old) in run.checkpoint_folders().into_iter().filter(|(number, _)| *number < iteration) {
        durable::remove_folder(&old).unwrap();
    }
}

fn checkpoints_are_whole(folder: &Path) {
    let folders = RunFolder::new(folder).checkpoint_folders();
    assert!(!folders.is_empty());
    for (iteration, folder) in folders {
        for file in [POLICY_FILE, LEARNER_FILE, PROXIMITY_FILE] {
            let tensors = Tensors::load(&folder.join(file)).unwrap();
            assert_eq!(tensors.u64("iteration"), Ok(vec![iteration]));
        }
    }
}

fn writer(path: &Path, kind: Kind) -> FileWriter {
    let metadata = Metadata::new(kind, "navigation", 1);
    FileWriter::create_anew(path, &metadata, Contents::Trajectories.topics()).unwrap()
}

/// Appends messages, each in a chunk of its own.
fn append(writer: &mut FileWriter, messages: u64) {
    for lane in 0..messages {
        let score = Score { lane, ..Score::default() };
        writer.message(Topic::Score, lane, &score.encode_to_vec()).unwrap();
        if lane % 10 == 0 {
            writer.flush().unwrap();
        }
    }
}

/// Records a log, or seals the file that a killed writer left.
fn record(folder: &Path) {
    if log_files(folder).unwrap().is_empty() {
        let mut writer = writer(&folder.join("trajectories-00000.mcap"), Kind::Run);
        append(&mut writer, MESSAGES);
        writer.seal().unwrap();
    }
    repair_all(folder);
    // A file whose beginning is missing is not a log; the repair sets it aside.
    fs::remove_file(folder.join("trajectories-00000.mcap.active.damaged")).ok();
    if log_files(folder).unwrap().is_empty() {
        record(folder);
    }
}

fn abandon(folder: &Path, messages: u64) {
    append(&mut writer(&folder.join("trajectories-00000.mcap"), Kind::Run), messages);
}

/// Writes an unsealed log with a damaged chunk.
fn spoil(folder: &Path, name: &str) {
    abandon(folder, MESSAGES);
    let path = folder.join(name);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.windows(4).rposition(|bytes| bytes == b"zstd").unwrap();
    bytes[middle + 20] ^= 1;
    fs::write(path, bytes).unwrap();
}

fn repair_all(folder: &Path) {
    for file in log_files(folder).unwrap().into_iter().filter(|file| file.active) {
        repair(&file.path).unwrap();
    }
}

/// Returns the largest number of messages in a file of a log; each file must have the first ones, in order.
fn read(folder: &Path) -> u64 {
    let mut most = 0;
    for file in log_files(folder).unwrap() {
        let Ok(reader) = FileReader::open(&file.path) else {
            assert!(file.active, "a sealed file says what it is");
            continue;
        };
        let lanes = reader.map(|entry| match entry.unwrap().record {
            Record::Score(score) => score.lane,
            other => panic!("{other:?}"),
        });
        let lanes: Vec<u64> = lanes.collect();
        assert!(lanes.iter().copied().eq(0..lanes.len() as u64), "{lanes:?}");
        most = most.max(lanes.len() as u64);
    }
    most
}

/// Checks that readable messages stay readable, and that the damaged original exists under some name.
fn nothing_more_is_lost(folder: &Path) {
    let expected = tempfile::tempdir().unwrap();
    spoil(expected.path(), "trajectories-00000.mcap.active");
    assert_eq!(read(folder), read(expected.path()));
    let original = fs::read(expected.path().join("trajectories-00000.mcap.active")).unwrap();
    let kept = fs::read_dir(folder).unwrap().map(|entry| fs::read(entry.unwrap().path()).unwrap());
    assert!(kept.into_iter().any(|bytes| bytes == original), "the original is kept");
}

fn demonstrate(folder: &Path, episodes: u64) {
    let mut writer = writer(&folder.join("demonstrations.mcap"), Kind::Demonstrations);
    append(&mut writer, episodes);
    writer.seal().unwrap();
}

/// Starts a writer and traces it to its end, or kills it at the stop `kill_at`. Returns the number
/// of stops, or `None` if this machine does not allow tracing.
fn follow(scene: &Scene, folder: &Path, kill_at: Option<usize>) -> Option<usize> {
    let mut child = Command::new(env::current_exe().unwrap())
        .env(WRITER, scene.name)
        .env(FOLDER, folder)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    let id = Pid::from_raw(child.id() as i32);
    let options = ptrace::Options::PTRACE_O_TRACESYSGOOD | ptrace::Options::PTRACE_O_EXITKILL;
    match ptrace::seize(id, options) {
        Err(Errno::EPERM | Errno::ENOSYS) => {
            child.kill().unwrap();
            child.wait().unwrap();
            return None;
        }
        seized => seized.unwrap(),
    }
    ptrace::interrupt(id).unwrap();
    child.stdin.take().unwrap().write_all(b"\n").unwrap();
    let mut stops = 0;
    loop {
        match waitpid(id, None).unwrap() {
            WaitStatus::Exited(_, code) => {
                // The number of its last stops varies: reading a folder to its end takes one call or two.
                assert_eq!(code, 0, "{}", scene.name);
                return Some(stops);
            }
            WaitStatus::Signaled(..) => return Some(stops),
            WaitStatus::PtraceSyscall(_) => {
                let call = ptrace::getregs(id).unwrap().orig_rax as libc::c_long;
                if OF_FILES.contains(&call) {
                    if kill_at == Some(stops) {
                        child.kill().unwrap();
                        continue;
                    }
                    stops += 1;
                }
            }
            WaitStatus::PtraceEvent(..) => {}
            other => panic!("{}: {other:?}", scene.name),
        }
        ptrace::syscall(id, None).unwrap();
    }
}

/// Kills the writer of a scene at every stop. Returns the number of kills, or `None` if it cannot be traced.
fn play(scene: &Scene) -> Option<usize> {
    let laid_out = || {
        let folder = tempfile::tempdir().unwrap();
        (scene.before)(folder.path());
        folder
    };
    let names = |folder: &Path| {
        let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = names.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    };
    let folder = laid_out();
    let stops = follow(scene, folder.path(), None)?;
    (scene.holds)(folder.path());
    assert_eq!(names(folder.path()), scene.names, "{}", scene.name);
    assert!(stops > 10, "{}: {stops}", scene.name);
    for stop in 0..stops {
        let folder = laid_out();
        follow(scene, folder.path(), Some(stop));
        let held = std::panic::catch_unwind(|| {
            (scene.holds)(folder.path());
            (scene.write)(folder.path());
            (scene.holds)(folder.path());
            assert_eq!(names(folder.path()), scene.names);
        });
        assert!(held.is_ok(), "{}: killed at stop {stop} of {stops}", scene.name);
    }
    Some(stops)
}

fn main() {
    if let Ok(name) = env::var(WRITER) {
        let scene = SCENES.iter().find(|scene| scene.name == name).unwrap();
        stdin().read_line(&mut String::new()).unwrap();
        return (scene.write)(Path::new(&env::var_os(FOLDER).unwrap()));
    }
    for scene in SCENES {
        let Some(kills) = play(&scene) else {
            writeln!(stderr(), "skipped: no process may be traced here").ok();
            return;
        };
        writeln!(stderr(), "{}: killed at {kills} places", scene.name).ok();
    }
}
