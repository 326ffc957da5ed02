//! The processes of a run: they start, answer, and end without a trace.
//!
//! Method: real runs are inspected from outside: `/proc` shows which processes are alive, `/dev/shm` what they left.
//! The test itself joins the bus as any tool of a user could.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::process::Stdio;
use std::time::{Duration, Instant};

use bus::{Bus, BusAddress, Client, Doorbell, Role};
use bytes::Bytes;
use mcap_log::{FileReader, Record};
use prost::Message;
use protocol::Error;
use protocol::messages::{Answer, Ask, Query, ServiceReply, ServiceRequest};
use protocol::trajectory::Encoded;
use system_tests::{ITERATIONS, Signal, TestRun, await_some, programs, spec};

/// Time within which processes without a supervisor must stop. They notice at once, but the learner finishes its
/// iteration and writes a checkpoint, and the service waits for the learner.
const A_FEW_SECONDS: Duration = Duration::from_secs(15);

fn expect_no_trace(run: &TestRun) {
    assert_eq!(run.processes(), []);
    assert_eq!(run.shared_memory(), Vec::<String>::new());
}

#[test]
fn nothing_is_left_of_a_finished_run() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["resources.actors=3"]);
    training.await_checkpoint(4);
    let mut names: Vec<_> = run.processes().into_iter().map(|process| process.name).collect();
    names.sort();
    assert_eq!(names, ["actor-0", "actor-1", "actor-2", "learner", "proximity-service"]);
    assert!(!run.shared_memory().is_empty(), "the test looks in the wrong place");
    let summary = training.finish();
    assert_eq!((summary.actors, summary.iterations), (3, ITERATIONS));
    assert_eq!((summary.task.as_str(), summary.method.as_str()), ("navigation", "goal-proximity"));
    assert!(summary.steps_per_s > 0.0 && summary.wall_s > 0.0);
    let processor_s = summary.processor_s;
    assert!(processor_s > 0.25 * summary.wall_s, "five processes took {processor_s} s");
    expect_no_trace(&run);
}

#[test]
fn nothing_is_left_of_a_stopped_run() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    expect_no_trace(&run);
    let said = fs::read_to_string(run.path("goalward.err")).unwrap();
    assert!(said.contains("--resume --run"), "expected how to go on in\n{said}");
}

#[test]
fn processes_without_a_supervisor_stop_and_the_run_can_go_on() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    training.signal(Signal::Kill);
    assert_eq!(training.end(), None);
    let stopped = || run.processes().is_empty().then_some(());
    await_some("the end of all processes", A_FEW_SECONDS, stopped);

    let summary = run.resume().finish();
    assert_eq!(summary.iterations, ITERATIONS);
    expect_no_trace(&run);
}

#[test]
fn an_actor_started_by_hand_joins() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["resources.actors=1", "resources.lease_timeout_ms=500"]);
    training.await_checkpoint(4);
    let mut helper = run.program("goalward-actor");
    helper.arg("rollout").arg("--run").arg(run.folder().path()).args(["--name", "actor-by-hand"]);
    // Null input, as nohup, systemd and Slurm give it; below, input that ends at once, as a remote shell gives it.
    let words = fs::File::create(run.path("helper.txt")).unwrap();
    let mut helper = helper.stdin(Stdio::null()).stderr(words).spawn().unwrap();
    let mut distant = run.program("goalward-actor");
    distant.arg("rollout").arg("--run").arg(run.folder().path()).args(["--name", "actor-distant"]);
    let mut distant = distant.stdin(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    drop(distant.stdin.take());
    // From here on the run's own actor is stopped: the others do all rollouts.
    let held = run.process("actor-0");
    held.signal(Signal::Stop);
    let (reached, _) = run.folder().newest_checkpoint().unwrap();
    training.await_checkpoint(reached + 8);
    assert!(
        distant.try_wait().unwrap().is_none(),
        "the end of its input is not the end of the run"
    );
    held.signal(Signal::Continue);
    assert_eq!(training.finish().iterations, ITERATIONS);
    // They end with the run, and not before.
    let status = await_some("its end", A_FEW_SECONDS, || helper.try_wait().unwrap());
    assert!(status.success(), "{status}");
    let said = fs::read_to_string(run.path("helper.txt")).unwrap();
    assert!(said.contains("joined the run in"), "{said}");
    assert!(await_some("its end", A_FEW_SECONDS, || distant.try_wait().unwrap()).success());
    expect_no_trace(&run);
}

fn status(run: &TestRun) -> String {
    let output = run.program("goalward").arg("status").arg(run.folder().path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn status_names_who_is_stopped() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["resources.actors=2"]);
    training.await_checkpoint(4);
    let said = status(&run);
    assert!(said.starts_with("training\n"), "{said}");
    let names = ["learner", "proximity-service", "actor-0", "actor-1"];
    for name in names {
        let id = run.process(name).id.to_string();
        let row = said.lines().find(|line| line.trim_start().starts_with(name));
        let row = row.unwrap_or_else(|| panic!("expected a row of {name} in\n{said}"));
        assert!(row.contains(&id) && row.contains("running"), "{name} is {id}: {row}");
    }
    for name in ["learner", "proximity-service"] {
        let held = run.process(name);
        held.signal(Signal::Stop);
        let said = status(&run);
        held.signal(Signal::Continue);
        let expected = format!("stalled: {name} is stopped");
        assert!(said.starts_with(&expected), "expected {expected}, found\n{said}");
        assert!(said.contains(&format!("kill -CONT {}", held.id)), "{said}");
    }
    training.signal(Signal::Interrupt);
    training.end();
}

/// A user's tool that queries the proximity service.
struct Tool {
    doorbell: Doorbell,
    client: Client,
}

impl Tool {
    fn join(run: &TestRun) -> Tool {
        let address = BusAddress::of_run(run.folder().path()).unwrap();
        let bus = Bus::open(&address, "tool").unwrap();
        let doorbell = bus.doorbell(Role::Supervisor).unwrap();
        Tool { client: bus.score_client(&doorbell).unwrap(), doorbell }
    }

    fn ask(&self, observations: Vec<u8>) -> Answer {
        let query = Query { observations: Bytes::from(observations) };
        let request = ServiceRequest { ask: Some(Ask::Query(query)) };
        let read = |bytes| ServiceReply::decode(bytes).unwrap().answer;
        let start = Instant::now();
        let keep_waiting = || {
            assert!(start.elapsed() < A_FEW_SECONDS, "no answer of the proximity service");
            Ok::<_, Error>(())
        };
        self.client.ask(&request.encode_to_vec(), &self.doorbell, read, keep_waiting).unwrap()
    }

    /// Returns the proximities of observations, after checking the whole answer.
    fn proximity(&self, observations: Vec<u8>) -> Vec<f32> {
        let count = observations.len() / spec("navigation").observation.bytes();
        let Answer::Estimates(estimates) = self.ask(observations) else { panic!("refused") };
        assert_eq!((estimates.proximity.len(), estimates.uncertainty.len()), (count, count));
        assert!(estimates.proximity.iter().all(|proximity| (0.0..=1.0).contains(proximity)));
        assert!(estimates.uncertainty.iter().all(|&uncertainty| uncertainty >= 0.0));
        estimates.proximity
    }
}

#[test]
fn any_process_can_ask_about_any_observations() {
    let spec = spec("navigation");
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    let tool = Tool::join(&run);

    let mut demonstrations = FileReader::open(&run.folder().demonstrations_file()).unwrap();
    let first = demonstrations.find_map(|entry| match entry.unwrap().record {
        Record::Trajectory(bytes) => Some(Encoded::decode(bytes, &spec).unwrap().trajectory),
        _ => None,
    });
    let first = first.unwrap();
    let demonstrated = tool.proximity(first.observations().to_vec());
    assert_eq!(demonstrated.len(), first.steps as usize + 1);
    assert_eq!(tool.proximity(vec![0; spec.observation.bytes()]).len(), 1);
    assert!(tool.proximity(Vec::new()).is_empty());
    // Nonsense is refused with a message and harms nobody.
    assert!(matches!(tool.ask(vec![0; 7]), Answer::Refused(_)));
    assert!(matches!(tool.ask(vec![9; spec.observation.bytes()]), Answer::Refused(_)));

    drop(tool);
    assert_eq!(training.finish().iterations, ITERATIONS);
    let remarks = run.remarks();
    assert!(!remarks.contains("ended"), "a process died:\n{remarks}");
    expect_no_trace(&run);
}
