//! Reward models and the rewards made from them (Table 3).

use serde::{Deserialize, Serialize};

/// The reward model and the reward made from it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RewardConfig {
    /// What is learned.
    pub model: RewardModel,
    /// What it sees of a step.
    pub input: RewardInput,
    /// Reward per step.
    pub form: RewardForm,
    /// Whether the final proximity is added at the end of an episode (Eq. 5).
    pub final_bonus: bool,
    /// Lambda: weight of the uncertainty penalty (Eq. 5); 0 switches it off.
    pub uncertainty: f64,
    /// Weight of a discriminator's gradient penalty, for vector tasks; 0 switches it off.
    pub gradient_penalty: f64,
    /// Discounting of proximity with the steps to the goal.
    pub discounting: Discounting,
    /// Delta of the discounting: per step if linear (Eq. 1), base if exponential.
    pub delta: f64,
    /// Members of the ensemble.
    pub ensemble: usize,
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: [usize; 3],
    /// Numbers the encoder makes of a grid.
    pub features: usize,
    /// Hidden tanh layers.
    pub hidden: Vec<usize>,
    /// Whether the ensemble sees observations shifted and scaled by the moments they have in the
    /// demonstrations, for vector tasks.
    pub normalize_observations: bool,
    /// Adam's learning rate, offline and in the first iteration.
    pub learning_rate: f64,
    /// Whether it falls linearly to 0, after which the ensemble learns no more.
    pub learning_rate_decay: bool,
    /// Environment steps over which it falls; 0 takes the run's own.
    pub decay_steps: u64,
    /// Passes over the demonstrations before training; 0 switches offline training off.
    pub pretraining_epochs: u64,
    /// Rows of each kind, demonstrations' and agent's, in a batch. Ranking has a pair for each of them,
    /// and online as many pairs within demonstrations beside.
    pub batch: usize,
    /// Rows of each kind drawn for an online update, fewer where there are not as many yet; 0 switches
    /// online training off.
    pub samples: usize,
    /// Agent observations kept, newest first.
    pub experience: usize,
    /// Order within an iteration.
    pub order: UpdateOrder,
}

impl RewardConfig {
    /// Proximity label of a demonstration's observation so many steps from the goal, in [0, 1] (Eq. 1);
    /// that at the goal has 1.
    pub fn label(&self, steps_to_goal: u32) -> f64 {
        let steps = f64::from(steps_to_goal);
        match self.discounting {
            Discounting::Linear => (1.0 - self.delta * steps).max(0.0),
            Discounting::Exponential => libm::pow(self.delta, steps),
        }
    }
}

/// What a reward model learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RewardModel {
    /// How close a state is to the goal, by regression on the steps to it: the paper's method.
    Proximity,
    /// How close a state is to the goal, by which of two states comes later (Figure 7).
    Ranking,
    /// Whether a state, transition or state and action is the expert's: GAIfO-s, GAIfO, GAIL.
    Discriminator,
    /// Nothing: the environment's own reward, an upper reference.
    Environment,
    /// Nothing: no reward, for policy learners that need none.
    None,
}

impl RewardModel {
    /// Its name in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            RewardModel::Proximity => "proximity",
            RewardModel::Ranking => "ranking",
            RewardModel::Discriminator => "discriminator",
            RewardModel::Environment => "environment",
            RewardModel::None => "none",
        }
    }

    /// Whether it learns from demonstrations.
    pub fn learns(self) -> bool {
        !matches!(self, RewardModel::Environment | RewardModel::None)
    }
}

/// What a reward model sees of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RewardInput {
    /// A state.
    State,
    /// A state and the next one.
    Transition,
    /// A state and the action taken there.
    StateAction,
}

/// Reward per step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RewardForm {
    /// Increase of proximity (Eq. 5).
    Difference,
    /// Proximity itself (ablation, Figure 6).
    Absolute,
    /// `log D - log(1 - D)` of a discriminator, or of the proximity: the form of AIRL.
    Airl,
    /// `-log(1 - D)` of a discriminator: the form of GAIL.
    Gail,
}

/// How proximity falls with the steps to the goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Discounting {
    /// `1 - delta * steps`, not below 0 (Eq. 1).
    Linear,
    /// `delta ^ steps` (ablation, Figure 5b).
    Exponential,
}

/// Order within an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpdateOrder {
    /// Score, then update policy and reward model at once (Algorithm 1).
    ScoreFirst,
    /// Update the reward model, then score with it (the authors' code).
    ImproveFirst,
}
