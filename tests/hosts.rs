//! A run with actors on several machines: hosts come and go, links fail, and the weights are those of a run without
//! hosts.
//!
//! Method: another machine knows only a run's key and address, so a `goalward join` on the same machine can stand in
//! for one: it has its own folder and bus. If the test may make network namespaces, the host runs in one, and a cut
//! pulls its cable. The link goes through a relay that the test makes slow and lossy; without namespaces, the relay
//! also makes the cuts.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs::{self, File, Permissions};
use std::net::{IpAddr, Ipv4Addr, TcpListener};
use std::os::unix::fs::PermissionsExt;
use std::process::{Child, Command};
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::{Duration, SystemTime};

use bus::BusAddress;
use protocol::seed::{Purpose, Stream, stream};
use rand::RngExt;
use system_tests::{
    Hashes, Namespace, PATIENCE, Relay, Signal, TestRun, Training, await_some, programs, send,
};

/// Makes the run long enough for hosts to come and go.
const STEPS: &str = "steps=60000";

/// Seeds of the quick test's schedules.
const QUICK: std::ops::Range<u64> = 0..2;

/// Returns an address on which nobody listens.
fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

/// The hashes of the run without hosts.
fn alone() -> &'static Hashes {
    static HASHES: OnceLock<Hashes> = OnceLock::new();
    HASHES.get_or_init(|| TestRun::new(programs!()).finish(&[STEPS]).hashes())
}

/// Starts a run that accepts hosts, with one actor of its own.
fn listen<'a>(run: &'a TestRun, address: &str, audit: f64) -> Training<'a> {
    listen_with(run, address, audit, "resources.actors=1")
}

/// Starts a run that accepts hosts; `actors` is the setting for its own actors.
fn listen_with<'a>(run: &'a TestRun, address: &str, audit: f64, actors: &str) -> Training<'a> {
    let training = run.train_listening(address, audit, &[STEPS, actors]);
    let key = run.folder().path().join("join.toml");
    await_some("the key of the run", PATIENCE, || key.exists().then_some(()));
    training
}

/// Returns the command of a host with two actors that joins a run at `address`; its programs and folder are those of
/// `programs`.
fn joining(programs: &TestRun, run: &TestRun, name: &str, address: &str) -> Command {
    let mut command = programs.program("goalward");
    command.args(["join", address, "--actors", "2", "--name", name]);
    command.env("TMPDIR", programs.path(""));
    command.arg("--run").arg(run.folder().path());
    command
}

fn start(run: &TestRun, name: &str, mut command: Command) -> Child {
    let output = |suffix| File::create(run.path(&format!("{name}.{suffix}"))).unwrap();
    command.stdout(output("out")).stderr(output("err")).spawn().unwrap()
}

fn join(run: &TestRun, name: &str, address: &str) -> Child {
    start(run, name, joining(run, run, name, address))
}

/// Waits until an actor of the host is on the run's bus, which it joins with its first request for leases.
fn await_actor_of(run: &TestRun, host: &str) {
    let address = BusAddress::of_run(run.folder().path()).unwrap();
    let is_one = |name: &str| name.starts_with("actor") && name.ends_with(host);
    let found = || address.members().unwrap().iter().any(|one| one.lives && is_one(&one.name));
    await_some(&format!("an actor of {host}"), PATIENCE, || found().then_some(()));
}

#[test]
fn hosts_come_and_go_and_the_weights_are_the_same() {
    let (run, address) = (TestRun::new(programs!()), free_address());
    let mut training = listen(&run, &address, 0.1);
    let mut first = join(&run, "first", &address);
    await_actor_of(&run, "@first");
    let mut second = join(&run, "second", &address);
    await_actor_of(&run, "@second");
    await_some("both in the run's status", PATIENCE, || {
        let (_, said) = run.goalward(&["status", "run"]);
        let is_there = |host: &str| said.contains(&format!("{host}, actors: 2, "));
        (is_there("first") && is_there("second") && said.contains(" ms away")).then_some(())
    });
    let mut twin = start(&run, "twin", joining(&run, &run, "second", &address));
    await_some("the name that the twin got", PATIENCE, || {
        let said = fs::read_to_string(run.path("twin.err")).unwrap();
        said.contains("goalward: second-2 joined the run\n").then_some(())
    });
    // The host's other processes notice this, and end.
    send(first.id(), Signal::Kill);
    first.wait().unwrap();
    run.process("gateway").signal(Signal::Kill);
    await_some("a word about the gateway", PATIENCE, || {
        run.remarks().contains("gateway ended").then_some(())
    });
    await_actor_of(&run, "@second");
    training.expect_going_on("a host came back");
    assert_eq!(training.finish().hashes(), *alone());
    assert!(second.wait().unwrap().success() && twin.wait().unwrap().success());
    let said = fs::read_to_string(run.path("second.err")).unwrap();
    assert!(said.ends_with("goalward: the training has ended\n"), "{said}");
    assert_eq!(run.shared_memory(), Vec::<String>::new());
    let left = run.joined_folders();
    assert_eq!(left.len(), 1, "expected what the first has left alone, found {left:?}");
    File::open(&left[0]).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
    await_some("a joining that sweeps", PATIENCE, || {
        let another = joining(&run, &run, "third", &address).output().unwrap();
        assert!(!another.status.success(), "expected that the run is over");
        run.joined_folders().is_empty().then_some(())
    });
}

#[test]
fn a_host_stays_when_the_run_is_stopped_and_acts_again_when_it_is_resumed() {
    let (run, address) = (TestRun::new(programs!()), free_address());
    let mut training = listen(&run, &address, 0.1);
    let mut host = join(&run, "host", &address);
    await_actor_of(&run, "@host");
    training.await_checkpoint(4);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    assert!(host.try_wait().unwrap().is_none(), "the host has left a run that is not over");
    let mut training = run.resume_with(&["--listen", &address]);
    await_actor_of(&run, "@host");
    training.expect_going_on("the host came back");
    assert_eq!(training.finish().hashes(), *alone());
    assert!(host.wait().unwrap().success());
}

#[test]
fn hosts_have_as_many_actors_as_they_are_scaled_to() {
    let (run, address) = (TestRun::new(programs!()), free_address());
    let (took, said) = run.goalward(&["train", "--run", "run", "--actors", "0"]);
    assert!(!took, "{said}");
    let training = listen_with(&run, &address, 0.1, "resources.actors=0");
    let mut first = join(&run, "first", &address);
    let await_actors = |count: u64| {
        await_some(&format!("{count} actors of the host"), PATIENCE, || {
            let (_, said) = run.goalward(&["status", "run"]);
            said.contains(&format!("first, actors: {count}, ")).then_some(())
        });
    };
    let scale = |arguments: &[&str]| {
        let (took, said) = run.goalward(&[&["scale", "run"], arguments].concat());
        assert!(took, "{said}");
    };
    await_actors(2);
    scale(&["--actors", "3", "--host", "first"]);
    await_actors(3);
    let (took, said) = run.goalward(&["scale", "run", "--actors", "1", "--host", "second"]);
    let words =
        "--host: expected one of the machines that have joined the run, first, found second";
    assert!(!took && said.contains(words), "{said}");
    // The run's own machine needs no actors either.
    scale(&["--actors", "0"]);
    scale(&["--actors", "0", "--host", "first"]);
    await_actors(0);
    let (took, said) = run.goalward(&["scale", "run", "--actors", "64"]);
    let words = "expected at most 63, as other machines take 1 of the 64 places of a run, found 64";
    assert!(!took && said.contains(words), "{said}");
    // The number of actors outlives the gateway that received it: the host reports it to the next one.
    run.process("gateway").signal(Signal::Kill);
    let joined = || {
        let said = fs::read_to_string(run.folder().output().join("gateway.log")).unwrap();
        said.matches("host first joins").count()
    };
    await_some("the host at the next gateway", PATIENCE, || (joined() == 2).then_some(()));
    await_some("a beat of the host there", PATIENCE, || {
        let (_, said) = run.goalward(&["status", "run"]);
        (said.contains("first, actors: 0, ") && said.contains(" ms away")).then_some(())
    });
    scale(&["--actors", "1", "--host", "first"]);
    await_actors(1);
    scale(&["--actors", "1"]);
    assert_eq!(training.finish().hashes(), *alone());
    assert!(first.wait().unwrap().success());
    // Changing the number of actors does not make the host join again.
    assert_eq!(joined(), 2);
    let said = fs::read_to_string(run.path("first.err")).unwrap();
    let numbers = said.lines().filter_map(|line| line.strip_suffix(" from now on"));
    let numbers: Vec<&str> = numbers.filter_map(|line| line.rsplit(' ').next()).collect();
    assert_eq!(numbers, ["3", "0", "1"], "{said}");
}

#[test]
fn a_run_whose_own_actor_cannot_work_goes_on_with_those_of_hosts() {
    let (run, address) = (TestRun::new(programs!()), free_address());
    let other = TestRun::new(programs!());
    let training = listen(&run, &address, 0.0);
    let mut host = start(&run, "host", joining(&other, &run, "host", &address));
    await_some("the host in the run's status", PATIENCE, || {
        let (_, said) = run.goalward(&["status", "run"]);
        said.contains("host, actors: 2, ").then_some(())
    });
    let actor = run.path("bin/goalward-actor");
    fs::remove_file(&actor).unwrap();
    fs::write(&actor, "#!/bin/sh\nexit 1\n").unwrap();
    fs::set_permissions(&actor, Permissions::from_mode(0o755)).unwrap();
    run.process("actor-0").signal(Signal::Kill);
    await_some("a word of the actor that dies", PATIENCE, || {
        run.remarks().contains("the run continues without it").then_some(())
    });
    assert_eq!(training.finish().hashes(), *alone());
    assert!(host.wait().unwrap().success());
}

/// An actor whose golden episodes are right, but in whose rollouts agents start elsewhere.
const DISHONEST: &str = r#"#!/bin/sh
[ "$1" = rollout ] && sed -i 's/^coverage = .*/coverage = 0.3/' "$3/config.toml"
exec "$(dirname "$0")/honest-actor" "$@"
"#;

#[test]
fn a_host_that_acts_otherwise_is_expelled_and_named() {
    let (run, address) = (TestRun::new(programs!()), free_address());
    let other = TestRun::new(programs!());
    let actor = other.path("bin/goalward-actor");
    fs::rename(&actor, other.path("bin/honest-actor")).unwrap();
    fs::write(&actor, DISHONEST).unwrap();
    fs::set_permissions(&actor, Permissions::from_mode(0o755)).unwrap();
    let training = listen(&run, &address, 1.0);
    let dishonest = joining(&other, &run, "dishonest", &address);
    let mut dishonest = start(&run, "dishonest", dishonest);
    let mut honest = join(&run, "honest", &address);
    assert!(!dishonest.wait().unwrap().success());
    let said = fs::read_to_string(run.path("dishonest.err")).unwrap();
    assert!(
        said.contains("refuses this host: its episode differs when re-simulated: lane "),
        "{said}"
    );
    assert!(said.contains("step 0: another observation"), "{said}");
    let again = joining(&other, &run, "dishonest", &address).output().unwrap();
    let said = String::from_utf8_lossy(&again.stderr);
    assert!(!again.status.success() && said.contains("dishonest has been expelled"), "{said}");
    assert_eq!(training.finish().hashes(), *alone());
    assert!(honest.wait().unwrap().success());
    let said = fs::read_to_string(run.folder().output().join("gateway.log")).unwrap();
    assert!(said.contains("episodes of hosts re-simulated: 16"), "{said}");
    let said = run.remarks();
    assert!(
        said.contains("dishonest is expelled: its episode differs when re-simulated"),
        "{said}"
    );
    assert!(said.contains(" honest joined the run\n"), "{said}");
}

/// A fault that happens to a run on several machines.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// The host that joined last is killed.
    KillHost,
    /// The run's own gateway is killed.
    KillHub,
    /// The gateway of a host is killed.
    KillGateway,
    /// The link is cut for some milliseconds.
    Cut(u64),
    /// The link has a delay of some milliseconds from now on.
    Delay(u64),
    /// The link loses one per cent of the pieces from now on.
    Lose,
    /// Another host joins.
    Join,
    /// The learner is killed.
    KillLearner,
}

/// Draws a schedule: milliseconds to wait, and the fault that follows, for each of two to five faults.
fn schedule(seed: u64) -> Vec<(u64, Fault)> {
    let mut stream = stream(seed, Purpose::TrainingEpisode, 0, 0);
    let fault = |stream: &mut Stream| match stream.random_range(0..9) {
        0 => Fault::KillHost,
        1 => Fault::KillHub,
        2 => Fault::KillGateway,
        3 => Fault::Cut(stream.random_range(50..1_000)),
        4 => Fault::Cut(stream.random_range(4_000..10_000)),
        5 => Fault::Delay(stream.random_range(1..20)),
        6 => Fault::Lose,
        7 => Fault::KillLearner,
        _ => Fault::Join,
    };
    let count = stream.random_range(2..6);
    (0..count).map(|_| (stream.random_range(20..1_000), fault(&mut stream))).collect()
}

/// A run on several machines under a schedule of faults.
struct Play<'a> {
    run: &'a TestRun,
    namespace: Option<Namespace>,
    relay: Relay,
    hosts: Vec<Child>,
}

impl<'a> Play<'a> {
    /// Starts two hosts that join a run whose hub listens at `address`.
    fn begin(run: &'a TestRun, address: &str) -> Play<'a> {
        let namespace = Namespace::new();
        let local = IpAddr::from(Ipv4Addr::LOCALHOST);
        let here = namespace.as_ref().map_or(local, Namespace::here);
        let relay = Relay::new(here, address);
        let mut play = Play { run, namespace, relay, hosts: Vec::new() };
        play.join();
        play.join();
        play
    }

    fn join(&mut self) {
        let name = format!("host-{}", self.hosts.len());
        let mut command = joining(self.run, self.run, &name, &self.relay.address());
        if let Some(namespace) = &self.namespace {
            command = namespace.enter(&command);
        }
        self.hosts.push(start(self.run, &name, command));
    }

    fn cut(&self, is_cut: bool) {
        match &self.namespace {
            Some(namespace) => namespace.cut(is_cut),
            None => self.relay.cut(is_cut),
        }
    }

    fn strike(&mut self, fault: Fault) {
        match fault {
            Fault::KillHost => {
                if let Some(host) = self.hosts.last() {
                    send(host.id(), Signal::Kill);
                }
            }
            Fault::KillHub => self.kill(|one| one.name == "gateway" && one.serves(self.run)),
            Fault::KillGateway => self.kill(|one| one.name == "gateway" && !one.serves(self.run)),
            Fault::KillLearner => self.kill(|one| one.name == "learner"),
            Fault::Cut(milliseconds) => {
                self.cut(true);
                sleep(Duration::from_millis(milliseconds));
                self.cut(false);
            }
            Fault::Delay(milliseconds) => self.relay.delay(Duration::from_millis(milliseconds)),
            Fault::Lose => self.relay.lose(true),
            Fault::Join => self.join(),
        }
    }

    fn kill(&self, is_it: impl Fn(&system_tests::Process) -> bool) {
        if let Some(process) = self.run.all_processes().into_iter().find(is_it) {
            process.signal(Signal::Kill);
        }
    }
}

fn play(seed: u64) {
    let (run, address, schedule) = (TestRun::new(programs!()), free_address(), schedule(seed));
    let shown = format!("schedule {seed}: {schedule:?}");
    let training = listen(&run, &address, 0.1);
    let mut play = Play::begin(&run, &address);
    await_actor_of(&run, "@host-0");
    for (milliseconds, fault) in schedule {
        sleep(Duration::from_millis(milliseconds));
        play.strike(fault);
    }
    assert_eq!(training.end(), Some(0), "{shown}\n{}", run.remarks());
    assert_eq!(run.summary().hashes(), *alone(), "{shown}");
    let (verified, said) = run.goalward(&["replay", "run", "--verify"]);
    assert!(verified, "{shown}: {said}");
    assert_eq!(run.shared_memory(), Vec::<String>::new(), "{shown}");
    for mut host in play.hosts {
        // A host that was cut off at the end would wait for the hub for a minute.
        send(host.id(), Signal::Interrupt);
        host.wait().unwrap();
    }
}

#[test]
#[expect(clippy::print_stdout, reason = "says what it plays with")]
fn random_faults_of_hosts_and_links_change_nothing() {
    let link = match Namespace::new() {
        Some(_) => "network namespaces",
        None => "a relay alone: `ip` makes no network namespace here",
    };
    println!("links between machines: {link}");
    QUICK.for_each(play);
}

/// `deploy/soak.sh --hosts N` runs this test, with number of schedules and first seed in environment variables.
#[test]
#[ignore = "as long as deploy/soak.sh says"]
#[expect(clippy::print_stdout, reason = "says how far it is")]
fn soak() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse().ok());
    let first = number("GOALWARD_SOAK_SEED").unwrap_or(100);
    for seed in first..first + number("GOALWARD_SOAK_HOSTS").unwrap_or(10) {
        play(seed);
        println!("schedule {seed}: the same weights, nothing left behind");
    }
}

#[test]
fn what_cannot_be_joined_costs_a_line() {
    let run = TestRun::new(programs!());
    let refusal = |arguments: &[&str]| {
        let (well, said) = run.goalward(arguments);
        assert!(!well && said.lines().count() == 1, "{said}");
        said
    };
    let said = refusal(&["join", "--run", "nowhere"]);
    assert!(said.contains("found no nowhere/join.toml"), "{said}");
    let status = run.program("goalward").args(["join", "--key", "nowhere"]).status().unwrap();
    assert_eq!(status.code(), Some(2));
    fs::write(run.path("key"), "address = 3").unwrap();
    let said = refusal(&["join", "--key", "key"]);
    assert!(
        said.contains("key: expected the keys that `goalward train --listen` writes"),
        "{said}"
    );
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap().to_string();
    let said = refusal(&["train", "navigation", "--listen", &taken]);
    assert!(said.contains(&format!("listening at {taken}: Address already in use")), "{said}");
    let said = refusal(&["train", "navigation", "--listen", "0.0.0.0:0"]);
    assert!(said.contains("--listen: expected a port"), "{said}");

    let address = free_address();
    let training = listen(&run, &address, 0.0);
    fs::copy(run.folder().path().join("join.toml"), run.path("copy")).unwrap();
    let said = refusal(&["join", &free_address(), "--key", "copy"]);
    assert!(said.contains("onnection refused"), "{said}");
    let (well, said) = run.goalward(&["stop", "run"]);
    let listening = format!("--listen {address} --audit 0\n");
    assert!(well && said.ends_with(&format!("train --resume --run run {listening}")), "{said}");
    assert_eq!(training.end(), Some(130));
    assert!(run.remarks().contains(&format!("/run {listening}")), "{}", run.remarks());
    let said = refusal(&["join", "--key", "copy"]);
    assert!(said.contains(&format!("the hub at {address}")), "{said}");
}
