//! An intruder on a run's bus sends nonsense on every service: the run trains on to the same bits.
//!
//! Method: the test joins the bus of a live run, as any process of the same user can, with a port of every kind.
//! Through all of them it sends what no process of ours sends: random bytes, damaged messages, and whole
//! messages with absurd numbers. No process may end, and the hashes must be those of an undisturbed run.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::time::{Duration, Instant};

use bus::{
    Bus, BusAddress, Client, NewestPublisher, Pending, Role, Server, TrajectoryHeader,
    TrajectoryPublisher,
};
use bytes::Bytes;
use prost::Message;
use protocol::ending::Ending;
use protocol::messages::{
    ActorSeconds, Ask, BatchRequest, Lease, LeaseReply, LeaseRequest, Progress, Query,
    ServiceRequest,
};
use protocol::seed::{Purpose, Stream, stream};
use protocol::trajectory::{Trajectory, TrajectoryKey};
use protocol::weights::Weights;
use rand::RngExt;
use system_tests::{TestRun, programs, spec};

/// Pause between two rounds, so that the run has the machine most of the time.
const PAUSE: Duration = Duration::from_millis(1);

/// Rounds; each sends a message through every port.
const ROUNDS: u64 = 200;

/// Makes the run long enough for all rounds.
const STEPS: &str = "steps=16000";

/// Time limit for all rounds.
const PATIENCE: Duration = Duration::from_secs(120);

/// How long the intruder waits for room in a full queue.
const IMPATIENT: Duration = Duration::from_millis(1);

/// Longest message of the publishers of newest values, bytes.
const PLACE_BYTES: usize = 16 << 10;

/// An intruder with one port of every kind.
struct Intruder {
    trajectories: TrajectoryPublisher,
    leases: Client,
    scores: Client,
    weights: NewestPublisher,
    progress: NewestPublisher,
    lease_server: Server,
    score_server: Server,
    asked: Vec<Pending>,
    random: Stream,
}

impl Intruder {
    fn join(address: &BusAddress) -> Intruder {
        let bus: Bus = Bus::open(address, "intruder").unwrap();
        let doorbell = bus.doorbell(Role::Supervisor).unwrap();
        Intruder {
            trajectories: bus.trajectory_publisher(IMPATIENT).unwrap(),
            leases: bus.lease_client(&doorbell).unwrap(),
            scores: bus.score_client(&doorbell).unwrap(),
            weights: bus.weights_publisher(PLACE_BYTES).unwrap(),
            progress: bus.progress_publisher(PLACE_BYTES).unwrap(),
            lease_server: bus.lease_server().unwrap(),
            score_server: bus.score_server().unwrap(),
            asked: Vec::new(),
            random: stream(13, Purpose::TrainingEpisode, 0, 0),
        }
    }

    fn number(&mut self) -> u64 {
        let extremes = [0, 1, 3, 1 << 31, u64::from(u32::MAX), 1 << 62, u64::MAX];
        extremes[self.random.random_range(0..extremes.len())]
    }

    /// Returns, with equal probability, random bytes, the damaged message or the whole message.
    fn spoil(&mut self, mut bytes: Vec<u8>) -> Vec<u8> {
        match self.random.random_range(0..3) {
            0 => (0..self.random.random_range(0..2_000)).map(|_| self.random.random()).collect(),
            1 => {
                let flips = self.random.random_range(1..4);
                for _ in 0..flips.min(bytes.len()) {
                    let at = self.random.random_range(0..bytes.len());
                    bytes[at] ^= 1 << self.random.random_range(0..8);
                }
                bytes.truncate(self.random.random_range(0..bytes.len() + 1));
                bytes
            }
            _ => bytes,
        }
    }

    fn lease(&mut self) -> Lease {
        Lease {
            source: self.random.random_range(-1..5),
            iteration: self.number(),
            lane: self.number(),
            policy_version: self.number(),
            first_episode: u64::MAX - self.random.random_range(0..3),
            steps_owed: self.number().max(4),
            episodes_owed: self.number(),
        }
    }

    /// Makes a trajectory that may claim any number of steps but has at most two observations.
    fn trajectory(&mut self) -> Trajectory {
        let spec = spec("navigation");
        Trajectory {
            task: "navigation".repeat(self.random.random_range(1..3)),
            iteration: self.random.random_range(0..20),
            lane: self.number(),
            episode: self.number(),
            policy_version: self.random.random_range(0..20),
            steps: self.number() as u32,
            observation_shape: spec.observation.shape(),
            cells: Bytes::from(vec![1; 361 * self.random.random_range(0..3)]),
            discrete_actions: Bytes::from(vec![9; self.random.random_range(0..3)]),
            ending: Ending::Truncated as i32,
            steps_to_goal: u32::MAX,
            ..Trajectory::default()
        }
    }

    fn lease_request(&mut self) -> LeaseRequest {
        LeaseRequest {
            actor: "nobody".repeat(self.random.random_range(0..2_000)),
            capacity: u32::MAX,
            finished: (0..self.random.random_range(0..200)).map(|_| self.lease()).collect(),
            seconds: Some(ActorSeconds {
                environment: f64::NAN,
                inference: -1.0,
                transport: 1e300,
                processor: 1e300,
            }),
        }
    }

    fn service_request(&mut self) -> ServiceRequest {
        let ask = match self.random.random_range(0..3) {
            0 => Ask::Query(Query { observations: Bytes::from(vec![0; 361 * 5_000]) }),
            1 => Ask::Query(Query { observations: Bytes::from(vec![77; 361]) }),
            _ => Ask::Batch(BatchRequest {
                iteration: u64::MAX,
                keys: vec![TrajectoryKey { lane: 1, episode: 2, hash: 3 }; 2],
                supplied: vec![Bytes::from_static(b"nothing")],
            }),
        };
        ServiceRequest { ask: Some(ask) }
    }

    /// Sends through every port once; a message that finds no room is dropped.
    fn round(&mut self) {
        let header = TrajectoryHeader {
            iteration: self.number(),
            lane: self.number(),
            episode: self.number(),
            hash: self.number(),
        };
        let bytes = self.trajectory().encode_to_vec();
        let bytes = self.spoil(bytes);
        self.trajectories.publish(&bytes, header).ok();

        self.asked.truncate(2);
        let bytes = self.lease_request().encode_to_vec();
        let bytes = self.spoil(bytes);
        self.asked.splice(0..0, self.leases.send(&bytes));
        let bytes = self.service_request().encode_to_vec();
        let bytes = self.spoil(bytes);
        self.asked.splice(0..0, self.scores.send(&bytes));

        // Fewer parameters than the policy has: nobody could tell complete weights from the learner's.
        let parameters = vec![f32::NAN; self.random.random_range(0..100)];
        let bytes = Weights::new(self.number(), &parameters, &[0.5]).encode_to_vec();
        let bytes = self.spoil(bytes);
        self.weights.publish(&bytes).ok();
        let progress = Progress {
            phase: -1,
            steps_wanted: self.number(),
            steps_received: self.number(),
            wall_s: f64::NAN,
            ..Progress::default()
        };
        let bytes = self.spoil(progress.encode_to_vec());
        self.progress.publish(&bytes).ok();
        self.weights.refresh().ok();
        self.progress.refresh().ok();
        self.answer_falsely();
    }

    fn answer_falsely(&mut self) {
        while let Ok(Some(question)) = self.lease_server.receive() {
            let leases = (0..40).map(|_| self.lease()).collect();
            let reply = LeaseReply { leases, finished: false }.encode_to_vec();
            question.reply(&self.spoil(reply)).ok();
        }
        while let Ok(Some(question)) = self.score_server.receive() {
            // A truncated unknown field, or an empty message: never a valid answer.
            question.reply(if self.random.random() { &[0x7a] } else { b"" }).ok();
        }
    }
}

#[test]
fn nonsense_on_every_service_changes_nothing() {
    let undisturbed = TestRun::new(programs!()).finish(&[STEPS]).hashes();
    let run = TestRun::new(programs!());
    let mut training = run.train(&[STEPS]);
    training.await_checkpoint(4);
    let before = run.processes();
    let mut intruder = Intruder::join(&BusAddress::of_run(run.folder().path()).unwrap());
    let deadline = Instant::now() + PATIENCE;
    for round in 0..ROUNDS {
        intruder.round();
        std::thread::sleep(PAUSE);
        training.expect_going_on("the last round");
        assert!(Instant::now() < deadline, "expected {ROUNDS} rounds, found {round}");
    }
    assert_eq!(run.processes(), before, "somebody was started again\n{}", run.remarks());
    drop(intruder);
    assert_eq!(training.finish().hashes(), undisturbed);
    let said = std::fs::read_to_string(run.folder().output().join("learner.log")).unwrap();
    assert!(said.contains("dropped so far"), "expected a word about it in\n{said}");
}
