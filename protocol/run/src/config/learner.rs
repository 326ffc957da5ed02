//! Policy learners and their settings (Table 2; paper, Section 4.1 and Appendix E for the baselines).

use serde::{Deserialize, Serialize};

/// What makes better weights of a batch. With a reward model it makes a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Learner {
    /// Proximal policy optimization on the rewards of the reward model.
    Ppo,
    /// Behavioral cloning: the expert's actions, no environment steps.
    Bc,
    /// Behavioral cloning from observation: actions inferred by an inverse dynamics model.
    Bco,
    /// Soft Q imitation learning: the expert's transitions earn 1, the agent's 0.
    Sqil,
}

impl Learner {
    /// Its name in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Learner::Ppo => "ppo",
            Learner::Bc => "bc",
            Learner::Bco => "bco",
            Learner::Sqil => "sqil",
        }
    }
}

/// Proximal policy optimization.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PpoConfig {
    /// Learning rate of the first iteration.
    pub learning_rate: f64,
    /// Whether it falls linearly to 0.
    pub learning_rate_decay: bool,
    /// Environment steps over which it falls; 0 takes the run's own.
    pub decay_steps: u64,
    /// Adam's epsilon.
    pub adam_epsilon: f64,
    /// Discount factor.
    pub gamma: f64,
    /// Lambda of generalized advantage estimation.
    pub gae_lambda: f64,
    /// Clip range of the probability ratio.
    pub clip: f64,
    /// Clip range of the value; 0 leaves values unclipped.
    pub value_clip: f64,
    /// Weight of the value loss (which itself has the factor 1/2).
    pub value_coefficient: f64,
    /// Weight of the entropy bonus.
    pub entropy_coefficient: f64,
    /// Passes over a batch.
    pub epochs: u64,
    /// No pass follows one in which the mean divergence from the policy that acted was above this;
    /// 0 never ends passes early.
    pub target_kl: f64,
    /// Minibatches per pass.
    pub minibatches: u64,
    /// Largest norm of a gradient.
    pub max_gradient_norm: f64,
    /// Whether an episode cut by the horizon is bootstrapped with the value of its last state.
    pub bootstrap_truncated: bool,
    /// Whether rewards are divided by the running deviation of the discounted return.
    pub normalize_rewards: bool,
}

/// Supervised learning of a policy from observations and actions, by maximum likelihood.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloningConfig {
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Adam's epsilon.
    pub adam_epsilon: f64,
    /// Largest norm of a gradient.
    pub max_gradient_norm: f64,
    /// Pairs of observation and action in a minibatch.
    pub batch: usize,
    /// Behavioral cloning: most passes over the training part. From observation: passes an iteration.
    pub epochs: u64,
    /// Whether the deviations of continuous actions are fitted, too. Otherwise they stay at one, and
    /// the loss is half the squared error of the means, but for a constant.
    pub deviations: bool,
    /// Part of the demonstrations held out, in [0, 1); 0 trains for all epochs.
    pub validation: f64,
    /// Behavioral cloning ends after so many passes without a lower loss on the part held out, and
    /// keeps the weights of the lowest.
    pub patience: u64,
}

/// The inverse dynamics model of behavioral cloning from observation: which action led from one
/// observation to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InverseDynamicsConfig {
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: [usize; 3],
    /// Numbers the encoder makes of a grid.
    pub features: usize,
    /// Hidden layers.
    pub hidden: Vec<usize>,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Transitions in a minibatch.
    pub batch: usize,
    /// Transitions of the agent drawn for the training of an iteration.
    pub samples: usize,
    /// Newest transitions kept.
    pub experience: usize,
    /// Environment steps of the first policy, which acts at random, before actions are inferred.
    pub exploration_steps: u64,
}

/// Soft Q imitation learning: soft Q-learning for discrete actions, a soft actor-critic for
/// continuous ones (paper, Appendix D.3).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SqilConfig {
    /// Hidden layers of the Q-functions over vector observations.
    pub hidden: Vec<usize>,
    /// Adam's learning rate of the first iteration; it falls linearly to 0 over the run.
    pub learning_rate: f64,
    /// Discount factor.
    pub gamma: f64,
    /// Whether the goal is an absorbing state that earns 1 for ever. Otherwise nothing comes after
    /// it, and staying away from it earns an expert more.
    pub absorbing: bool,
    /// How much of the Q-functions the target functions take over at an update.
    pub target_rate: f64,
    /// Weight of the entropy; the first one, where it is tuned.
    pub temperature: f64,
    /// Whether the temperature is tuned towards an entropy of minus the numbers of an action.
    pub tune_temperature: bool,
    /// Transitions of each kind, expert's and agent's, in a minibatch.
    pub batch: usize,
    /// Updates for each environment step.
    pub updates_per_step: f64,
    /// Newest transitions of the agent kept.
    pub experience: usize,
    /// Environment steps before the first update.
    pub exploration_steps: u64,
}
