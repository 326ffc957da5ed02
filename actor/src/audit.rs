//! `goalward-actor audit`: episodes that another machine ran are run again with the same policy, and must come
//! out the same, bit for bit.

use std::io::{BufRead, Write};

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use prost::Message;
use protocol::messages::{AuditRequest, Lease};
use protocol::trajectory::{Encoded, Source, Trajectory};
use protocol::weights::Weights;
use run::config::RunConfig;
use run::folder::RunFolder;

use crate::episode::Episode;
use crate::factory::{Factory, Tasks};
use crate::lane::Lane;
use crate::policy::{Policy, Version};
use crate::verify::first_difference;

/// Longest request in bytes: weights and a trajectory.
const MOST_BYTES: usize = 128 << 20;

/// Answers the requests in `input`, each of which follows its length.
///
/// # Errors
/// When the task is not among `tasks`, an environment fails, or a request cannot be read.
pub(crate) fn audit(
    tasks: Tasks,
    folder: &RunFolder,
    input: &mut impl BufRead,
    output: &mut impl Write,
) -> Result<()> {
    let config = folder.config()?;
    let factory = Factory::of_run(tasks, &config)?;
    let policy = Policy::new(&config);
    let mut auditor = Auditor { config, factory, policy, version: None, rested: None };
    while let Some(request) = next(input)? {
        let difference = auditor.difference(request)?;
        writeln!(output, "{}", serde_json::to_string(&difference)?)?;
        output.flush()?;
    }
    Ok(())
}

/// Reads the next request; returns `None` at the end of the input.
fn next(input: &mut impl BufRead) -> Result<Option<AuditRequest>> {
    if input.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let mut length = [0; 8];
    input.read_exact(&mut length).context("reading a request")?;
    let length = u64::from_le_bytes(length) as usize;
    ensure!(length <= MOST_BYTES, "expected a request, found one of {length} bytes");
    let mut bytes = vec![0; length];
    input.read_exact(&mut bytes).context("reading a request")?;
    Ok(Some(AuditRequest::decode(Bytes::from(bytes))?))
}

struct Auditor {
    config: RunConfig,
    factory: Factory,
    policy: Policy,
    version: Option<Version>,
    rested: Option<Episode>,
}

impl Auditor {
    /// Returns how an episode differs from the one that this machine produces, if it does.
    fn difference(&mut self, request: AuditRequest) -> Result<Option<String>> {
        if let Some(weights) = request.weights {
            self.version = Some(self.policy.version(&Weights::decode(weights)?)?);
        }
        let found = Encoded::decode(request.trajectory, &self.config.task.spec())?.trajectory;
        let expected = self.act(&found)?;
        let Trajectory { lane, episode, .. } = found;
        let place =
            || format!("lane {lane} episode {episode}, {}", first_difference(&expected, &found));
        Ok((expected != found).then(place))
    }

    /// Runs the episode that `named` identifies, on this machine.
    fn act(&mut self, named: &Trajectory) -> Result<Trajectory> {
        let version = self.version.as_ref().context("expected weights, found none")?;
        let lease = Lease {
            source: named.source,
            iteration: named.iteration,
            lane: named.lane,
            policy_version: version.number,
            first_episode: named.episode,
            steps_owed: 0,
            episodes_owed: 1,
        };
        let choice = self.config.evaluation.actions_of(Source::try_from(named.source)?);
        let rested = self.rested.take();
        let mut lane = Lane::begin(lease, &self.factory, rested, self.config.seed)?;
        loop {
            let acting = std::slice::from_mut(&mut lane);
            if let Some(trajectory) = self.policy.step(version, acting, choice)?.pop() {
                self.rested = Some(lane.episode);
                return Ok(trajectory);
            }
        }
    }
}
