//! The supervisor's end of the bus: a thread that receives progress and cleans up after dead processes. Ports belong to
//! the thread that made them, so the thread keeps them and passes on what it receives.

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

/// Time between two clean-ups, since nothing on the bus notices a death by itself.
const CLEAN_UP_EVERY: Duration = Duration::from_millis(500);

/// Most progress messages that wait to be shown; those that arrive while the queue is full are dropped.
const WAITING: usize = 4;

/// The thread that watches the bus.
pub(super) struct BusWatch {
    received: Receiver<Result<Progress, Error>>,
    stop: Stop,
    thread: JoinHandle<()>,
}

impl BusWatch {
    /// Starts the thread, which joins the bus.
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

    /// Waits for the next progress. Fails when the bus does.
    pub(super) async fn next(&mut self) -> Result<Progress> {
        let received = self.received.recv().await;
        Ok(received.context("the thread that watches the bus is gone")??)
    }

    /// Leaves the bus and ends the thread.
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
                // Progress that arrives while the view is busy is dropped.
                Ok(progress) => {
                    sender.try_send(Ok(progress)).ok();
                }
                Err(why) => dropped.note(why),
            }
        }
        if cleaned.elapsed() >= CLEAN_UP_EVERY {
            let dead = bus.clean_up();
            if dead > 0 {
                tracing::debug!("removed what {dead} dead processes left on the bus");
            }
            cleaned = Instant::now();
        }
    }
    Ok(())
}
