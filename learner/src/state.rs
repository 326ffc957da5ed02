//! Everything the learner carries from one iteration to the next, and its checkpoint file.
//!
//! Random streams are named, not carried (`protocol::seed`), so this is all there is.

use std::collections::VecDeque;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use networks::{Adam, RunningNormalizer};
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use protocol::weights::Weights;

use crate::reward_scale::RewardScale;
use crate::rollout::LanePlan;

/// Training episodes the success rate is taken over (paper, Section 4: the last 100).
const SUCCESS_WINDOW: usize = 100;

/// Everything the learner carries from one iteration to the next.
#[derive(Clone, Debug)]
pub struct State {
    /// Iterations finished.
    pub iteration: u64,
    /// Environment steps learned from.
    pub environment_steps: u64,
    /// Training episodes learned from.
    pub episodes: u64,
    /// Training wall time, seconds.
    pub wall_s: f64,
    /// The policy, as often updated as there were iterations.
    pub policy: PolicyState,
    /// The policy one update older: with lag 1 it still acts.
    pub previous_policy: PolicyState,
    /// The policy's optimizer.
    pub optimizer: Adam,
    /// Running deviation of the discounted return.
    pub reward_scale: RewardScale,
    lanes: Vec<Lane>,
    successes: VecDeque<bool>,
}

/// Everything a policy acts by.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyState {
    /// Parameters of the networks.
    pub parameters: Vec<f32>,
    /// What observations are normalized by before the networks see them; of no numbers where they
    /// are taken as they are.
    pub normalizer: RunningNormalizer,
}

impl PolicyState {
    /// The policy as a version that can act.
    pub fn weights(&self, version: u64) -> Weights {
        Weights::new(version, &self.parameters, &self.normalizer.to_numbers())
    }
}

/// What a lane has run over its whole life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Lane {
    episodes: u64,
    steps: u64,
}

impl State {
    /// The state before the first iteration.
    pub fn fresh(policy: PolicyState, optimizer: Adam, lanes: u64) -> State {
        State {
            iteration: 0,
            environment_steps: 0,
            episodes: 0,
            wall_s: 0.0,
            previous_policy: policy.clone(),
            policy,
            optimizer,
            reward_scale: RewardScale::default(),
            lanes: vec![Lane::default(); lanes as usize],
            successes: VecDeque::with_capacity(SUCCESS_WINDOW),
        }
    }

    /// What each lane is to run: up to the first episode end at or past `lane_steps` steps per
    /// iteration, counted over the lane's whole life.
    pub fn plans(&self, iteration: u64, lane_steps: u64) -> Vec<LanePlan> {
        let plan = |lane: &Lane| LanePlan {
            first_episode: lane.episodes,
            steps_owed: (lane_steps * (iteration + 1)).saturating_sub(lane.steps),
            episodes_owed: 0,
        };
        self.lanes.iter().map(plan).collect()
    }

    /// Counts a batch's episodes to their lanes.
    pub fn count(&mut self, batch: &[Encoded]) {
        for encoded in batch {
            let trajectory = &encoded.trajectory;
            let steps = u64::from(trajectory.steps);
            let lane = &mut self.lanes[trajectory.lane as usize];
            lane.episodes += 1;
            lane.steps += steps;
            self.episodes += 1;
            self.environment_steps += steps;
            if self.successes.len() == SUCCESS_WINDOW {
                self.successes.pop_front();
            }
            self.successes.push_back(trajectory.success);
        }
    }

    /// Share of the last 100 training episodes that reached the goal; 0 before the first.
    pub fn success_rate(&self) -> f64 {
        let reached = self.successes.iter().filter(|success| **success).count();
        reached as f64 / self.successes.len().max(1) as f64
    }

    /// Writes the checkpoint file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let mut tensors = Tensors::default();
        let counts = [self.iteration, self.environment_steps, self.episodes];
        tensors.put_u64("counts", counts);
        tensors.put_f64("wall_s", [self.wall_s]);
        for (name, policy) in [("policy", &self.policy), ("previous_policy", &self.previous_policy)]
        {
            let parameters = policy.parameters.iter().copied();
            tensors.put_f32(&format!("{name}.parameters"), parameters);
            tensors.put_f64(&format!("{name}.moments"), policy.normalizer.to_numbers());
        }
        tensors.put_f32("adam.first_moment", self.optimizer.first_moment.iter().copied());
        tensors.put_f32("adam.second_moment", self.optimizer.second_moment.iter().copied());
        tensors.put_u64("adam.step", [self.optimizer.step]);
        let scale = &self.reward_scale;
        tensors.put_f64("reward_scale", [scale.mean, scale.variance, scale.count]);
        tensors.put_u64("lanes.episodes", self.lanes.iter().map(|lane| lane.episodes));
        tensors.put_u64("lanes.steps", self.lanes.iter().map(|lane| lane.steps));
        tensors.put_u8("successes", self.successes.iter().map(|success| u8::from(*success)));
        Ok(tensors.save(path)?)
    }

    /// Reads what [`State::save`] wrote, into the shapes of `fresh`.
    pub fn load(path: &Path, fresh: State) -> Result<State> {
        let tensors = Tensors::load(path)?;
        Self::from_tensors(&tensors, fresh)
            .map_err(|message| anyhow!(message))
            .with_context(|| format!("checkpoint {}", path.display()))
    }

    fn from_tensors(tensors: &Tensors, fresh: State) -> Result<State, String> {
        let counts = exactly("counts", 3, tensors.u64("counts")?)?;
        let scale = exactly("reward_scale", 3, tensors.f64("reward_scale")?)?;
        let size = fresh.policy.parameters.len();
        let policy = |name: &str| -> Result<PolicyState, String> {
            let parameters = format!("{name}.parameters");
            let moments = format!("{name}.moments");
            let count = fresh.policy.normalizer.to_numbers().len();
            Ok(PolicyState {
                parameters: exactly(&parameters, size, tensors.f32(&parameters)?)?,
                normalizer: RunningNormalizer::from_numbers(&exactly(
                    &moments,
                    count,
                    tensors.f64(&moments)?,
                )?),
            })
        };
        let numbers = |name| exactly(name, size, tensors.f32(name)?);
        let lane_numbers = |name| exactly(name, fresh.lanes.len(), tensors.u64(name)?);
        let lanes = lane_numbers("lanes.episodes")?.into_iter().zip(lane_numbers("lanes.steps")?);
        let mut optimizer = fresh.optimizer.clone();
        optimizer.first_moment = numbers("adam.first_moment")?;
        optimizer.second_moment = numbers("adam.second_moment")?;
        optimizer.step = exactly("adam.step", 1, tensors.u64("adam.step")?)?[0];
        Ok(State {
            iteration: counts[0],
            environment_steps: counts[1],
            episodes: counts[2],
            wall_s: exactly("wall_s", 1, tensors.f64("wall_s")?)?[0],
            policy: policy("policy")?,
            previous_policy: policy("previous_policy")?,
            optimizer,
            reward_scale: RewardScale { mean: scale[0], variance: scale[1], count: scale[2] },
            lanes: lanes.map(|(episodes, steps)| Lane { episodes, steps }).collect(),
            successes: tensors.u8("successes")?.into_iter().map(|byte| byte == 1).collect(),
        })
    }
}

fn exactly<T>(name: &str, expected: usize, numbers: Vec<T>) -> Result<Vec<T>, String> {
    if numbers.len() == expected {
        return Ok(numbers);
    }
    Err(format!("array `{name}`: expected {expected} numbers, found {}", numbers.len()))
}
