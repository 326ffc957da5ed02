//! A host that has the key and sends arbitrary messages: the hub survives, its memory does not grow, and nothing from
//! the host is published.

use std::time::{Duration, Instant};

use bytes::Bytes;
use gateway::calls::gateway_client::GatewayClient;
use gateway::host::connect;
use gateway::messages::{Beat, Exchange, Hello, MOST_BYTES, WeightsRequest};
use prost::Message;
use protocol::messages::{Lease, LeaseRequest};
use protocol::seed::{Purpose, Stream, stream};
use rand::RngExt;
use tonic::Code;
use tonic::transport::Channel;

use crate::stage::{PATIENCE, Stage, block_on};

/// Number of messages by default; `GOALWARD_FUZZ_CASES` asks for more.
const MESSAGES: u64 = 2_000;

/// Number of messages before memory is first measured.
const WARM_UP: u64 = 500;

/// Number of messages per session; most sessions are expelled sooner.
const OF_ONE_JOINING: u64 = 20;

/// How long to wait for an answer: lease requests would be held for seconds.
const IMPATIENT: Duration = Duration::from_millis(20);

/// Allowed growth of the process's memory, which is less than what is sent. Buffers and the allocator take half of it.
const GROWTH_BYTES: u64 = 96 << 20;

/// Length up to which trajectories have arbitrary bytes.
const LONG_BYTES: usize = 5 << 18;

/// A host that sends arbitrary messages.
struct Liar {
    random: Stream,
    hello: Hello,
    /// An episode of the run whose lease nobody was granted.
    episode: Bytes,
    /// Bytes of all trajectories sent.
    sent: u64,
}

impl Liar {
    fn number(&mut self) -> u64 {
        let extremes = [0, 1, 7, 1 << 31, u64::from(u32::MAX), u64::MAX];
        extremes[self.random.random_range(0..extremes.len())]
    }

    fn name(&mut self) -> String {
        let names = ["actor-0-7", "actor", "learner", "", "actor-1@else", "actor\u{202e}\n", "é"];
        let name = names[self.random.random_range(0..names.len())];
        name.repeat(self.random.random_range(1..40))
    }

    /// Returns the episode, whole, damaged or cut off, or arbitrary bytes.
    fn trajectory(&mut self) -> Bytes {
        let mut bytes = self.episode.to_vec();
        match self.random.random_range(0..4) {
            0 => {}
            1 => bytes.truncate(self.random.random_range(0..bytes.len())),
            2 => {
                let at = self.random.random_range(0..bytes.len());
                bytes[at] ^= 1 << self.random.random_range(0..8);
            }
            _ => bytes = vec![7; self.random.random_range(0..LONG_BYTES)],
        }
        self.sent += bytes.len() as u64;
        bytes.into()
    }

    fn request(&mut self) -> LeaseRequest {
        let lease = Lease { source: -7, iteration: self.number(), ..Lease::default() };
        let actor = self.name();
        let capacity = self.number() as u32;
        let finished = vec![lease; self.random.random_range(0..50)];
        LeaseRequest { actor, capacity, finished, seconds: None }
    }

    /// Sends a message in a session, any answer to which is accepted. Each session has a host name of its own, because
    /// an expelled one is refused.
    async fn say(&mut self, session: u64, hub: &mut GatewayClient<Channel>) {
        match self.random.random_range(0..5) {
            0 => {
                let hello = Hello { session, host: self.name(), ..self.hello.clone() };
                hub.hello(Hello { build: self.name(), other_build: true, ..hello }).await.ok();
            }
            1 => {
                let host = format!("liar-{session}");
                hub.hello(Hello { session, host, actors: 1, ..self.hello.clone() }).await.ok();
            }
            2 => {
                let actors = (0..self.random.random_range(0..5)).map(|_| self.name()).collect();
                let distance_ms = Some(f64::from_bits(self.number()));
                hub.beat(Beat { session, actors, distance_ms }).await.ok();
            }
            3 => {
                let count = self.random.random_range(0..4);
                let trajectories = (0..count).map(|_| self.trajectory()).collect();
                let number = self.number();
                let request = (number != 7).then(|| self.request().encode_to_vec().into());
                hub.exchange(Exchange { session, trajectories, number, request }).await.ok();
            }
            _ => {
                let version = self.number();
                hub.weights(WeightsRequest { session, version }).await.ok();
            }
        }
    }
}

/// Returns the anonymous resident memory of this process, bytes. Shared memory is left out: the buses of other tests
/// come and go.
fn memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let resident = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    1024 * resident.split_whitespace().next().unwrap().parse::<u64>().unwrap()
}

fn messages() -> u64 {
    let asked = std::env::var("GOALWARD_FUZZ_CASES");
    asked.map_or(MESSAGES, |asked| asked.parse::<u64>().unwrap().max(MESSAGES))
}

#[test]
#[expect(clippy::print_stdout, reason = "says what it measured")]
fn a_host_that_says_anything_costs_nothing() {
    let stage = Stage::new();
    let mut liar = Liar {
        random: stream(19, Purpose::TrainingEpisode, 0, 0),
        hello: stage.hello(0),
        episode: stage.episode(3, stage.config.seed),
        sent: 0,
    };
    let mut before = 0;
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        for number in 0..messages() {
            let session = number / OF_ONE_JOINING;
            tokio::time::timeout(IMPATIENT, liar.say(session, &mut hub)).await.ok();
            while let Some(question) = stage.leases.receive().unwrap() {
                let request = LeaseRequest::decode(question.bytes()).unwrap();
                assert!(request.actor.starts_with("actor") && request.actor.contains('@'));
            }
            assert_eq!(stage.published(), Vec::<Bytes>::new());
            if number == WARM_UP {
                before = memory();
            }
        }
        // The threads of earlier sessions may still be ending.
        let start = Instant::now();
        while let Err(refused) = hub.hello(stage.hello(u64::MAX)).await {
            assert_eq!(refused.code(), Code::Unavailable, "{refused}");
            assert!(start.elapsed() < PATIENCE, "{refused}");
            tokio::time::sleep(IMPATIENT).await;
        }
    });
    let growth = memory().saturating_sub(before);
    assert!(growth < GROWTH_BYTES, "grown by {growth} bytes");
    println!("{} messages with {} bytes, grown by {growth} bytes", messages(), liar.sent);
    assert!(liar.sent > GROWTH_BYTES, "{} bytes are too few to show anything", liar.sent);
    // Here, because no other test measures memory.
    let trajectories = vec![Bytes::from(vec![0; MOST_BYTES])];
    let too_long = Exchange { session: u64::MAX, trajectories, ..Exchange::default() };
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        assert_eq!(hub.exchange(too_long).await.unwrap_err().code(), Code::OutOfRange);
    });
}
