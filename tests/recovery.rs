//! The cost of a process's death: how much longer the policy updates after it take than usual. The work since the
//! checkpoint, which learner and service repeat, comes on top.
//!
//! Method: one process of a small run is killed four times in the middle of the run; the cost follows from the log
//! times of the policy updates. `cargo test --workspace --test recovery -- --nocapture` prints the seconds.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::io::Write;
use std::thread::sleep;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mcap_log::{Contents, FileReader, Record, log_files};
use system_tests::{Signal, TestRun, programs};

/// Number of policy updates after which an actor's death has no further cost: its leases are handed out again within
/// the first or the second.
const UPDATES: usize = 10;

/// Kills in one run. A fifth death of an actor within 30 s would pause it, or end the run if it is the only one.
const KILLS: u64 = 4;

/// Log times of all policy updates, including repeated ones, in nanoseconds since 1970.
fn updates_ns(run: &TestRun) -> Vec<u64> {
    let files = log_files(&run.folder().log()).unwrap().into_iter();
    let files = files.filter(|file| file.contents == Contents::Updates);
    let entries = files.flat_map(|file| FileReader::open(&file.path).unwrap());
    let entries = entries.map(|entry| entry.unwrap());
    let updates = entries.filter(|entry| matches!(entry.record, Record::PolicyUpdate(_)));
    updates.map(|entry| entry.log_time_ns).collect()
}

/// Repeatedly kills the named process of a run with `actors` actors, at different moments of an iteration. Returns the
/// largest time that one of these deaths adds to the next `count` updates.
fn cost(name: &str, actors: u64, count: usize) -> Duration {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=4000000", &format!("resources.actors={actors}")]);
    let mut killed_ns = Vec::new();
    for kill in 1..=KILLS {
        training.await_checkpoint(12 * kill);
        sleep(Duration::from_millis(7 * kill));
        killed_ns.push(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64);
        run.process(name).signal(Signal::Kill);
    }
    training.await_checkpoint(12 * (KILLS + 1));
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));

    let updates = updates_ns(&run);
    let mut between: Vec<u64> = updates.windows(2).map(|pair| pair[1] - pair[0]).collect();
    between.sort_unstable();
    let usual = between[between.len() / 2];
    let costs = killed_ns.into_iter().map(|killed_ns| {
        let mut later = updates.iter().filter(|&&update| update > killed_ns);
        let took = later.nth(count - 1).unwrap() - killed_ns;
        Duration::from_nanos(took.saturating_sub(usual * count as u64))
    });
    let cost = costs.max().unwrap();
    let mut stdout = std::io::stdout();
    writeln!(stdout, "{name} of {actors} actors: {:.2} s", cost.as_secs_f64()).unwrap();
    cost
}

#[test]
fn a_killed_actor_costs_less_than_two_seconds() {
    for actors in [1, 2, 4] {
        let cost = cost("actor-0", actors, UPDATES);
        assert!(cost < Duration::from_secs(2), "{actors} actors: {cost:?}");
    }
}

#[test]
fn a_killed_learner_or_service_costs_less_than_ten_seconds() {
    for name in ["learner", "proximity-service"] {
        let cost = cost(name, 2, 1);
        assert!(cost < Duration::from_secs(10), "{name}: {cost:?}");
    }
}
