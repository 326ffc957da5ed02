//! The desk of a host: it owns the gateway's ports on the host's bus and stands in for the learner there.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bus::{
    Bus, BusAddress, Doorbell, NewestPublisher, Published, Request, Role, Server,
    TrajectorySubscriber,
};
use bytes::Bytes;
use prost::Message;
use protocol::dropped::Dropped;
use protocol::messages::{LeaseReply, LeaseRequest};
use protocol::weights::Weights;
use run::folder::RunFolder;
use run::process::Stop;
use tokio::sync::mpsc::Sender;

use super::actor::LocalActor;
use super::{Incoming, Outgoing};

/// Longest sleep, so that a stop is noticed. Everything else rings the doorbell. An actor that starts late requests
/// leases, and receives the current weights before the reply.
const TICK: Duration = Duration::from_millis(250);

/// How often dead processes are cleaned up and the living actors are reported.
const LOOK_AFTER_ACTORS: Duration = Duration::from_millis(500);

/// Largest number of requests received at once.
const TAKEN_AT_ONCE: usize = 64;

/// How long actors may take to leave a run that is over.
const FAREWELL: Duration = Duration::from_secs(5);

/// The desk of a host.
pub(super) struct Desk {
    bus: Bus,
    doorbell: Doorbell,
    trajectories: TrajectorySubscriber,
    leases: Server,
    weights: Option<NewestPublisher>,
    outgoing: Sender<Outgoing>,
    incoming: Receiver<Incoming>,
    /// Requests of actors whose trajectories may not have been received yet.
    taken: Vec<(LeaseRequest, Request)>,
    actors: BTreeMap<String, LocalActor>,
    alive: Vec<String>,
    looked_after: Option<Instant>,
    dropped: Dropped,
    over: Option<Instant>,
}

impl Desk {
    pub(super) fn open(
        folder: &RunFolder,
        outgoing: Sender<Outgoing>,
        incoming: Receiver<Incoming>,
    ) -> Result<Desk> {
        let bus = Bus::open(&BusAddress::of_run(folder.path())?, "gateway")?;
        Ok(Desk {
            doorbell: bus.doorbell(Role::Learner)?,
            trajectories: bus.learning_subscriber()?,
            leases: bus.lease_server()?,
            weights: None,
            outgoing,
            incoming,
            taken: Vec::new(),
            actors: BTreeMap::new(),
            alive: Vec::new(),
            looked_after: None,
            dropped: Dropped::new("messages of actors"),
            over: None,
            bus,
        })
    }

    /// Works until the run is over and its actors have been told, or a stop is requested.
    pub(super) fn run(&mut self, stop: &Stop) -> Result<()> {
        let mut are_more = false;
        while !stop.is_requested() && !self.is_over() {
            self.doorbell.wait(if are_more { Duration::ZERO } else { TICK })?;
            self.take_news()?;
            self.take_questions();
            let room = self.outgoing.capacity();
            let taken = self.take_trajectories(room)?;
            if taken < room {
                // Whatever an actor published before its request has been received by now.
                self.sort_questions();
            }
            are_more = taken == room && room > 0;
            self.send();
            // Before the reply: an actor that starts late needs the policy that its leases name.
            if let Some(weights) = &self.weights {
                weights.refresh()?;
            }
            self.answer();
            self.look_after_actors()?;
        }
        Ok(())
    }

    fn is_over(&self) -> bool {
        let is_anyone_there = || self.alive.iter().any(|name| name.starts_with("actor"));
        self.over.is_some_and(|since| since.elapsed() > FAREWELL || !is_anyone_there())
    }

    fn take_news(&mut self) -> Result<()> {
        loop {
            match self.incoming.try_recv() {
                Ok(Incoming::Delivered { actor }) => {
                    if let Some(actor) = self.actors.get_mut(&actor) {
                        actor.delivered();
                    }
                }
                Ok(Incoming::Weights(bytes)) => self.publish(&bytes)?,
                Ok(Incoming::Answered { actor, number, reply }) => {
                    if reply.finished {
                        self.over.get_or_insert_with(Instant::now);
                    }
                    if let Some(actor) = self.actors.get_mut(&actor) {
                        actor.answered(number, reply);
                    }
                }
                Ok(Incoming::Over) => {
                    self.over.get_or_insert_with(Instant::now);
                }
                Ok(Incoming::Failed(why)) => return Err(why),
                Err(TryRecvError::Empty) => return Ok(()),
                Err(TryRecvError::Disconnected) => anyhow::bail!("the link to the hub has ended"),
            }
        }
    }

    fn publish(&mut self, bytes: &Bytes) -> Result<()> {
        if self.weights.is_none() {
            let weights =
                Weights::decode(bytes.clone()).context("undecodable weights of the hub")?;
            let longest = Weights { version: u64::MAX, ..weights }.encoded_len();
            self.weights = Some(self.bus.weights_publisher(longest)?);
        }
        if let Some(weights) = &self.weights {
            weights.publish(bytes)?;
        }
        Ok(())
    }

    fn take_questions(&mut self) {
        for _ in 0..TAKEN_AT_ONCE {
            match self.leases.receive() {
                Ok(Some(question)) => match LeaseRequest::decode(question.bytes()) {
                    Ok(request) => self.taken.push((request, question)),
                    Err(why) => self.dropped.note(why),
                },
                Ok(None) => return,
                Err(why) => return self.dropped.note(why),
            }
        }
    }

    /// Receives at most `most` trajectories; returns how many.
    fn take_trajectories(&mut self, most: usize) -> Result<usize> {
        for taken in 0..most {
            let Some(Published { bytes, process, .. }) = self.trajectories.receive()? else {
                return Ok(taken);
            };
            let suffix = format!("-{process}");
            // An actor requests leases before it acts, so it is known.
            match self.actors.iter_mut().find(|(name, _)| name.ends_with(&suffix)) {
                Some((_, actor)) => actor.trajectories.push_back(bytes),
                None => self.dropped.note(format!("process {process} is no actor of this host")),
            }
        }
        Ok(most)
    }

    fn sort_questions(&mut self) {
        for (request, question) in std::mem::take(&mut self.taken) {
            self.actors.entry(request.actor.clone()).or_default().take(request, question);
        }
    }

    /// Hands over what is due, as far as the link has room.
    fn send(&mut self) {
        for (name, actor) in &mut self.actors {
            while let Ok(place) = self.outgoing.try_reserve()
                && let Some(outgoing) = actor.due(name)
            {
                place.send(outgoing);
            }
        }
    }

    fn answer(&mut self) {
        let over = LeaseReply { finished: true, ..LeaseReply::default() };
        for actor in self.actors.values_mut() {
            let reply = if self.over.is_some() {
                actor.take_question().map(|question| (question, over.clone()))
            } else {
                actor.take_reply()
            };
            if let Some((question, reply)) = reply
                && let Err(why) = question.reply(&reply.encode_to_vec())
            {
                self.dropped.note(why);
            }
        }
    }

    fn look_after_actors(&mut self) -> Result<()> {
        if self.looked_after.is_some_and(|looked| looked.elapsed() < LOOK_AFTER_ACTORS) {
            return Ok(());
        }
        self.looked_after = Some(Instant::now());
        self.bus.clean_up();
        self.alive = self.bus.alive()?;
        self.actors.retain(|name, _| self.alive.contains(name));
        let actors = self.actors.keys().cloned().collect();
        self.outgoing.try_send(Outgoing::Alive(actors)).ok();
        Ok(())
    }
}
