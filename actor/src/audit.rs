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

/// Describes the first difference between two encoded episodes.
fn difference(expected: &Encoded, found: &Encoded) -> String {
    let Trajectory { lane, episode, .. } = expected.trajectory;
    let what = if expected.trajectory == found.trajectory {
        let (expected, found) = (expected.bytes.len(), found.bytes.len());
        format!("another encoding: expected its {expected} bytes, found {found}")
    } else {
        first_difference(&expected.trajectory, &found.trajectory)
    };
    format!("lane {lane} episode {episode}, {what}")
}

/// Reads the next request; returns `None` at the end of the input.
fn next(input: &mut impl BufRead) -> Result<Option<AuditRequest>> {
    if input.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let mut length = [0; 8];
    input.read_exact(&mut length).context("reading a request")?;
    let length = u64::from_le_bytes(length) as usize;
    ensure!(
        length <= MOST_BYTES,
        "expected a request of at most {MOST_BYTES} bytes, found {length}"
    );
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
        let found = Encoded::decode(request.trajectory, &self.config.task.spec())?;
        let expected = Encoded::encode(self.act(&found.trajectory)?);
        Ok((expected.bytes != found.bytes).then(|| difference(&expected, &found)))
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

#[cfg(test)]
mod tests {
    use std::fs;

    use environments::BUILT_IN;

    use super::*;
    use crate::evaluate::act;

    #[test]
    fn only_the_same_bytes_pass() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let config = run::tasks::configuration("navigation", None, &[]).unwrap();
        fs::write(folder.config_file(), config.to_text()).unwrap();
        let factory = Factory::of_run(BUILT_IN, &config).unwrap();
        let weights = Policy::new(&config).initial_weights(config.seed);
        let acted = act(&factory, &config, &weights, 1, config.seed).unwrap().remove(0);
        let (lane, episode) = (acted.lane, acted.episode);
        let honest = Encoded::encode(acted.clone()).bytes;
        // A field of number 100, which decoding passes over.
        let padded = Bytes::from([&honest[..], &[0xa0, 0x06, 1]].concat());
        let otherwise =
            Encoded::encode(Trajectory { state_hash: !acted.state_hash, ..acted }).bytes;
        let mut input = Vec::new();
        for trajectory in [honest.clone(), padded, otherwise] {
            let weights = Some(Bytes::from(weights.encode_to_vec()));
            let request = AuditRequest { weights, trajectory }.encode_to_vec();
            input.extend((request.len() as u64).to_le_bytes());
            input.extend(request);
        }
        let mut output = Vec::new();
        audit(BUILT_IN, &folder, &mut &input[..], &mut output).unwrap();
        let output = String::from_utf8(output).unwrap();
        let said: Vec<&str> = output.lines().collect();
        let [same, padded, otherwise] = said[..] else { panic!("found {said:?}") };
        assert_eq!(same, "null");
        let bytes = honest.len();
        let words = format!("another encoding: expected its {bytes} bytes, found {}", bytes + 3);
        assert_eq!(padded, format!("\"lane {lane} episode {episode}, {words}\""));
        assert!(otherwise.contains("expected the state"), "{otherwise}");
    }
}
