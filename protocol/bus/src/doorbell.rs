//! Wakes sleeping processes. There is one bell per role, so that a process sleeps on one thing only.
//!
//! A ring only says that there is something to look at. Rings coalesce while nobody listens, and a wait may end
//! without a ring, so the process checks all its ports after every wait.

use std::cell::OnceCell;
use std::rc::Rc;
use std::time::Duration;

use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::{CallbackProgression, Node};
use iceoryx2::service::port_factory::event::PortFactory;
use protocol::{Error, MAX_ACTORS};

use super::{MAX_NODES, SharedMemory, failed, opened, service_name};

/// The role of a process, which determines its doorbell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Role {
    /// The learner.
    Learner = 0,
    /// The proximity service.
    ProximityService = 1,
    /// All actors.
    Actors = 2,
    /// The supervisor, and tools that watch a run or ask about it.
    Supervisor = 3,
}

impl Role {
    /// Every role, in the order of their numbers.
    pub(super) const ALL: [Role; 4] =
        [Role::Learner, Role::ProximityService, Role::Actors, Role::Supervisor];

    fn bell(self) -> &'static str {
        match self {
            Role::Learner => "doorbell of the learner",
            Role::ProximityService => "doorbell of the proximity service",
            Role::Actors => "doorbell of the actors",
            Role::Supervisor => "doorbell of the supervisor",
        }
    }
}

/// Maximum number of nodes that ring: those of the bus, where stand-ins represent the actors of other machines, and
/// one for each of these machines.
const MAX_RINGERS: usize = MAX_NODES + MAX_ACTORS;

fn open_service(node: &Node<SharedMemory>, role: Role) -> Result<PortFactory<SharedMemory>, Error> {
    let name = service_name(role.bell())?;
    opened("opening", role.bell(), || {
        node.service_builder(&name)
            .event()
            .max_nodes(MAX_RINGERS)
            .max_listeners(MAX_NODES)
            .max_notifiers(MAX_RINGERS)
            // Rings carry no meaning, so one event is enough.
            .event_id_max_value(0)
            .open_or_create()
    })
}

/// The bell a process sleeps on.
#[derive(Debug)]
pub struct Doorbell {
    listener: Listener<SharedMemory>,
    bell: &'static str,
    sleeper: Sleeper,
}

/// A process that sleeps on the bell of a role. It allows waking this process alone.
#[derive(Clone, Copy, Debug)]
pub struct Sleeper {
    pub(super) role: Role,
    /// Its node on the bus.
    pub(super) node: u128,
}

impl Doorbell {
    pub(super) fn new(node: &Node<SharedMemory>, role: Role) -> Result<Self, Error> {
        let service = open_service(node, role)?;
        let bell = role.bell();
        let listener =
            opened("creation of a listener", bell, || service.listener_builder().create())?;
        let sleeper = Sleeper { role, node: node.id().value() };
        Ok(Doorbell { listener, bell, sleeper })
    }

    /// Returns the process that sleeps on this bell.
    pub fn sleeper(&self) -> Sleeper {
        self.sleeper
    }

    /// Sleeps until somebody rings or `timeout` has passed, and consumes all rings. Returns whether it was rung. A
    /// signal to the process also ends the wait.
    ///
    /// # Errors
    /// When the bell is broken.
    pub fn wait(&self, timeout: Duration) -> Result<bool, Error> {
        let mut rung = false;
        // For a socket, a timeout of zero means to wait forever.
        let result = if timeout < Duration::from_micros(1) {
            self.listener.try_wait(|_| rung = true)
        } else {
            self.listener.timed_wait(|_| rung = true, timeout)
        };
        match result {
            Ok(_) => Ok(rung),
            Err(ListenerWaitError::InterruptSignal) => Ok(rung),
            Err(error) => Err(failed("waiting", self.bell)(error)),
        }
    }
}

/// Rings the bell of a role.
#[derive(Debug)]
pub struct Ringer {
    notifier: Notifier<SharedMemory>,
    bell: &'static str,
}

impl Ringer {
    fn new(node: &Node<SharedMemory>, role: Role) -> Result<Self, Error> {
        let service = open_service(node, role)?;
        let bell = role.bell();
        let notifier =
            opened("creation of a notifier", bell, || service.notifier_builder().create())?;
        Ok(Ringer { notifier, bell })
    }

    /// Wakes every process with the role. Never blocks.
    ///
    /// # Errors
    /// When the bell is broken.
    pub fn ring(&self) -> Result<(), Error> {
        self.notifier.notify().map_err(failed("ringing", self.bell))?;
        Ok(())
    }

    /// Wakes only the process with this node.
    pub(super) fn ring_one(&self, node: u128) -> Result<(), Error> {
        let mut result = Ok(());
        self.notifier.for_each_listener(|listener, details| {
            if details.node_id.value() == node {
                result = listener.notify().map_err(failed("ringing", self.bell));
            }
            CallbackProgression::Continue
        });
        result
    }
}

/// The ringers of one process, each opened when it is first needed.
#[derive(Debug)]
pub(super) struct Ringers([OnceCell<Rc<Ringer>>; 4]);

impl Default for Ringers {
    fn default() -> Self {
        Ringers(std::array::from_fn(|_| OnceCell::new()))
    }
}

impl Ringers {
    pub(super) fn of(&self, node: &Node<SharedMemory>, role: Role) -> Result<Rc<Ringer>, Error> {
        let cell = &self.0[role as usize];
        if let Some(ringer) = cell.get() {
            return Ok(Rc::clone(ringer));
        }
        let ringer = Rc::new(Ringer::new(node, role)?);
        Ok(Rc::clone(cell.get_or_init(|| ringer)))
    }
}
