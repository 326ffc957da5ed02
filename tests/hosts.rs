//! A run whose actors are on several machines: they come and go, and the weights are those of a run that was
//! alone.
//!
//! Method: what another machine has of a run is its key and its address, so a `goalward join` beside the
//! run is one: it has a folder and a bus of its own.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs::{self, File};
use std::net::TcpListener;
use std::process::Child;

use bus::BusAddress;
use system_tests::{PATIENCE, Signal, TestRun, await_some, programs, send};

/// Long enough for hosts to come and go.
const STEPS: &str = "steps=60000";

/// An address that nobody listens at.
fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

/// Starts another machine's actors.
fn join(run: &TestRun, name: &str) -> Child {
    let output = |suffix| File::create(run.path(&format!("{name}.{suffix}"))).unwrap();
    let mut command = run.program("goalward");
    command.args(["join", "--actors", "2", "--name", name]);
    command.arg("--run").arg(run.folder().path());
    command.stdout(output("out")).stderr(output("err")).spawn().unwrap()
}

fn await_key(run: &TestRun) {
    let key = run.folder().path().join("join.toml");
    await_some("the key of the run", PATIENCE, || key.exists().then_some(()));
}

/// Waits until an actor of the host has asked for leases.
fn await_actor_of(run: &TestRun, host: &str) {
    let address = BusAddress::of_run(run.folder().path()).unwrap();
    let is_one = |name: &str| name.starts_with("actor") && name.ends_with(host);
    let found = || address.members().unwrap().iter().any(|one| one.lives && is_one(&one.name));
    await_some(&format!("an actor of {host}"), PATIENCE, || found().then_some(()));
}

#[test]
fn hosts_come_and_go_and_the_weights_are_the_same() {
    let alone = TestRun::new(programs!()).finish(&[STEPS]).hashes();
    let run = TestRun::new(programs!());
    let mut training = run.train_listening(&free_address(), &[STEPS, "resources.actors=1"]);
    await_key(&run);
    let mut first = join(&run, "first");
    await_actor_of(&run, "@first");
    let mut second = join(&run, "second");
    await_actor_of(&run, "@second");
    // Its other processes notice, and end.
    send(first.id(), Signal::Kill);
    first.wait().unwrap();
    run.process("gateway").signal(Signal::Kill);
    await_some("a word about the gateway", PATIENCE, || {
        run.remarks().contains("gateway ended").then_some(())
    });
    await_actor_of(&run, "@second");
    training.expect_going_on("a host came back");
    assert_eq!(training.finish().hashes(), alone);
    assert!(second.wait().unwrap().success());
    let said = fs::read_to_string(run.path("second.err")).unwrap();
    assert!(said.ends_with("goalward: the run is over\n"), "{said}");
    assert_eq!(run.shared_memory(), Vec::<String>::new());
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

    let address = free_address();
    let training = run.train_listening(&address, &[]);
    await_key(&run);
    fs::copy(run.folder().path().join("join.toml"), run.path("copy")).unwrap();
    let said = refusal(&["join", &free_address(), "--key", "copy"]);
    assert!(said.contains("onnection refused"), "{said}");
    training.finish();
    let said = refusal(&["join", "--key", "copy"]);
    assert!(said.contains(&format!("the hub at {address}")), "{said}");
}
