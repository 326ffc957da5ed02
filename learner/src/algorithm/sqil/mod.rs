//! Soft Q imitation learning (Reddy et al., 2020; paper, Appendix F): off-policy learning from transitions of
//! the expert, with reward 1, and of the agent, with reward 0. It uses soft Q-learning for discrete actions and
//! a soft actor-critic for continuous ones.

mod q_function;
mod soft_actor_critic;
mod soft_q;

use anyhow::Result;
use networks::RunningNormalizer;
use protocol::ending::Ending;
use protocol::messages::Score;
use protocol::seed::{self, Purpose, Stream};
use protocol::task::{ActionSpec, Spec};
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, Trajectory};
use rand::RngExt;
use run::config::{RunConfig, SqilConfig};

use crate::algorithm::replay_buffer::ReplayBuffer;
use crate::algorithm::{Metrics, PolicyLearner, Schedule, Setup};
use crate::state::PolicyState;
use soft_actor_critic::SoftActorCritic;
use soft_q::SoftQ;

/// The learner of soft Q imitation learning.
pub(super) struct Sqil {
    spec: Spec,
    config: SqilConfig,
    normalizer: RunningNormalizer,
    expert: ReplayBuffer,
    agent: ReplayBuffer,
    /// Number of updates so far, which names the random streams.
    updates: u64,
    learner: Box<dyn SoftLearner>,
}

/// A learner of soft Q-functions, and of a policy from them.
trait SoftLearner: Send {
    /// Makes one update.
    fn update(
        &mut self,
        policy: &mut Vec<f32>,
        minibatch: &Minibatch,
        stream: &mut Stream,
        learning_rate: f64,
    ) -> Metrics;

    /// Adds everything carried from one update to the next.
    fn save(&self, tensors: &mut Tensors);

    /// Restores what [`SoftLearner::save`] added.
    fn restore(&mut self, tensors: &Tensors) -> Result<(), String>;
}

/// Transitions sampled for an update: those of the expert, then those of the agent.
#[derive(Clone, Debug, Default)]
struct Minibatch {
    /// Observations acted on, as networks see them.
    observations: Vec<u8>,
    /// Actions taken.
    actions: Vec<u8>,
    /// The next observations.
    next_observations: Vec<u8>,
    /// Rewards: 1 for the expert, 0 for the agent.
    rewards: Vec<f32>,
    /// Values that replace those of the next observations, if the task ended the episode there; `None` keeps
    /// the observation's own value.
    end_values: Vec<Option<f32>>,
}

impl Minibatch {
    /// Returns what a Q-function is fitted to: rewards plus discounted soft values of the next observations.
    fn targets(&self, next_values: &[f32], gamma: f32) -> Vec<f32> {
        let values =
            self.end_values.iter().zip(next_values).map(|(end, next)| end.unwrap_or(*next));
        self.rewards.iter().zip(values).map(|(reward, value)| reward + gamma * value).collect()
    }

    fn len(&self) -> usize {
        self.rewards.len()
    }
}

impl Sqil {
    /// Creates an untrained learner.
    pub(super) fn new(of: Setup<'_>) -> Sqil {
        let Setup { config, network, normalizer, demonstrations } = of;
        let spec = config.task.spec();
        let own = config.sqil.clone().expect("checked with the configuration");
        let learner: Box<dyn SoftLearner> = match spec.action {
            ActionSpec::Discrete { .. } => Box::new(SoftQ::new(config, &own, network)),
            ActionSpec::Continuous { .. } => Box::new(SoftActorCritic::new(config, &own, network)),
        };
        Sqil {
            spec,
            normalizer: normalizer.clone(),
            expert: of_expert(config, demonstrations),
            agent: ReplayBuffer::new(spec, own.experience),
            updates: 0,
            learner,
            config: own,
        }
    }

    /// Returns the number of updates due after the steps so far.
    fn updates_owed(&self) -> u64 {
        let steps = self.agent.steps().saturating_sub(self.config.exploration_steps);
        (steps as f64 * self.config.updates_per_step) as u64
    }

    /// Samples as many transitions of the expert as of the agent.
    fn draw(&self, stream: &mut Stream) -> Minibatch {
        let SqilConfig { batch, gamma, expert_after_goal, agent_after_goal, .. } = self.config;
        let one = self.spec.observation.bytes();
        let mut minibatch = Minibatch::default();
        for (replay, reward, end) in
            [(&self.expert, 1.0, expert_after_goal), (&self.agent, 0.0, agent_after_goal)]
        {
            for _ in 0..batch {
                let transition = replay.get(stream.random_range(0..replay.len()));
                let (observation, next) = transition.observations.split_at(one);
                minibatch.observations.extend(observation);
                minibatch.next_observations.extend(next);
                minibatch.actions.extend(transition.action);
                minibatch.rewards.push(reward);
                minibatch.end_values.push(match transition.ending {
                    Some(Ending::GoalReached) => end.value(gamma),
                    Some(Ending::Failed) => Some(0.0),
                    Some(Ending::Truncated) | None => None,
                });
            }
        }
        self.normalizer.normalize(&mut minibatch.observations);
        self.normalizer.normalize(&mut minibatch.next_observations);
        minibatch
    }
}

impl PolicyLearner for Sqil {
    fn update(
        &mut self,
        policy: &mut PolicyState,
        trajectories: &[Encoded],
        _scores: &[Score],
        schedule: &Schedule,
    ) -> Result<Metrics> {
        self.remember(trajectories);
        let Schedule { run_seed, learning_rate, .. } = *schedule;
        let owed = self.updates_owed().saturating_sub(self.updates);
        let mut metrics = Metrics::default();
        for _ in 0..owed {
            let mut stream = seed::stream(run_seed, Purpose::Replay, self.updates, 0);
            let minibatch = self.draw(&mut stream);
            let parameters = &mut policy.parameters;
            let own = self.learner.update(parameters, &minibatch, &mut stream, learning_rate);
            own.expect_finite(format_args!("update {}", self.updates + 1))?;
            metrics += own;
            self.updates += 1;
        }
        Ok(metrics.divided_by(owed.max(1) as f64))
    }

    fn remember(&mut self, trajectories: &[Encoded]) {
        trajectories.iter().for_each(|encoded| self.agent.push(&encoded.trajectory));
    }

    fn save(&self, tensors: &mut Tensors) {
        tensors.put_u64("updates", [self.updates]);
        self.learner.save(tensors);
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.updates = tensors.exactly("updates", 1, Tensors::u64)?[0];
        self.learner.restore(tensors)
    }
}

/// Returns the transitions of demonstrations. If the task does not tell success, their endings do not either, but each
/// was cut at the goal.
fn of_expert(config: &RunConfig, demonstrations: &[Trajectory]) -> ReplayBuffer {
    let mut demonstrations = demonstrations.to_vec();
    if !config.task.tells_success {
        demonstrations.iter_mut().for_each(|shown| shown.ending = Ending::GoalReached as i32);
    }
    ReplayBuffer::of_demonstrations(config.task.spec(), &demonstrations)
}

/// Moves target parameters towards the parameters of their network by Polyak averaging.
fn polyak_update(targets: &mut [f32], parameters: &[f32], rate: f64) {
    let rate = rate as f32;
    for (target, parameter) in targets.iter_mut().zip(parameters) {
        *target += rate * (parameter - *target);
    }
}

#[cfg(test)]
mod tests {
    use networks::{ActorCritic, PolicyArchitecture};
    use run::config::AfterGoal;

    use super::*;

    /// Returns the values that are known behind episodes of one step which end so: the expert's and the agent's.
    fn end_values(tells_success: bool, ending: Ending) -> [Option<f32>; 2] {
        let task = format!(
            "[task]\nname = \"point\"\nobservation.vector.len = 1\naction.discrete.count = 2\n\
             horizon_steps = 5\ntells_success = {tells_success}\n"
        );
        let settings = ["method=sqil", "sqil.batch=1", "sqil.gamma=0.75"].map(str::to_owned);
        let config = run::tasks::of_text(&task, "point", None, &settings).unwrap();
        let episode = Trajectory {
            steps: 1,
            values: vec![0; 8].into(),
            discrete_actions: vec![0].into(),
            ending: ending as i32,
            ..Trajectory::default()
        };
        let (spec, architecture) = (config.task.spec(), PolicyArchitecture::from(&config.policy));
        let mut sqil = Sqil::new(Setup {
            config: &config,
            network: ActorCritic::new(spec.observation, spec.action, &architecture),
            normalizer: &RunningNormalizer::new(0),
            demonstrations: std::slice::from_ref(&episode),
        });
        sqil.remember(&[Encoded::encode(episode.clone())]);
        let minibatch = sqil.draw(&mut seed::stream(1, Purpose::Replay, 0, 0));
        minibatch.end_values.try_into().unwrap()
    }

    #[test]
    fn a_demonstration_ends_at_the_goal_also_where_nothing_tells_of_it() {
        assert_eq!(end_values(true, Ending::GoalReached), [Some(4.0), None]);
        assert_eq!(end_values(false, Ending::Failed), [Some(4.0), Some(0.0)]);
        assert_eq!(end_values(false, Ending::Truncated), [Some(4.0), None]);
    }

    #[test]
    fn only_what_is_known_of_the_goal_stands_for_the_value_behind_it() {
        let end_values = [AfterGoal::Continues, AfterGoal::Terminal, AfterGoal::Absorbing]
            .map(|after| after.value(0.75))
            .to_vec();
        let minibatch =
            Minibatch { rewards: vec![0.0, 0.0, 1.0], end_values, ..Minibatch::default() };
        assert_eq!(minibatch.targets(&[8.0; 3], 0.5), [4.0, 0.0, 3.0]);
    }
}
