//! `goalward replay --verify`: every recorded episode is acted again, from its seeds and actions, and
//! must come out as it was recorded, bit for bit.

use std::time::Instant;

use anyhow::{Context, Result, ensure};
use environments::Setting;
use protocol::Error;
use protocol::log::{Contents, Entry, FileReader, read_contents};
use protocol::run::RunFolder;
use protocol::task::{Spec, Task};
use protocol::trajectory::{Encoded, Source, Trajectory};
use rayon::prelude::*;
use serde::Serialize;

use crate::episode::{Episode, EpisodeName};

/// Episodes that a thread acts before the next ones are read.
const CHUNK: usize = 64;

/// What a verification found, as it is printed.
#[derive(Debug, Default, Serialize)]
pub struct Verification {
    /// Episodes acted again.
    pub episodes: u64,
    /// Their steps.
    pub steps: u64,
    /// Episodes that came out as they were recorded.
    pub equal: u64,
    /// The first that did not, and where.
    pub first_difference: Option<String>,
    /// Files of which something could not be read, and why.
    pub damaged: Vec<String>,
    /// Wall time.
    pub seconds: f64,
}

/// Acts every episode of a run's log again, and the demonstrations it recorded itself, on so many
/// threads; 0 takes all cores.
pub fn verify(folder: &RunFolder, threads: usize) -> Result<Verification> {
    let begun = Instant::now();
    let config = folder.config()?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let mut verification = Verification::default();

    let file = folder.demonstrations_file();
    if file.exists() {
        let mut reader = FileReader::open(&file)?;
        let setting = reader.metadata().get("setting").context("demonstrations: setting")?;
        let setting = serde_json::from_str(setting).context("demonstrations: setting")?;
        let mut verifier = Verifier::new(&threads, config.task, setting, &mut verification);
        verifier.take_all(&mut reader)?;
        if let Some(ending) = reader.ending().filter(|ending| ending.lost()) {
            verification.damaged.push(format!("{}: {ending}", file.display()));
        }
    }

    let mut reader = read_contents(&folder.log(), Contents::Trajectories)?;
    let setting = config.environment.clone();
    let mut verifier = Verifier::new(&threads, config.task, setting, &mut verification);
    verifier.take_all(&mut reader)?;
    let damaged = reader.endings().iter().filter(|(_, ending)| ending.lost());
    let damaged = damaged.map(|(path, ending)| format!("{}: {ending}", path.display()));
    verification.damaged.extend(damaged);
    verification.seconds = begun.elapsed().as_secs_f64();
    Ok(verification)
}

/// Acts episodes of one setting again, many at a time.
struct Verifier<'a> {
    threads: &'a rayon::ThreadPool,
    spec: Spec,
    actors: Vec<Actor>,
    waiting: Vec<Trajectory>,
    verification: &'a mut Verification,
}

impl<'a> Verifier<'a> {
    fn new(
        threads: &'a rayon::ThreadPool,
        task: Task,
        setting: Setting,
        verification: &'a mut Verification,
    ) -> Self {
        let actor = || Actor { task, setting: setting.clone(), episode: None };
        let actors = std::iter::repeat_with(actor).take(threads.current_num_threads()).collect();
        Verifier { threads, spec: task.spec(), actors, waiting: Vec::new(), verification }
    }

    /// Acts every episode of a log again, many at a time.
    fn take_all(&mut self, log: impl Iterator<Item = Result<Entry, Error>>) -> Result<()> {
        for entry in log {
            let Some(bytes) = entry?.record.trajectory() else { continue };
            self.waiting.push(Encoded::decode(bytes, &self.spec)?.trajectory);
            if self.waiting.len() == CHUNK * self.actors.len() {
                self.act_waiting()?;
            }
        }
        self.act_waiting()
    }

    /// Acts what waits.
    fn act_waiting(&mut self) -> Result<()> {
        let of_chunk = |(actor, recorded): (&mut Actor, &[Trajectory])| -> Result<Vec<_>> {
            recorded.iter().map(|recorded| actor.difference(recorded)).collect()
        };
        let chunks = self.actors.par_iter_mut().zip(self.waiting.par_chunks(CHUNK));
        let differences: Result<Vec<_>> = self.threads.install(|| chunks.map(of_chunk).collect());
        for (recorded, difference) in self.waiting.iter().zip(differences?.concat()) {
            self.verification.episodes += 1;
            self.verification.steps += u64::from(recorded.steps);
            match difference {
                None => self.verification.equal += 1,
                Some(difference) => {
                    self.verification.first_difference.get_or_insert(difference);
                }
            }
        }
        self.waiting.clear();
        Ok(())
    }
}

/// Acts recorded episodes, one after another in one environment.
struct Actor {
    task: Task,
    setting: Setting,
    episode: Option<Episode>,
}

impl Actor {
    /// Where an episode acted again differs from the recorded one.
    fn difference(&mut self, recorded: &Trajectory) -> Result<Option<String>> {
        let spec = self.task.spec();
        let again = match self.act(recorded, &spec) {
            Ok(again) => again,
            Err(error) => return Ok(Some(format!("{}: {error:#}", name(recorded)?))),
        };
        // What the policy thought of its actions is no business of the environment.
        let again = Trajectory { log_probs: recorded.log_probs.clone(), ..again };
        if again == *recorded {
            return Ok(None);
        }
        let part = first_difference(recorded, &again, spec.observation.bytes());
        Ok(Some(format!("{}, {part}", name(recorded)?)))
    }

    fn act(&mut self, recorded: &Trajectory, spec: &Spec) -> Result<Trajectory> {
        let name = EpisodeName {
            source: Source::try_from(recorded.source)?,
            iteration: recorded.iteration,
            lane: recorded.lane,
            episode: recorded.episode,
            policy_version: recorded.policy_version,
            run_seed: recorded.run_seed,
        };
        let episode = match &mut self.episode {
            Some(episode) => {
                episode.begin_again(name)?;
                episode
            }
            none => {
                let environment = environments::create(self.task, &self.setting)?;
                none.insert(Episode::begin(environment, name)?)
            }
        };
        for action in recorded.actions().chunks_exact(spec.action.bytes()) {
            if let Some(trajectory) = episode.step(action, None)? {
                return Ok(trajectory);
            }
        }
        ensure!(!recorded.actions().is_empty(), "expected actions to act again, found none");
        anyhow::bail!("expected to end after step {}, found it going on", recorded.steps)
    }
}

fn name(recorded: &Trajectory) -> Result<String> {
    let Trajectory { lane, episode, .. } = recorded;
    let kind = match Source::try_from(recorded.source)? {
        Source::Training => "",
        Source::Evaluation => "evaluation, ",
        Source::Demonstration => "demonstration, ",
    };
    Ok(format!("{kind}lane {lane} episode {episode}"))
}

/// The first part of an episode that differs, in the order it happened.
fn first_difference(recorded: &Trajectory, again: &Trajectory, observation: usize) -> String {
    if recorded.steps != again.steps {
        return format!("ending: expected after step {}, found {}", recorded.steps, again.steps);
    }
    let rows = |trajectory: &Trajectory| -> Vec<Vec<u8>> {
        trajectory.observations().chunks_exact(observation).map(<[u8]>::to_vec).collect()
    };
    let step = rows(recorded).iter().zip(rows(again)).position(|(one, other)| *one != other);
    if let Some(step) = step {
        return format!("step {step}: another observation");
    }
    let rewards =
        |trajectory: &Trajectory| trajectory.environment_rewards.as_chunks::<4>().0.to_vec();
    let step = rewards(recorded).iter().zip(rewards(again)).position(|(one, other)| *one != other);
    match step {
        Some(step) => format!("step {}: another reward of the environment", step + 1),
        None if recorded.state_hash != again.state_hash => format!(
            "step {}: expected the state {:016x}, found {:016x}",
            recorded.steps, recorded.state_hash, again.state_hash
        ),
        None => "another ending or success".to_owned(),
    }
}
