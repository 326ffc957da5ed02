//! The transport between the processes of one run: shared memory, by iceoryx2.
//!
//! Only this crate depends on iceoryx2. It transports bytes and knows no messages. This table shows who sends what to
//! whom, and whose doorbell it rings:
//!
//! | service | from | to | kept when the reader is slow | doorbell |
//! |---|---|---|---|---|
//! | trajectories | actors | learner, proximity service, tools | hundreds; actors wait for the first two | first two |
//! | weights | learner | actors | the newest two | actors |
//! | leases | actors ask | learner answers | one answer per question | learner, then the asker |
//! | scores | anyone asks | proximity service answers | one answer per question | proximity service, then the asker |
//! | progress | learner | supervisor, tools | the newest | supervisor |
//!
//! A process opens one [`Bus`] and sleeps on one [`Doorbell`]. A sender rings the receiver's bell. A process that was
//! rung reads all its ports until each is empty. Ports belong to the thread that created them.
//!
//! The bus does not guarantee delivery: a trajectory is lost to a reader that was not connected yet or has not read
//! for long. The learner then hands out its lease again ([`TrajectoryPublisher::publish`]).

mod address;
mod asker;
mod chatter;
mod doorbell;
mod member;
mod newest;
mod private;
mod question;
mod room;
mod trajectories;

use std::fmt::Debug;
use std::rc::Rc;
use std::time::{Duration, Instant};

use iceoryx2::prelude::{
    CallbackProgression, Config, Node, NodeBuilder, NodeName, NodeState, ServiceName,
    SignalHandlingMode,
};
use iceoryx2::service::ipc::Service as SharedMemory;
use protocol::{Error, MAX_ACTORS};

use address::CREATION_TIMEOUT;
use doorbell::Ringers;
use trajectories::Rule;

pub use address::BusAddress;
pub use asker::LeaseAsker;
pub use doorbell::{Doorbell, Ringer, Role, Sleeper};
pub use member::Member;
use member::members;
pub use newest::{NewestPublisher, NewestSubscriber, POLICY_VERSIONS};
pub use question::{Client, Pending, Request, Server};
pub use room::check_shared_memory_room;
pub use trajectories::{
    Published, TRAJECTORY_BUFFER, TrajectoryHeader, TrajectoryPublisher, TrajectorySubscriber,
};

/// Maximum number of nodes of one bus: the actors, the three other processes, tools, and restarted processes whose
/// dead predecessors have not been cleaned up yet.
const MAX_NODES: usize = MAX_ACTORS + 16;

/// Maximum number of learners, or of proximity services, on a bus: one, and a second one that replaces a dead one.
const MAX_INCARNATIONS: usize = 2;

/// The proximity service's name on the bus.
pub const SERVICE_NAME: &str = "proximity-service";

/// How long opening a service is retried: a process that is cleaning up disturbs it for a moment.
const OPEN_PATIENCE: Duration = Duration::from_secs(2);

/// A process's connection to the bus of a run. Its ports may outlive it.
#[derive(Debug)]
pub struct Bus {
    address: BusAddress,
    node: Node<SharedMemory>,
    ringers: Rc<Ringers>,
}

impl Bus {
    /// Joins the bus at `address` under the process's `name`, such as `actor-3`.
    ///
    /// # Errors
    /// When the name is longer than 128 bytes, the bus folder is not private to this user, or the node cannot be
    /// created.
    pub fn open(address: &BusAddress, name: &str) -> Result<Self, Error> {
        let config = address.config()?;
        chatter::quieten();
        address.enter()?;
        address.claim_defaults(&config)?;
        let node_name = NodeName::new(name).map_err(failed("naming of a node", name))?;
        let node = NodeBuilder::new()
            .name(&node_name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<SharedMemory>()
            .map_err(failed("creation of a node", name))?;
        address.close_to_others()?;
        Ok(Bus { address: address.clone(), node, ringers: Rc::new(Ringers::default()) })
    }

    /// Returns the names of the living processes on this bus, sorted, including this one.
    ///
    /// # Errors
    /// When the bus cannot be listed.
    pub fn alive(&self) -> Result<Vec<String>, Error> {
        alive(self.node.config())
    }

    /// Frees what dead processes left: a reader's full buffer, a server's slot, memory. Nothing notices a death by
    /// itself, so the supervisor and the learner call this every half second. Returns how many dead processes were
    /// cleaned up.
    pub fn clean_up(&self) -> u64 {
        clean_up(&self.address, CREATION_TIMEOUT).unwrap_or_else(|error| {
            tracing::debug!("dead processes could not be cleaned away yet: {error}");
            0
        })
    }

    /// Opens the bell that this process sleeps on.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn doorbell(&self, role: Role) -> Result<Doorbell, Error> {
        Doorbell::new(&self.node, role)
    }

    /// Returns the ringer that wakes every process with `role`. Ports ring by themselves.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn ringer(&self, role: Role) -> Result<Rc<Ringer>, Error> {
        self.ringers.of(&self.node, role)
    }

    /// Wakes one process.
    ///
    /// # Errors
    /// When the bell is broken, or its service cannot be opened.
    pub fn wake(&self, sleeper: Sleeper) -> Result<(), Error> {
        self.ringer(sleeper.role)?.ring_one(sleeper.node)
    }

    /// Opens a publisher of a rollout's trajectories. If the queue of a reader that learns is full, sending waits up
    /// to `patience` for this reader, and then skips it until it has read again; it will ask for what it misses.
    /// Sending waits for no other reader, so no tool can delay training.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn rollout_publisher(&self, patience: Duration) -> Result<TrajectoryPublisher, Error> {
        TrajectoryPublisher::new(self, Rule::Learning, patience)
    }

    /// Opens a publisher of trajectories that no reader may miss. If a reader's queue is full, sending waits up to
    /// `patience` and then fails.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn trajectory_publisher(&self, patience: Duration) -> Result<TrajectoryPublisher, Error> {
        TrajectoryPublisher::new(self, Rule::Everybody, patience)
    }

    /// Opens a subscriber to trajectories for readers that learn: the learner and the proximity service.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn learning_subscriber(&self) -> Result<TrajectorySubscriber, Error> {
        TrajectorySubscriber::new(self, true)
    }

    /// Opens a subscriber to trajectories, which misses some if it does not keep up with the actors.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn trajectory_subscriber(&self) -> Result<TrajectorySubscriber, Error> {
        TrajectorySubscriber::new(self, false)
    }

    /// Opens a publisher of weights of at most `max_bytes`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn weights_publisher(&self, max_bytes: usize) -> Result<NewestPublisher, Error> {
        NewestPublisher::new(self, &newest::WEIGHTS, max_bytes)
    }

    /// Opens a subscriber to the two newest weights, the older one first.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn weights_subscriber(&self) -> Result<NewestSubscriber, Error> {
        NewestSubscriber::new(self, &newest::WEIGHTS)
    }

    /// Opens a publisher of progress of at most `max_bytes`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn progress_publisher(&self, max_bytes: usize) -> Result<NewestPublisher, Error> {
        NewestPublisher::new(self, &newest::PROGRESS, max_bytes)
    }

    /// Opens a subscriber to the newest progress.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn progress_subscriber(&self) -> Result<NewestSubscriber, Error> {
        NewestSubscriber::new(self, &newest::PROGRESS)
    }

    /// Opens a client that asks the learner for leases. The answer rings `doorbell`, which may belong to another node
    /// of the process.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn lease_client(&self, doorbell: &Doorbell) -> Result<Client, Error> {
        Client::new(self, &question::LEASES, doorbell)
    }

    /// Opens a client that asks the learner for leases repeatedly. The answer rings `doorbell`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn lease_asker(&self, doorbell: &Doorbell) -> Result<LeaseAsker, Error> {
        self.lease_client(doorbell).map(LeaseAsker::new)
    }

    /// Opens the server that answers requests for leases.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn lease_server(&self) -> Result<Server, Error> {
        Server::new(self, &question::LEASES)
    }

    /// Opens a client that asks the proximity service. The answer rings `doorbell`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn score_client(&self, doorbell: &Doorbell) -> Result<Client, Error> {
        Client::new(self, &question::SCORES, doorbell)
    }

    /// Opens the server that answers for the proximity service.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn score_server(&self) -> Result<Server, Error> {
        Server::new(self, &question::SCORES)
    }
}

fn alive(config: &Config) -> Result<Vec<String>, Error> {
    let living = members(config)?.into_iter().filter(|member| member.lives);
    Ok(living.map(|member| member.name).collect())
}

/// Frees what dead processes left; returns how many of them were cleaned up. The creator of an object without a size is
/// taken for dead after `patience`; before that, nothing is cleaned up.
fn clean_up(address: &BusAddress, patience: Duration) -> Result<u64, Error> {
    // iceoryx2 would wait for the size of an object whose creator has died.
    if address.remove_sizeless(patience)? {
        // Its creator is still at work or has just died: the next call will know.
        return Ok(0);
    }
    let mut cleaned = 0;
    Node::<SharedMemory>::list(&address.config()?, |state| {
        if let NodeState::Dead(view) = state {
            match view.try_remove_stale_resources() {
                Ok(()) => cleaned += 1,
                // Another process may be cleaning the same node; the next round sees what is left.
                Err(error) => tracing::debug!("a dead node could not be cleaned away yet: {error}"),
            }
        }
        CallbackProgression::Continue
    })
    .map_err(failed("cleaning away of dead nodes", "bus"))?;
    Ok(cleaned)
}

/// Opens a service or port, retrying for a while if it fails.
fn opened<T, E: Debug>(
    operation: &'static str,
    service: &str,
    mut open: impl FnMut() -> Result<T, E>,
) -> Result<T, Error> {
    let start = Instant::now();
    loop {
        match open() {
            Ok(value) => return Ok(value),
            Err(error) if start.elapsed() > OPEN_PATIENCE => {
                return Err(failed(operation, service)(error));
            }
            Err(_) => std::thread::sleep(Duration::from_millis(20)),
        }
    }
}

fn service_name(name: &str) -> Result<ServiceName, Error> {
    ServiceName::new(name).map_err(failed("naming", name))
}

/// Converts an error of iceoryx2 to ours.
fn failed<E: Debug>(operation: &'static str, service: &str) -> impl FnOnce(E) -> Error {
    move |error| Error::Bus {
        operation,
        service: service.to_owned(),
        message: format!("{error:?}"),
    }
}
