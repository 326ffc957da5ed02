//! What the bus guarantees when processes are killed (SIGKILL): the death is noticed and cleaned up, nobody stays
//! blocked, and nothing is left behind.

use std::fs::OpenOptions;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use bus::{Bus, BusAddress, Role, TRAJECTORY_BUFFER, TrajectoryHeader};

use super::{LONG, SHORT, WATCHDOG, open, patience, until, watched};

/// Environment variables that tell a child process its role and the folder of its run.
const CHILD_ROLE: &str = "GOALWARD_TEST_CHILD";
const CHILD_RUN: &str = "GOALWARD_TEST_RUN";

/// A child process, killed (SIGKILL) at the latest when it goes out of scope.
struct Process(Child);

impl Process {
    /// Starts this test binary as `role`, and waits until it says that it is ready.
    fn start(role: &str, run: &Path) -> Self {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "processes::child_process", "--nocapture"])
            .env(CHILD_ROLE, role)
            .env(CHILD_RUN, run)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let ready = output.lines().any(|line| line.unwrap().contains("ready"));
        assert!(ready, "the child ended early");
        Process(child)
    }

    fn signal(&self, signal: &str) {
        let line = format!("kill -{signal} {}", self.0.id());
        assert!(Command::new("sh").args(["-c", &line]).status().unwrap().success());
    }

    fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// Not a test itself: the body of the processes that [`Process::start`] starts.
#[test]
#[expect(clippy::print_stdout, reason = "the parent waits for this line")]
fn child_process() {
    let Ok(role) = std::env::var(CHILD_ROLE) else { return };
    let run = std::env::var(CHILD_RUN).unwrap();
    let bus = Bus::open(&BusAddress::of_run(run.as_ref()).unwrap(), &role).unwrap();
    match role.as_str() {
        "stuck-reader" => {
            let subscriber = bus.trajectory_subscriber().unwrap();
            until(|| subscriber.receive().unwrap());
            println!("ready");
            thread::sleep(WATCHDOG);
        }
        "tool" | "learner" => {
            let learns = role == "learner";
            let role = if learns { Role::Learner } else { Role::Supervisor };
            let _bell = bus.doorbell(role).unwrap();
            let subscriber =
                if learns { bus.learning_subscriber() } else { bus.trajectory_subscriber() };
            let subscriber = subscriber.unwrap();
            until(|| subscriber.receive().unwrap());
            println!("ready");
            loop {
                until(|| subscriber.receive().unwrap());
            }
        }
        "stuck-server" => {
            let server = bus.lease_server().unwrap();
            println!("ready");
            let _request = until(|| server.receive().unwrap());
            thread::sleep(WATCHDOG);
        }
        other => panic!("no role {other}"),
    }
}

fn alive_is(bus: &Bus, names: &[&str]) -> Option<()> {
    (bus.alive().unwrap() == names).then_some(())
}

#[test]
fn killed_reader_is_cleaned_away_and_publishing_goes_on() {
    watched(|_| {
        let run = tempfile::tempdir().unwrap();
        let address = BusAddress::for_start(run.path()).unwrap();
        let bus = open(&address, "actor-0");
        let publisher = bus.trajectory_publisher(LONG).unwrap();
        thread::scope(|scope| {
            let child = scope.spawn(|| Process::start("stuck-reader", run.path()));
            while !child.is_finished() {
                publisher.publish(b"first", TrajectoryHeader::default()).unwrap();
                thread::sleep(Duration::from_millis(20));
            }
            let mut reader = child.join().unwrap();
            assert!(address.is_anyone_alive().unwrap());
            assert_eq!(bus.alive().unwrap(), ["actor-0", "stuck-reader"]);
            reader.kill();
        });
        until(|| alive_is(&bus, &["actor-0"]));
        assert_eq!(publisher.reader_count(), 1, "nobody has cleaned up yet");
        let start = Instant::now();
        for _ in 0..TRAJECTORY_BUFFER + 10 {
            publisher.publish(&[0; 4_000], TrajectoryHeader::default()).unwrap();
        }
        assert!(start.elapsed() < Duration::from_secs(5), "blocked for {:?}", start.elapsed());
        assert_eq!(publisher.reader_count(), 0);
        assert_eq!(publisher.publish(b"last", TrajectoryHeader::default()).unwrap(), 0);
        drop((publisher, bus));
        address.remove().unwrap();
    });
}

/// Runs `body` while a process that reads a rollout's trajectories is held (SIGSTOP).
fn with_held_reader(role: &str, body: fn(&Bus, &mut dyn FnMut() -> usize, &Process)) {
    let run = tempfile::tempdir().unwrap();
    let address = BusAddress::for_start(run.path()).unwrap();
    let bus = open(&address, "actor-0");
    let publisher = bus.rollout_publisher(HELD_PATIENCE).unwrap();
    let mut publish = || publisher.publish(&[0; 4_000], TrajectoryHeader::default()).unwrap();
    let mut reader = thread::scope(|scope| {
        let child = scope.spawn(|| Process::start(role, run.path()));
        while !child.is_finished() {
            publish();
            thread::sleep(Duration::from_millis(20));
        }
        child.join().unwrap()
    });
    reader.signal("STOP");
    body(&bus, &mut publish, &reader);
    reader.kill();
    until(|| alive_is(&bus, &["actor-0"]));
    drop((publisher, bus));
    address.remove().unwrap();
}

/// How long the publisher waits for a reader that learns.
const HELD_PATIENCE: Duration = Duration::from_secs(4);

#[test]
fn a_held_tool_holds_up_nobody() {
    watched(|_| {
        with_held_reader("tool", |bus, publish, _| {
            let learner = bus.learning_subscriber().unwrap();
            let begun = Instant::now();
            let mut read = 0;
            for _ in 0..2 * TRAJECTORY_BUFFER {
                publish();
                read += usize::from(learner.receive().unwrap().is_some());
            }
            // This is less than one wait for the held reader.
            assert!(begun.elapsed() < HELD_PATIENCE, "blocked for {:?}", begun.elapsed());
            assert_eq!(read, 2 * TRAJECTORY_BUFFER, "the others miss nothing");
        });
    });
}

#[test]
fn a_held_learner_is_waited_for_once_until_it_reads_again() {
    watched(|_| {
        with_held_reader("learner", |_, publish, reader| {
            let begun = Instant::now();
            for _ in 0..2 * TRAJECTORY_BUFFER {
                publish();
            }
            let blocked = begun.elapsed();
            assert!(blocked >= HELD_PATIENCE && blocked < 4 * HELD_PATIENCE, "{blocked:?}");
            assert_eq!(publish(), 0, "its queue is full");
            reader.signal("CONT");
            until(|| (publish() == 1).then_some(()));
        });
    });
}

#[test]
fn killed_server_is_noticed_once_cleaned_away() {
    watched(|_| {
        let run = tempfile::tempdir().unwrap();
        let address = BusAddress::for_start(run.path()).unwrap();
        let bus = open(&address, "actor-0");
        let doorbell = bus.doorbell(Role::Actors).unwrap();
        let client = bus.lease_client(&doorbell).unwrap();
        let mut server = Process::start("stuck-server", run.path());
        let pending = client.send(b"?").unwrap();
        thread::sleep(SHORT);
        server.kill();
        assert!(pending.poll().unwrap().is_none(), "a death is not noticed by itself");
        until(|| (bus.clean_up() == 1).then_some(()));
        assert!(pending.poll().unwrap_err().to_string().contains("gone"));
        assert_eq!(bus.clean_up(), 0);

        // `ask` notices the death by itself, and the next server answers.
        let mut server = Process::start("stuck-server", run.path());
        thread::scope(|scope| {
            scope.spawn(|| {
                thread::sleep(Duration::from_millis(300));
                server.kill();
                let learner = open(&address, "learner");
                let server = learner.lease_server().unwrap();
                until(|| server.receive().unwrap()).reply(b"next").unwrap();
                thread::sleep(Duration::from_millis(200));
            });
            let answer = client.ask(b"?", &doorbell, Some, patience(&bus, LONG)).unwrap();
            assert_eq!(answer, b"next"[..]);
        });
        drop((pending, client, doorbell, bus));
        address.remove().unwrap();
    });
}

/// Starts the only server of leases, kills it, and leaves its objects as if it had died between creating them and
/// setting their size.
fn leave_objects_without_a_size(address: &BusAddress, run: &Path) {
    Process::start("stuck-server", run).kill();
    let dynamic =
        left_in_shared_memory(address).into_iter().filter(|name| name.ends_with("dynamic"));
    let sizeless = dynamic.map(|name| {
        let file = OpenOptions::new().write(true).open(Path::new("/dev/shm").join(name));
        file.unwrap().set_len(0).unwrap();
    });
    assert_ne!(sizeless.count(), 0);
}

#[test]
fn an_object_without_a_size_holds_up_no_start() {
    watched(|_| {
        let run = tempfile::tempdir().unwrap();
        let address = BusAddress::for_start(run.path()).unwrap();
        leave_objects_without_a_size(&address, run.path());
        address.remove().unwrap();
        assert_eq!(left_in_shared_memory(&address), [] as [String; 0]);
    });
}

#[test]
fn an_object_without_a_size_holds_up_no_living_process() {
    watched(|_| {
        let run = tempfile::tempdir().unwrap();
        let address = BusAddress::for_start(run.path()).unwrap();
        let supervisor = open(&address, "supervisor");
        leave_objects_without_a_size(&address, run.path());
        thread::scope(|scope| {
            // By itself, it would wait for the size forever.
            let server = scope.spawn(|| {
                let learner = open(&address, "learner");
                learner.lease_server().map(drop)
            });
            until(|| {
                supervisor.clean_up();
                server.is_finished().then_some(())
            });
            server.join().unwrap().unwrap();
        });
        until(|| alive_is(&supervisor, &["supervisor"]));
        drop(supervisor);
        address.remove().unwrap();
    });
}

fn left_in_shared_memory(address: &BusAddress) -> Vec<String> {
    let entries = std::fs::read_dir("/dev/shm").unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.starts_with(address.prefix())).collect()
}

#[test]
fn removal_leaves_nothing_and_spares_others() {
    watched(|other_address| {
        let other = open(other_address, "other run");
        let other_server = other.score_server().unwrap();
        let run = tempfile::tempdir().unwrap();
        let address = BusAddress::for_start(run.path()).unwrap();
        let mut reader = {
            let bus = open(&address, "actor-0");
            let publisher = bus.trajectory_publisher(LONG).unwrap();
            thread::scope(|scope| {
                let child = scope.spawn(|| Process::start("stuck-reader", run.path()));
                while !child.is_finished() {
                    publisher.publish(&[0; 100_000], TrajectoryHeader::default()).unwrap();
                    thread::sleep(Duration::from_millis(20));
                }
                child.join().unwrap()
            })
        };
        let error = address.remove().unwrap_err().to_string();
        assert!(error.contains("still alive: stuck-reader"), "{error}");
        assert!(!left_in_shared_memory(&address).is_empty() && address.root().exists());
        reader.kill();
        until(|| (!address.is_anyone_alive().unwrap()).then_some(()));
        address.remove().unwrap();
        assert_eq!(left_in_shared_memory(&address), [] as [String; 0]);
        assert!(!address.root().exists());
        address.remove().unwrap();
        assert_eq!(other.alive().unwrap(), ["other run"]);
        assert!(other_server.receive().unwrap().is_none());
    });
}
