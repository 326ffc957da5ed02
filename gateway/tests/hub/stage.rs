//! A hub, with the test in the role of its learner.

use std::fs::{self, Permissions};
use std::future::Future;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use actor::factory::Factory;
use actor::lane::Lane;
use bus::{Bus, BusAddress, Server, TrajectorySubscriber};
use bytes::Bytes;
use gateway::hub::{self, Audit, Setup};
use gateway::key::{self, JoinKey};
use gateway::messages::{Hello, PROTOCOL};
use prost::Message;
use protocol::build;
use protocol::messages::{Lease, LeaseReply, LeaseRequest};
use protocol::trajectory::{Encoded, Source};
use run::config::RunConfig;
use run::folder::RunFolder;
use run::hosts::Hosts;
use run::process::Stop;
use tempfile::TempDir;

pub(crate) const GOLDEN: &str = "the hash of a few episodes";
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// A hub, and the learner beside it.
pub(crate) struct Stage {
    pub(crate) directory: TempDir,
    pub(crate) config: RunConfig,
    pub(crate) key: JoinKey,
    pub(crate) leases: Server,
    trajectories: TrajectorySubscriber,
    stop: Stop,
    hub: Option<std::thread::JoinHandle<()>>,
    _left: Left,
}

/// Removes the bus when dropped, once everything on it is closed: the threads of hosts end a little later than the
/// hub.
struct Left(BusAddress);

impl Drop for Left {
    fn drop(&mut self) {
        let start = Instant::now();
        let mut removed = self.0.remove();
        while removed.is_err() && start.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(20));
            removed = self.0.remove();
        }
        assert!(std::thread::panicking() || removed.is_ok(), "{removed:?}");
    }
}

impl Stage {
    pub(crate) fn new() -> Stage {
        Stage::open(None, &Hosts::default())
    }

    /// Opens a stage on which an earlier hub of the run was killed that had this list of hosts.
    pub(crate) fn after(earlier: &Hosts) -> Stage {
        Stage::open(None, earlier)
    }

    /// Opens a stage on which a program `auditor` with this text, in the run's folder, audits every episode.
    pub(crate) fn with_auditor(text: &str) -> Stage {
        Stage::open(Some(text), &Hosts::default())
    }

    fn open(auditor: Option<&str>, earlier: &Hosts) -> Stage {
        let directory = tempfile::tempdir().unwrap();
        let audit = auditor.map(|text| audit_by(text, directory.path()));
        let folder = RunFolder::new(directory.path());
        let config = run::tasks::configuration("navigation", None, &[]).unwrap();
        fs::create_dir(folder.output()).unwrap();
        earlier.write(&folder).unwrap();
        fs::write(folder.config_file(), config.to_text()).unwrap();
        let address = BusAddress::for_start(folder.path()).unwrap();
        let bus = Bus::open(&address, "learner").unwrap();
        let (leases, trajectories) =
            (bus.lease_server().unwrap(), bus.learning_subscriber().unwrap());
        let listen = free_address();
        let hub_key = key::of_run(&folder, &listen.to_string()).unwrap();
        let key = JoinKey::of_file(&folder.join_file()).unwrap();
        let (stop, setup) =
            (Stop::default(), Setup { folder, listen, golden: GOLDEN.to_owned(), audit });
        let stopped = stop.clone();
        let body = move || hub::serve(&setup, &hub_key, &stopped).unwrap();
        let hub = Some(std::thread::Builder::new().spawn(body).unwrap());
        let start = Instant::now();
        while TcpStream::connect(listen).is_err() {
            assert!(start.elapsed() < PATIENCE, "expected a hub at {listen}");
            std::thread::sleep(Duration::from_millis(5));
        }
        Stage { directory, config, key, leases, trajectories, stop, hub, _left: Left(address) }
    }

    pub(crate) fn hello(&self, session: u64) -> Hello {
        Hello {
            protocol: PROTOCOL,
            session,
            host: "node-7".to_owned(),
            build: build::version().to_owned(),
            golden: GOLDEN.to_owned(),
            other_build: false,
            actors: 4,
        }
    }

    /// Runs an episode of a lane with the same action at every step.
    pub(crate) fn episode(&self, lane: u64, run_seed: u64) -> Bytes {
        let factory = Factory::of_run(actor::BUILT_IN, &self.config).unwrap();
        let mut lane = Lane::begin(lease(lane), &factory, None, run_seed).unwrap();
        loop {
            if let Some(trajectory) = lane.step(&[0], Some(0.0)).unwrap() {
                return Encoded::encode(trajectory).bytes;
            }
        }
    }

    /// Grants leases in reply to the next lease request.
    pub(crate) fn grant(&self, leases: Vec<Lease>) -> LeaseRequest {
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

    /// Waits until the list of hosts in the run's folder satisfies the condition.
    pub(crate) async fn await_hosts(&self, is_so: impl Fn(&Hosts) -> bool) -> Hosts {
        let folder = RunFolder::new(self.directory.path());
        let start = Instant::now();
        loop {
            let hosts = Hosts::of_run(&folder);
            if is_so(&hosts) {
                return hosts;
            }
            assert!(start.elapsed() < PATIENCE, "found {hosts:?}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Returns the trajectories that have arrived on the learner's bus.
    pub(crate) fn published(&self) -> Vec<Bytes> {
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

fn audit_by(text: &str, directory: &Path) -> Audit {
    let program = directory.join("auditor");
    fs::write(&program, text).unwrap();
    fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();
    Audit { share: 1.0, program }
}

pub(crate) fn free_address() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

pub(crate) fn lease(lane: u64) -> Lease {
    Lease { source: Source::Training as i32, lane, episodes_owed: 1, ..Lease::default() }
}

pub(crate) fn block_on<T>(work: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(work)
}
