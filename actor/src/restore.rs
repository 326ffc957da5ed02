//! `goalward log restore`: writes a log that holds only actions again, now with its observations. Every episode
//! without observations is re-simulated, and must come out, bit for bit, as the one that was learned from.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use mcap_log::rewrite;
use prost::Message;
use protocol::Error;
use protocol::trajectory::{Encoded, Trajectory};
use run::folder::RunFolder;
use serde::Serialize;

use crate::factory::{Factory, Tasks};
use crate::resimulate::Resimulator;

/// Bytes of restored episodes that are held at a time, and at most how many messages.
const HELD_AT_ONCE: [u64; 2] = [256 << 20, 4096];

/// The result, as it is printed.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Restored {
    /// Episodes in the new log.
    pub(crate) episodes: u64,
    /// Those of them that had been recorded without observations.
    pub(crate) restored: u64,
}

/// Writes the log of a run with all observations into the folder `out`, on `threads` threads; 0 uses all cores.
///
/// # Errors
/// When such an episode does not come out as it was recorded, or a file cannot be read or written.
pub(crate) fn restore(
    tasks: Tasks,
    folder: &RunFolder,
    out: &Path,
    threads: usize,
) -> Result<Restored> {
    let config = folder.config()?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let factory = Factory::for_resimulation(tasks, &config)?;
    let mut resimulator = Resimulator::new(&threads, &factory)?;
    let spec = resimulator.spec();
    let mut found = Restored::default();
    let [bytes, messages] = HELD_AT_ONCE;
    let at_once = (bytes / Trajectory::most_bytes(&spec, true)).clamp(1, messages) as usize;
    rewrite(&folder.log(), out, at_once, |recorded| -> Result<Vec<Bytes>> {
        let recorded = recorded.into_iter().map(|bytes| Trajectory::recorded(bytes, &spec));
        let recorded: Vec<Trajectory> = recorded.collect::<Result<_, Error>>()?;
        found.episodes += recorded.len() as u64;
        found.restored += recorded.iter().filter(|one| one.is_actions_only()).count() as u64;
        resimulator.each(&recorded, with_observations).into_iter().collect()
    })?;
    Ok(found)
}

fn with_observations(recorded: &Trajectory, again: Result<Trajectory>) -> Result<Bytes> {
    if !recorded.is_actions_only() {
        return Ok(recorded.encode_to_vec().into());
    }
    let Trajectory { lane, episode, full_hash, .. } = recorded;
    let name = || format!("lane {lane} episode {episode}");
    let encoded = Encoded::encode(again.with_context(name)?);
    let found = encoded.key.hash;
    ensure!(
        found == *full_hash,
        "{}: expected the hash {full_hash:016x} when it is re-simulated, found {found:016x}",
        name()
    );
    Ok(encoded.bytes)
}
