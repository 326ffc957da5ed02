//! What a hub lets in: nobody without the run's key, no host that acts otherwise, and of those who are in
//! nothing that is wrong. The test is the learner of the run, and every kind of host.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;
use std::future::Future;
use std::io::Write;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use actor::factory::Factory;
use actor::lane::Lane;
use bus::{Bus, BusAddress, Server, TrajectorySubscriber};
use bytes::Bytes;
use gateway::calls::gateway_client::GatewayClient;
use gateway::host::{self, connect};
use gateway::hub::{self, Setup};
use gateway::key::{self, JoinKey};
use gateway::messages::{Beat, Delivery, Hello, PROTOCOL, Question};
use prost::Message;
use protocol::build;
use protocol::messages::{Lease, LeaseReply, LeaseRequest};
use protocol::trajectory::{Encoded, Source};
use run::config::RunConfig;
use run::folder::RunFolder;
use run::process::Stop;
use tempfile::TempDir;
use tonic::transport::Channel;
use tonic::{Code, Status};

const GOLDEN: &str = "the hash of a few episodes";
const PATIENCE: Duration = Duration::from_secs(30);

/// Connections of strangers.
const STRANGERS: usize = 100;

/// A hub, and the learner that it stands before.
struct Stage {
    directory: TempDir,
    config: RunConfig,
    key: JoinKey,
    leases: Server,
    trajectories: TrajectorySubscriber,
    stop: Stop,
    hub: Option<std::thread::JoinHandle<()>>,
}

impl Stage {
    fn new() -> Stage {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let config = run::tasks::configuration("navigation", "goalward", &[]).unwrap();
        fs::write(folder.config_file(), config.to_text()).unwrap();
        let bus = Bus::open(&BusAddress::for_start(folder.path()).unwrap(), "learner").unwrap();
        let (leases, trajectories) =
            (bus.lease_server().unwrap(), bus.learning_subscriber().unwrap());
        let listen = free_address();
        let hub_key = key::of_run(&folder, &listen.to_string()).unwrap();
        let key = JoinKey::of_file(&key::join_file(&folder)).unwrap();
        let (stop, setup) = (Stop::default(), Setup { folder, listen, golden: GOLDEN.to_owned() });
        let stopped = stop.clone();
        let body = move || hub::serve(&setup, &hub_key, &stopped).unwrap();
        let hub = Some(std::thread::Builder::new().spawn(body).unwrap());
        let start = Instant::now();
        while TcpStream::connect(listen).is_err() {
            assert!(start.elapsed() < PATIENCE, "expected a hub at {listen}");
            std::thread::sleep(Duration::from_millis(5));
        }
        Stage { directory, config, key, leases, trajectories, stop, hub }
    }

    fn hello(&self, session: u64) -> Hello {
        Hello {
            protocol: PROTOCOL,
            session,
            host: "node-7".to_owned(),
            build: build::version().to_owned(),
            golden: GOLDEN.to_owned(),
            other_build: false,
        }
    }

    /// An episode of a lane, by actions that never change.
    fn episode(&self, lane: u64, run_seed: u64) -> Bytes {
        let factory = Factory::of_run(actor::BUILT_IN, &self.config).unwrap();
        let mut lane = Lane::begin(lease(lane), &factory, None, run_seed).unwrap();
        loop {
            if let Some(trajectory) = lane.step(&[0], Some(0.0)).unwrap() {
                return Encoded::encode(trajectory).bytes;
            }
        }
    }

    /// Answers the question for leases that comes next.
    fn grant(&self, leases: Vec<Lease>) -> LeaseRequest {
        let start = Instant::now();
        loop {
            if let Some(question) = self.leases.receive().unwrap() {
                let request = LeaseRequest::decode(question.bytes()).unwrap();
                let reply = LeaseReply { leases, finished: false };
                question.reply(&reply.encode_to_vec()).unwrap();
                return request;
            }
            assert!(start.elapsed() < PATIENCE, "expected a question for leases");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// What has come to the learner's bus.
    fn published(&self) -> Vec<Bytes> {
        let next = || self.trajectories.receive().unwrap().map(|published| published.bytes);
        std::iter::from_fn(next).collect()
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        self.stop.request();
        let ended = self.hub.take().map(std::thread::JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_some_and(|ended| ended.is_ok()));
    }
}

fn free_address() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

fn lease(lane: u64) -> Lease {
    Lease { source: Source::Training as i32, lane, episodes_owed: 1, ..Lease::default() }
}

fn question(session: u64, number: u64) -> Question {
    let request = LeaseRequest { actor: "actor-0-7".to_owned(), capacity: 4, ..Default::default() };
    Question { session, number, request: Some(request) }
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(work)
}

async fn deliver(
    hub: &mut GatewayClient<Channel>,
    session: u64,
    trajectory: Bytes,
) -> Result<(), Status> {
    hub.trajectory(Delivery { session, trajectory }).await.map(drop)
}

#[test]
fn strangers_get_nothing_and_cost_nothing() {
    let stage = Stage::new();
    let idle = || TcpStream::connect(&stage.key.address).unwrap();
    let _idle: Vec<TcpStream> = (0..STRANGERS).map(|_| idle()).collect();
    for number in 0..STRANGERS {
        let mut stranger = TcpStream::connect(&stage.key.address).unwrap();
        // What a hub that hangs up does not take is as well.
        stranger.write_all(&vec![(number * 37) as u8; number * 50]).ok();
    }
    let other = tempfile::tempdir().unwrap();
    let other = RunFolder::new(other.path());
    key::of_run(&other, &stage.key.address).unwrap();
    let wrong = JoinKey::of_file(&key::join_file(&other)).unwrap();
    let error = format!("{:#}", host::lay_out(&other, &wrong).unwrap_err());
    assert!(error.contains("certificate"), "{error}");
    assert!(!other.config_file().exists());
    host::lay_out(&other, &stage.key).unwrap();
    assert_eq!(other.config().unwrap(), stage.config);
    let mut nowhere = stage.key.clone();
    nowhere.address = free_address().to_string();
    let error = format!("{:#}", host::lay_out(&other, &nowhere).unwrap_err());
    assert!(error.contains(&nowhere.address) && error.contains("refused"), "{error}");
}

#[test]
fn hosts_that_would_act_otherwise_are_refused_in_words() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        let hello = stage.hello(1);
        for (hello, expected) in [
            (
                Hello { protocol: 99, ..hello.clone() },
                "expected a gateway of protocol 1, found one of 99",
            ),
            (Hello { build: "0.0.9".to_owned(), ..hello.clone() }, "found 0.0.9"),
            (Hello { golden: "another".to_owned(), ..hello.clone() }, "golden episodes of hash"),
            (Hello { host: "a\nb".to_owned(), ..hello.clone() }, "expected a name"),
            (Hello { host: "x".repeat(99), ..hello.clone() }, "expected a name"),
        ] {
            let refusal = hub.hello(hello).await.unwrap_err();
            assert_eq!(refusal.code(), Code::FailedPrecondition);
            assert!(refusal.message().contains(expected), "{refusal}");
        }
        let unknown = hub.beat(Beat { session: 1, actors: Vec::new() }).await.unwrap_err();
        assert_eq!(unknown.code(), Code::Unauthenticated);
        let other_build = Hello { build: "0.0.9".to_owned(), other_build: true, ..hello };
        let welcome = hub.hello(other_build).await.unwrap().into_inner();
        let second = hub.hello(stage.hello(2)).await.unwrap().into_inner();
        assert_eq!([welcome.host, second.host], ["node-7", "node-7-2"]);
    });
}

#[test]
fn only_episodes_of_granted_leases_reach_the_learner() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        let (seed, mut asker) = (stage.config.seed, hub.clone());
        let asked = tokio::spawn(async move { asker.lease(question(1, 1)).await });
        while !asked.is_finished() {
            tokio::time::sleep(Duration::from_millis(5)).await;
            if let Some(question) = stage.leases.receive().unwrap() {
                let request = LeaseRequest::decode(question.bytes()).unwrap();
                assert_eq!(request.actor, "actor-0-7@node-7");
                let reply = LeaseReply { leases: vec![lease(3)], finished: false };
                question.reply(&reply.encode_to_vec()).unwrap();
            }
        }
        let answer = asked.await.unwrap().unwrap().into_inner();
        assert_eq!(answer.reply.unwrap().leases, [lease(3)]);
        // A lost answer is asked for again; the learner hears nothing of it.
        let again = hub.lease(question(1, 1)).await.unwrap().into_inner();
        assert_eq!(again.reply.unwrap().leases, [lease(3)]);
        assert!(stage.leases.receive().unwrap().is_none());

        let granted = stage.episode(3, seed);
        deliver(&mut hub, 1, stage.episode(4, seed)).await.unwrap();
        deliver(&mut hub, 1, granted.clone()).await.unwrap();
        assert_eq!(stage.published(), std::slice::from_ref(&granted));

        hub.hello(stage.hello(2)).await.unwrap();
        for (session, wrong) in [(2, stage.episode(3, seed + 1)), (1, Bytes::from_static(b"no"))] {
            let refusal = deliver(&mut hub, session, wrong).await.unwrap_err();
            assert_eq!(refusal.code(), Code::PermissionDenied, "{refusal}");
            let expelled = deliver(&mut hub, session, granted.clone()).await.unwrap_err();
            assert_eq!(expelled.message(), refusal.message());
            let back = hub.hello(stage.hello(session)).await.unwrap_err();
            assert_eq!(back.code(), Code::PermissionDenied);
        }
        assert_eq!(stage.published(), Vec::<Bytes>::new());
        hub.hello(stage.hello(3)).await.unwrap();
    });
}

#[test]
fn a_host_that_is_gone_leaves_the_bus() {
    let stage = Stage::new();
    let address = BusAddress::of_run(stage.directory.path()).unwrap();
    let is_there = || address.members().unwrap().iter().any(|member| member.name.contains('@'));
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        let asked = tokio::spawn(async move { hub.lease(question(1, 1)).await });
        tokio::time::sleep(Duration::from_millis(50)).await;
        let request = stage.grant(vec![lease(0)]);
        assert_eq!(request.actor, "actor-0-7@node-7");
        asked.await.unwrap().unwrap();
    });
    assert!(is_there());
    let start = Instant::now();
    while is_there() {
        assert!(start.elapsed() < PATIENCE, "expected the host to be given up");
        std::thread::sleep(Duration::from_millis(50));
    }
}
