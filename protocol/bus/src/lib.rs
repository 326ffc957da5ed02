//! How everything travels between the processes of one run: shared memory, by iceoryx2.
//!
//! Only this module names iceoryx2; it carries bytes and knows no message. Who sends what to whom,
//! and whose doorbell is rung by it:
//!
//! | service | from | to | kept when the reader is slow | doorbell |
//! |---|---|---|---|---|
//! | trajectories | actors | learner, proximity service, tools | hundreds; the actor waits a moment for the first two | theirs |
//! | weights | learner | actors | the newest two | actors |
//! | leases | actors ask | learner answers | one answer per question | learner, then the asker |
//! | scores | anyone asks | proximity service answers | one answer per question | likewise |
//! | progress | learner | supervisor, tools | the newest | supervisor |
//!
//! A process opens one [`Bus`] and sleeps on one [`Doorbell`]. Whoever sends rings the receiver's
//! bell; whoever is rung looks at everything it receives, until each port says that it is empty.
//! Ports belong to the thread that made them.
//!
//! What the bus does not promise is settled above it: a trajectory whose reader was not connected yet, or
//! did not read for long, is gone, so the learner hands its lease out again ([`TrajectoryPublisher::publish`]).

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

/// Nodes of one bus: the actors, the three other processes, tools, and room for restarted ones that
/// come back before their dead predecessor is cleaned away.
const MAX_NODES: usize = MAX_ACTORS + 16;

/// A run has one learner and one proximity service; the second place is for the restarted one.
const MAX_INCARNATIONS: usize = 2;

/// The proximity service's name on the bus.
pub const SERVICE_NAME: &str = "proximity-service";

/// How long opening a service is tried: a neighbour that is cleaning up disturbs it for a moment.
const OPEN_PATIENCE: Duration = Duration::from_secs(2);

/// A process's place on the bus of a run. Ports outlive it.
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
    /// When the name is longer than 128 bytes, the bus folder is not this user's alone, or the node
    /// cannot be created.
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

    /// Names of the processes on this bus that live, sorted; this one is among them.
    ///
    /// # Errors
    /// When the bus cannot be listed.
    pub fn alive(&self) -> Result<Vec<String>, Error> {
        alive(self.node.config())
    }

    /// Frees what dead processes left: a reader's full buffer, a server's place, memory. Nothing
    /// notices a death by itself, so the supervisor and the learner call this every half second.
    /// Returns how many dead processes were cleaned away.
    pub fn clean_up(&self) -> u64 {
        match self.address.remove_sizeless(CREATION_TIMEOUT) {
            Ok(false) => {}
            // Its maker is at work, or has just died: the next call sees which.
            Ok(true) => return 0,
            Err(error) => {
                tracing::debug!("dead processes could not be cleaned away yet: {error}");
                return 0;
            }
        }
        self.node.try_cleanup_dead_nodes().cleanups
    }

    /// The bell this process sleeps on.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn doorbell(&self, role: Role) -> Result<Doorbell, Error> {
        Doorbell::new(&self.node, role)
    }

    /// Rings the bell of every process with `role`. Ports ring by themselves.
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

    /// Sends the trajectories of a rollout. Readers that learn are waited for while their queue is full,
    /// each for so long, and then not until it has read again: they ask for what they miss. Nobody else
    /// is waited for, so no tool can hold up training.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn rollout_publisher(&self, patience: Duration) -> Result<TrajectoryPublisher, Error> {
        TrajectoryPublisher::new(self, Rule::Learning, patience)
    }

    /// Sends trajectories to readers of which none is to miss any; `patience` is how long one whose queue
    /// is full is waited for before sending fails.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn trajectory_publisher(&self, patience: Duration) -> Result<TrajectoryPublisher, Error> {
        TrajectoryPublisher::new(self, Rule::Everybody, patience)
    }

    /// Receives trajectories to learn from: the learner and the proximity service.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn learning_subscriber(&self) -> Result<TrajectorySubscriber, Error> {
        TrajectorySubscriber::new(self, true)
    }

    /// Receives trajectories, as far as it keeps up with the actors.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn trajectory_subscriber(&self) -> Result<TrajectorySubscriber, Error> {
        TrajectorySubscriber::new(self, false)
    }

    /// Sends weights of at most `max_bytes`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn weights_publisher(&self, max_bytes: usize) -> Result<NewestPublisher, Error> {
        NewestPublisher::new(self, &newest::WEIGHTS, max_bytes)
    }

    /// Receives the newest two weights, the older one first.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn weights_subscriber(&self) -> Result<NewestSubscriber, Error> {
        NewestSubscriber::new(self, &newest::WEIGHTS)
    }

    /// Sends progress of at most `max_bytes`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn progress_publisher(&self, max_bytes: usize) -> Result<NewestPublisher, Error> {
        NewestPublisher::new(self, &newest::PROGRESS, max_bytes)
    }

    /// Receives the newest progress.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn progress_subscriber(&self) -> Result<NewestSubscriber, Error> {
        NewestSubscriber::new(self, &newest::PROGRESS)
    }

    /// Asks the learner for leases; the answer rings `doorbell`, which may be that of another node of the
    /// process.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn lease_client(&self, doorbell: &Doorbell) -> Result<Client, Error> {
        Client::new(self, &question::LEASES, doorbell)
    }

    /// Asks the learner for leases, again and again; the answer rings `doorbell`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn lease_asker(&self, doorbell: &Doorbell) -> Result<LeaseAsker, Error> {
        self.lease_client(doorbell).map(LeaseAsker::new)
    }

    /// Answers for leases.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn lease_server(&self) -> Result<Server, Error> {
        Server::new(self, &question::LEASES)
    }

    /// Asks the proximity service; the answer rings `doorbell`.
    ///
    /// # Errors
    /// When the service cannot be opened.
    pub fn score_client(&self, doorbell: &Doorbell) -> Result<Client, Error> {
        Client::new(self, &question::SCORES, doorbell)
    }

    /// Answers for the proximity service.
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

/// Frees what dead processes left, for those who hold no node.
fn clean_up(config: &Config) -> Result<(), Error> {
    Node::<SharedMemory>::list(config, |state| {
        if let NodeState::Dead(view) = state
            && let Err(error) = view.try_remove_stale_resources()
        {
            // Another process may be cleaning the same node; the next round sees what is left.
            tracing::debug!("a dead node could not be cleaned away yet: {error}");
        }
        CallbackProgression::Continue
    })
    .map_err(failed("cleaning away of dead nodes", "bus"))
}

/// Opens a service or port, again for a while when it fails.
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

/// Turns an error of iceoryx2 into ours.
fn failed<E: Debug>(operation: &'static str, service: &str) -> impl FnOnce(E) -> Error {
    move |error| Error::Bus {
        operation,
        service: service.to_owned(),
        message: format!("{error:?}"),
    }
}
