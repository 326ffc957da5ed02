//! A run that cannot go on, or is stopped at an awkward moment, ends soon, with a message and the right exit code, and
//! can be continued.
//!
//! Method: real runs. A full disk is a limit on the size of the processes' files; a folder is moved or removed while
//! its run trains, or that of its bus; an actor that cannot work is a failing program in its place.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use bus::BusAddress;
use run::actors_wanted::ActorsWanted;
use system_tests::{Hashes, PATIENCE, Signal, TestRun, await_some, programs, send};

/// Much longer than a correct ending takes, and much shorter than a run that does not end.
const SOON: Duration = Duration::from_secs(30);

fn undisturbed() -> Hashes {
    TestRun::new(programs!()).finish(&[]).hashes()
}

#[test]
fn a_run_that_waits_for_the_disk_can_be_stopped() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    for process in run.processes() {
        process.limit_files(Some(0));
    }
    let said = || run.remarks().contains("no room on the disk").then_some(());
    await_some("a word of the full disk", PATIENCE, said);
    let begun = Instant::now();
    training.signal(Signal::Terminate);
    assert_eq!(training.end(), Some(1), "no checkpoint could be written: {}", run.remarks());
    assert!(begun.elapsed() < SOON, "{:?}", begun.elapsed());
    assert!(run.remarks().contains("learner ended"), "{}", run.remarks());
    assert_eq!(run.processes(), []);
    assert_eq!(run.shared_memory(), Vec::<String>::new());
    assert_eq!(run.resume().finish().hashes(), undisturbed());
}

#[test]
fn every_stop_of_a_run_has_its_exit_code() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=4000000"]);
    for (signal, checkpoint) in [(Signal::Terminate, 4), (Signal::Hangup, 8)] {
        training.await_checkpoint(checkpoint);
        training.signal(signal);
        assert_eq!(training.end(), Some(130), "{signal:?}");
        training = run.resume();
    }
    training.await_checkpoint(12);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
}

#[test]
fn a_run_started_by_nohup_survives_the_end_of_its_terminal() {
    let run = TestRun::new(programs!());
    let mut command = Command::new("nohup");
    command.arg(run.path("bin/goalward"));
    command.args(["train", "navigation", "--no-page", "--run", "run"]);
    command.args(["--set", "demonstrations.episodes=10", "--set", "evaluation.episodes=0"]);
    command.args(["--steps", "4000"]).current_dir(run.path("")).stdout(Stdio::null());
    let mut training = command.stderr(Stdio::null()).spawn().unwrap();
    let begun = || run.path("run/output").exists().then_some(());
    await_some("the begin of the run", PATIENCE, begun);
    send(training.id(), Signal::Hangup);
    assert_eq!(training.wait().unwrap().code(), Some(0));
    assert!(run.path("run/summary.json").exists());
}

#[test]
fn signals_in_quick_succession_are_one_request_and_later_ones_hurry() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=4000000"]);
    training.await_checkpoint(4);
    let learner = run.process("learner");
    learner.signal(Signal::Stop);
    training.signal(Signal::Terminate);
    training.signal(Signal::Hangup);
    await_some("the request", PATIENCE, || run.remarks().contains("stopping").then_some(()));
    learner.signal(Signal::Continue);
    assert_eq!(training.end(), Some(130));
    assert!(!run.remarks().contains("killing"), "{}", run.remarks());

    training = run.resume();
    training.await_checkpoint(8);
    run.process("learner").signal(Signal::Stop);
    let requests = || run.remarks().matches("stopping").count();
    let before = requests();
    training.signal(Signal::Terminate);
    await_some("the request", PATIENCE, || (requests() > before).then_some(()));
    // A signal within half a second would belong to the same request.
    thread::sleep(Duration::from_secs(1));
    training.signal(Signal::Terminate);
    assert_eq!(training.end(), Some(130));
    assert!(run.remarks().contains("killing the learner"), "{}", run.remarks());
}

#[test]
fn a_run_whose_folder_is_moved_says_so_and_goes_on_elsewhere() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    fs::rename(run.path("run"), run.path("elsewhere")).unwrap();
    let begun = Instant::now();
    assert_eq!(training.end(), Some(1));
    assert!(begun.elapsed() < SOON, "{:?}", begun.elapsed());
    assert!(!run.path("run").exists(), "expected nothing in its old place");
    let remarks = run.remarks();
    let said: Vec<_> = remarks.lines().filter(|line| line.contains("moved or removed")).collect();
    assert_eq!(said.len(), 1, "{remarks}");
    assert!(!remarks.contains("no room"), "{remarks}");
    fs::rename(run.path("elsewhere"), run.path("run")).unwrap();
    assert_eq!(run.processes(), []);
    assert_eq!(run.shared_memory(), Vec::<String>::new());
    assert_eq!(run.resume().finish().hashes(), undisturbed());
}

#[test]
fn a_run_whose_folder_is_removed_says_so() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=4000000"]);
    training.await_checkpoint(4);
    // Like `rm -r`, but renamed first, so that nobody writes to the folder while it is removed.
    fs::rename(run.path("run"), run.path("rubbish")).unwrap();
    assert_eq!(training.end(), Some(1));
    fs::remove_dir_all(run.path("rubbish")).unwrap();
    assert!(run.remarks().contains("moved or removed"), "{}", run.remarks());
    assert!(!run.path("run").exists());
}

#[test]
fn a_run_whose_bus_is_removed_as_at_a_logout_says_so_and_can_be_continued() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    let bus = BusAddress::of_run(run.folder().path()).unwrap();
    // Renamed first, so that nobody makes a file in it while it is removed.
    let rubbish = bus.root().with_extension("rubbish");
    fs::rename(bus.root(), &rubbish).unwrap();
    fs::remove_dir_all(rubbish).unwrap();
    let begun = Instant::now();
    assert_eq!(training.end(), Some(1));
    assert!(begun.elapsed() < SOON, "{:?}", begun.elapsed());
    assert!(run.remarks().contains("expected the folder of the bus"), "{}", run.remarks());
    assert_eq!(run.processes(), []);
    assert_eq!(run.shared_memory(), Vec::<String>::new());
    assert_eq!(run.resume().finish().hashes(), undisturbed());
}

/// Starts `goalward` with arguments that make it record demonstrations for minutes, and ends it with a signal. The
/// recorder must end, too, and leave nothing in `folder`.
fn expect_no_recorder(signal: Signal, arguments: &[&str], folder: &str) {
    let run = TestRun::new(programs!());
    let mut goalward = run.program("goalward");
    goalward.args(arguments).stdout(Stdio::null()).stderr(Stdio::null());
    let mut goalward = goalward.spawn().unwrap();
    let unfinished = || find(&run, folder, ".active");
    await_some("the recorder", PATIENCE, || unfinished().then_some(()));
    send(goalward.id(), signal);
    let ended = await_some("the end", SOON, || goalward.try_wait().unwrap());
    let expected = if signal == Signal::Kill { None } else { Some(130) };
    assert_eq!(ended.code(), expected, "{signal:?}");
    await_some("the end of the recorder", SOON, || (!unfinished()).then_some(()));
    assert!(!find(&run, folder, ".mcap"), "expected no demonstrations");
    let are_gone = || run.all_processes().is_empty().then_some(());
    await_some("the end of all processes", SOON, are_gone);
}

/// Whether a folder of the test has a file whose name has this ending.
fn find(run: &TestRun, folder: &str, ending: &str) -> bool {
    let mut entries = fs::read_dir(run.path(folder)).into_iter().flatten().flatten();
    entries.any(|entry| entry.file_name().to_string_lossy().ends_with(ending))
}

/// Recording this many demonstrations takes minutes on ANT REACH.
const ENDLESS: &str = "demonstrations.episodes=5000";

#[test]
fn a_recorder_ends_with_the_run_that_waits_for_it() {
    for signal in [Signal::Terminate, Signal::Hangup, Signal::Interrupt, Signal::Kill] {
        expect_no_recorder(
            signal,
            &["train", "ant-reach", "--run", "run", "--set", ENDLESS],
            "run",
        );
    }
}

#[test]
fn a_recorder_ends_with_demonstrate() {
    let arguments = ["demonstrate", "ant-reach", "--episodes", "5000", "--out", "d.mcap"];
    for signal in [Signal::Terminate, Signal::Kill] {
        expect_no_recorder(signal, &arguments, "");
    }
}

#[test]
fn a_recorder_ends_with_its_experiment() {
    let test = TestRun::new(programs!());
    let plan = format!(
        "title = \"A test\"\nseeds = [1]\nmethods = [\"goal-proximity\"]\n[[panel]]\nname = \"a\"\n\
         title = \"A\"\ntask = \"ant-reach\"\nset = [\"{ENDLESS}\"]\n"
    );
    fs::write(test.path("plan.toml"), plan).unwrap();
    for signal in [Signal::Terminate, Signal::Kill] {
        let mut experiment = test.program("goalward");
        experiment.args(["experiment", "plan.toml", "--out", "all"]).stdout(Stdio::null());
        let mut experiment = experiment.stderr(Stdio::null()).spawn().unwrap();
        let recorded = |ending: &str| find(&test, "all/demonstrations", ending);
        await_some("the recorder", PATIENCE, || recorded(".active").then_some(()));
        send(experiment.id(), signal);
        await_some("the end", SOON, || experiment.try_wait().unwrap());
        await_some("the end of the recorder", SOON, || (!recorded(".active")).then_some(()));
        assert!(!recorded(".mcap"));
    }
}

/// Replaces the actor's program with one that fails; running actors are not affected.
fn spoil_actor(run: &TestRun) {
    let actor = run.path("bin/goalward-actor");
    fs::remove_file(&actor).unwrap();
    fs::write(&actor, "#!/bin/sh\necho no room for me >&2\nexit 1\n").unwrap();
    fs::set_permissions(&actor, fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn more_actors_than_the_supervisor_can_have_are_refused() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=40000", "resources.actors=1"]);
    training.await_checkpoint(4);
    let wanted = || ActorsWanted::here(&run.folder()).count().unwrap();
    let programs = run.all_processes();
    let supervisor = programs.iter().find(|process| process.name == "goalward").unwrap();
    supervisor.limit_open_files(Some(190));
    let (took, said) = run.goalward(&["scale", "run", "--actors", "3"]);
    assert!(!took && said.contains("1 actors are wanted instead"), "{said}");
    assert!(run.remarks().contains("expected 196 open files"), "{}", run.remarks());
    assert_eq!(wanted(), Some(1));
    supervisor.limit_open_files(None);
    scale(&run, "3");
    run.process("actor-2");
    assert_eq!(wanted(), Some(3));
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
}

fn scale(run: &TestRun, actors: &str) {
    let mut scale = run.program("goalward");
    scale.args(["scale", "run", "--actors", actors]);
    assert!(scale.output().unwrap().status.success());
}

#[test]
fn actors_that_cannot_work_do_not_end_the_run() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=400000", "resources.actors=1"]);
    training.await_checkpoint(4);
    let (took, said) = run.goalward(&["scale", "run", "--actors", "0"]);
    assert!(!took && said.contains("`resources.actors` must be at least 1"), "{said}");
    spoil_actor(&run);
    scale(&run, "3");
    let said = || run.remarks().contains("the run continues without it").then_some(());
    await_some("a word of the actor that dies", PATIENCE, said);
    let (reached, _) = run.folder().newest_checkpoint().unwrap();
    training.await_checkpoint(reached + 8);

    // Without any working actor, the run cannot continue.
    run.process("actor-0").signal(Signal::Kill);
    assert_eq!(training.end(), Some(1));
    let remarks = run.remarks();
    assert!(remarks.contains("no other actor works"), "{remarks}");
    assert!(remarks.contains("no room for me"), "{remarks}");
    assert_eq!(run.shared_memory(), Vec::<String>::new());
}

#[test]
fn limits_that_are_too_low_are_said_before_the_run() {
    let run = TestRun::new(programs!());
    for (limit, part) in [("-v 1000000", "address space"), ("-n 100", "open files")] {
        let line = format!("ulimit {limit} && exec bin/goalward train --run run");
        let mut limited = Command::new("sh");
        limited.args(["-c", &line]).current_dir(run.path("")).stdin(Stdio::null());
        let output = limited.output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), said.lines().count()), (Some(1), 1), "{said}");
        assert!(said.contains(part) && said.contains("ulimit"), "{said}");
        assert!(!run.path("run").exists());
    }
}

#[test]
fn a_path_that_is_no_text_is_named_as_that() {
    use std::os::unix::ffi::OsStringExt;
    let run = TestRun::new(programs!());
    let folder = std::ffi::OsString::from_vec(b"r\xff".to_vec());
    let mut train = run.program("goalward");
    let output = train.args(["train", "--run"]).arg(folder).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{said}");
    assert!(said.contains("UTF-8"), "{said}");
}
