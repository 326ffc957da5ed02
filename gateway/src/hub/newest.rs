//! The newest weights, received from the learner's bus for all hosts.

use std::time::Duration;

use anyhow::{Context, Result};
use bus::{Bus, BusAddress, POLICY_VERSIONS, Role};
use bytes::Bytes;
use prost::Message;
use protocol::dropped::Dropped;
use protocol::weights::Weights;
use run::folder::RunFolder;
use run::process::Stop;
use tokio::sync::watch;

/// How often to check whether the hub is to stop.
const TICK: Duration = Duration::from_millis(250);

/// The newest weights as the learner encoded them, by version, the newest last.
#[derive(Clone, Debug, Default)]
pub(super) struct Newest(Vec<(u64, Bytes)>);

impl Newest {
    pub(super) fn of_version(&self, version: u64) -> Option<Bytes> {
        let found = self.0.iter().find(|(number, _)| *number == version);
        found.map(|(_, weights)| weights.clone())
    }

    pub(super) fn take(&mut self, version: u64, weights: Bytes) {
        self.0.retain(|(number, _)| *number != version);
        self.0.push((version, weights));
        if self.0.len() > POLICY_VERSIONS {
            self.0.remove(0);
        }
    }
}

/// Starts a thread that receives weights from the bus of a run.
///
/// # Errors
/// When the bus cannot be opened.
pub(super) fn watch(folder: &RunFolder, stop: &Stop) -> Result<watch::Receiver<Newest>> {
    let (told, newest) = watch::channel(Newest::default());
    let (address, stop) = (BusAddress::of_run(folder.path())?, stop.clone());
    let body = move || {
        if let Err(error) = follow(&address, &told, &stop) {
            tracing::error!("weights of the run: {error:#}");
        }
    };
    std::thread::Builder::new()
        .name("weights".to_owned())
        .spawn(body)
        .context("starting a thread")?;
    Ok(newest)
}

fn follow(address: &BusAddress, told: &watch::Sender<Newest>, stop: &Stop) -> Result<()> {
    let bus = Bus::open(address, "gateway")?;
    let doorbell = bus.doorbell(Role::Actors)?;
    let weights = bus.weights_subscriber()?;
    let mut dropped = Dropped::new("weights");
    while !stop.is_requested() {
        while let Some(bytes) = weights.receive()? {
            match Weights::decode(bytes.clone()) {
                Ok(decoded) => told.send_modify(|newest| newest.take(decoded.version, bytes)),
                Err(why) => dropped.note(why),
            }
        }
        doorbell.wait(TICK)?;
    }
    Ok(())
}
