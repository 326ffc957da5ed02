//! The supervisor's place on the bus: a thread that receives progress and cleans up behind the
//! dead. Ports belong to the thread that made them, so the thread keeps them and sends on what it
//! receives.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bus::{Bus, BusAddress, Role};
use prost::Message;
use protocol::Error;
use protocol::dropped::Dropped;
use protocol::messages::Progress;
use run::process::Stop;
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Nothing on the bus notices a death by itself.
const CLEAN_UP_EVERY: Duration = Duration::from_millis(500);

/// Progress waiting to be shown; what comes while it is full is left out.
const WAITING: usize = 4;

/// The thread.
pub(super) struct BusWatch {
    received: Receiver<Result<Progress, Error>>,
    stop: Stop,
    thread: JoinHandle<()>,
}

impl BusWatch {
    /// Joins the bus.
    pub(super) fn start(address: &BusAddress) -> Result<Self> {
        let (sender, received) = channel(WAITING);
        let stop = Stop::default();
        let (address, stopped) = (address.clone(), stop.clone());
        let thread = std::thread::Builder::new()
            .name("bus-watch".to_owned())
            .spawn(move || {
                if let Err(error) = watch(&address, &stopped, &sender) {
                    sender.blocking_send(Err(error)).ok();
                }
            })
            .context("starting the thread that watches the bus")?;
        Ok(BusWatch { received, stop, thread })
    }

    /// The next progress. Fails when the bus does.
    pub(super) async fn next(&mut self) -> Result<Progress> {
        let received = self.received.recv().await;
        Ok(received.context("the thread that watches the bus is gone")??)
    }

    /// Leaves the bus.
    pub(super) fn end(self) {
        self.stop.request();
        drop(self.received);
        if self.thread.join().is_err() {
            tracing::error!("the thread that watches the bus panicked");
        }
    }
}

fn watch(
    address: &BusAddress,
    stop: &Stop,
    sender: &Sender<Result<Progress, Error>>,
) -> Result<(), Error> {
    let bus = Bus::open(address, "supervisor")?;
    let doorbell = bus.doorbell(Role::Supervisor)?;
    let progress = bus.progress_subscriber()?;
    let mut dropped = Dropped::new("messages of progress");
    let mut cleaned = Instant::now();
    while !stop.is_requested() {
        doorbell.wait(CLEAN_UP_EVERY)?;
        while let Some(bytes) = progress.receive()? {
            match Progress::decode(bytes) {
                // What comes while the view is busy is left out.
                Ok(progress) => {
                    sender.try_send(Ok(progress)).ok();
                }
                Err(why) => dropped.note(why),
            }
        }
        if cleaned.elapsed() >= CLEAN_UP_EVERY {
            let dead = bus.clean_up();
            if dead > 0 {
                tracing::debug!("cleaned up behind {dead} dead processes");
            }
            cleaned = Instant::now();
        }
    }
    Ok(())
}
