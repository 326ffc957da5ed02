//! Reward models and the rewards made from them (Table 3).

use std::fmt;

use protocol::dropped::shortened;
use protocol::encoder::CellsArchitecture;
use protocol::error::FOUND_CHARS;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The reward model and the reward made from it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RewardConfig {
    /// What is learned.
    pub model: &'static RewardModel,
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
    /// Weight of the loss on the agent's observations (Eq. 4, second term), for proximity.
    pub agent_weight: f64,
    /// Parts that an episode and a demonstration are divided into for `nearest-state`, which then looks
    /// for a state in its own part alone; 1 looks everywhere.
    pub segments: usize,
    /// Discounting of proximity with the steps to the goal.
    pub discounting: Discounting,
    /// Delta of the discounting: per step if linear (Eq. 1), base if exponential.
    pub delta: f64,
    /// Members of the ensemble.
    pub ensemble: usize,
    /// Whether each member learns from a bootstrap resample of the demonstrations, in minibatches of its
    /// own; otherwise all see the same.
    pub bootstrap: bool,
    /// Weight of each member's prior, a random network that is never trained and whose output is added to the
    /// member's (Osband et al., 2018); 0 switches priors off.
    pub prior: f64,
    /// By how much of the learning rate each gradient step shortens the weights (AdamW); 0 switches it off.
    pub weight_decay: f64,
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: Vec<usize>,
    /// Side of the convolutions' windows.
    pub convolution_kernel: usize,
    /// Side of the squares pooled behind the first convolution.
    pub pool: usize,
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
    /// Agent observations kept, the newest. A batch comes lane by lane, so of one that has more of them the
    /// last lanes stay.
    pub experience: usize,
    /// Whether what the agent saw after it reached the goal is among them. Where it is not, the reward
    /// model hears of success from the environment.
    pub experience_after_goal: bool,
    /// Order within an iteration.
    pub order: UpdateOrder,
}

impl RewardConfig {
    /// The encoder of grids.
    pub fn encoder(&self) -> CellsArchitecture {
        CellsArchitecture {
            channels: self.convolution_channels.clone(),
            kernel: self.convolution_kernel,
            pool: self.pool,
            features: self.features,
        }
    }

    /// Proximity label of a demonstration's observation so many steps from the goal, in [0, 1] (Eq. 1);
    /// that at the goal has 1.
    pub fn label(&self, steps_to_goal: u32) -> f64 {
        let steps = f64::from(steps_to_goal);
        match self.discounting {
            Discounting::Linear => (1.0 - self.delta * steps).max(0.0),
            Discounting::Exponential => libm::pow(self.delta, steps),
        }
    }

    /// The segment of a step in an episode of so many.
    pub fn segment(&self, step: usize, steps: usize) -> usize {
        (step * self.segments / (steps + 1)).min(self.segments - 1)
    }

    /// Whether an ensemble goes on learning while the agent acts.
    pub fn trains_online(&self) -> bool {
        self.model.trains && self.model.online && self.samples > 0
    }

    /// Agent observations that each ensemble keeps: none where it learns nothing of them.
    pub fn experience_kept(&self) -> usize {
        if self.trains_online() { self.experience } else { 0 }
    }

    /// Why a run with it does not read this key of its table; none if it does.
    pub(super) fn unread(&self, key: &str) -> Option<String> {
        let why = "with reward.samples = 0 nothing is learned while the agent acts";
        let idle = || (READ_ONLINE.contains(&key) && !self.trains_online()).then(|| why.to_owned());
        self.model.unread(key).or_else(idle)
    }
}

/// The keys that say how an ensemble learns while the agent acts, and nothing else.
const READ_ONLINE: [&str; 6] = [
    "agent_weight",
    "experience",
    "experience_after_goal",
    "order",
    "learning_rate_decay",
    "decay_steps",
];

/// A reward model, as far as configurations, demonstrations and estimates have to know it. How it
/// makes rewards only the proximity service knows, which has a constructor for each name.
#[derive(Debug, PartialEq, Eq)]
pub struct RewardModel {
    /// Its name in a configuration.
    pub name: &'static str,
    /// Whether it gives rewards: policy learners that need none go without.
    pub rewards: bool,
    /// Whether it needs demonstrations.
    pub imitates: bool,
    /// Whether it trains an ensemble on them.
    pub trains: bool,
    /// Whether it tells demonstrations from the agent's experience, of which it needs some: it has a row
    /// for each step, no offline phase, and rewards of its own forms.
    pub adversarial: bool,
    /// Whether it learns a discriminator of states, too, whose probability its proximity is multiplied by.
    pub discriminates: bool,
    /// Whether it trains on labels that fall with the steps to the goal.
    pub labels: bool,
    /// Whether its rows come in pairs.
    pub pairs: bool,
    /// Whether it goes on learning while the agent acts, from what it sees.
    pub online: bool,
    /// What it may see of a step.
    pub inputs: &'static [RewardInput],
    /// The rewards that it gives.
    pub forms: &'static [RewardForm],
    /// The keys of its table that it reads, where it trains no ensemble.
    pub reads: &'static [&'static str],
}

/// Most models train an ensemble on demonstrations.
const TRAINED: RewardModel = RewardModel {
    name: "",
    rewards: true,
    imitates: true,
    trains: true,
    adversarial: false,
    discriminates: false,
    labels: false,
    pairs: false,
    online: true,
    inputs: &[RewardInput::State, RewardInput::StateAction],
    forms: &[RewardForm::Difference, RewardForm::Absolute, RewardForm::Airl],
    reads: &[],
};

/// Others learn nothing.
const FIXED: RewardModel = RewardModel { imitates: false, trains: false, ..TRAINED };

/// The reward models there are.
pub const REWARD_MODELS: &[RewardModel] = &[
    // How close a state is to the goal, by regression on the steps to it: the paper's method.
    RewardModel { name: "proximity", labels: true, ..TRAINED },
    // The same times the probability that the state is the expert's.
    RewardModel {
        name: "proximity-discriminator",
        discriminates: true,
        labels: true,
        inputs: &[RewardInput::State],
        ..TRAINED
    },
    // How close a state is to the goal, by which of two states comes later (Figure 7).
    RewardModel { name: "ranking", pairs: true, ..TRAINED },
    // Whether a state, transition or state and action is the expert's: GAIfO-s, GAIfO, GAIL.
    RewardModel {
        name: "discriminator",
        adversarial: true,
        inputs: &[RewardInput::State, RewardInput::Transition, RewardInput::StateAction],
        forms: &[RewardForm::Airl, RewardForm::Gail],
        ..TRAINED
    },
    // How much closer to the goal a state is than another, by regression on the steps between them.
    RewardModel {
        name: "temporal-distance",
        labels: true,
        online: false,
        inputs: &[RewardInput::Transition],
        forms: &[RewardForm::Difference],
        ..TRAINED
    },
    // How close a state is to the nearest one of the demonstrations.
    RewardModel {
        name: "nearest-state",
        trains: false,
        reads: &["normalize_observations", "segments"],
        ..TRAINED
    },
    // The environment's own reward.
    RewardModel { name: "environment", ..FIXED },
    // No reward.
    RewardModel { name: "none", rewards: false, ..FIXED },
];

impl RewardModel {
    /// The model of that name.
    pub fn named(name: &str) -> Option<&'static RewardModel> {
        REWARD_MODELS.iter().find(|model| model.name == name)
    }

    /// Whether it has a discriminator, alone or beside proximity.
    pub fn has_discriminator(&self) -> bool {
        self.adversarial || self.discriminates
    }

    /// Rows of a demonstration of so many steps, in each of its ensembles: one that is adversarial, or sees
    /// actions, has one for each step, the others have one for each observation.
    pub fn rows(&self, input: RewardInput, steps: u64) -> u64 {
        let of_steps = self.adversarial || input == RewardInput::StateAction;
        steps + u64::from(!of_steps)
    }

    /// Whether it is a single trained ensemble, and so a network that can be exported.
    pub fn is_one_ensemble(&self) -> bool {
        self.trains && !self.discriminates
    }

    /// Whether it looks for a state in its own segment.
    pub fn reads_segments(&self) -> bool {
        self.reads.contains(&"segments")
    }

    /// Why it does not read this key of its table; none if it does.
    fn unread(&self, key: &str) -> Option<String> {
        let read = match key {
            "model" => true,
            _ if !self.trains => self.reads.contains(&key),
            "segments" => false,
            "discounting" | "delta" => self.labels,
            "agent_weight" => self.labels && self.online,
            "samples" => self.online,
            key if READ_ONLINE.contains(&key) => self.online,
            "pretraining_epochs" => !self.adversarial,
            "final_bonus" => self.forms.contains(&RewardForm::Absolute), // it is a proximity, too
            _ => true,
        };
        (!read).then(|| format!("the reward model {} does not read it", self.name))
    }
}

impl Serialize for RewardModel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name)
    }
}

impl<'de> Deserialize<'de> for &'static RewardModel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        RewardModel::named(&name).ok_or_else(|| {
            let known: Vec<_> = REWARD_MODELS.iter().map(|model| model.name).collect();
            let found = shortened(&name, FOUND_CHARS);
            D::Error::custom(format!(
                "unknown model `{found}`, expected one of {}",
                known.join(", ")
            ))
        })
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

impl fmt::Display for RewardInput {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(formatter)
    }
}

impl fmt::Display for RewardForm {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(formatter)
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks;

    fn config(delta: f64, discounting: Discounting) -> RewardConfig {
        let usual = tasks::configuration("navigation", None, &[]).unwrap().reward;
        RewardConfig { delta, discounting, ..usual }
    }

    #[test]
    fn linear_labels_fall_by_delta_per_step_to_zero() {
        let config = config(0.02, Discounting::Linear);
        let labels = [0, 1, 10, 50, 60].map(|steps| config.label(steps) as f32);
        assert_eq!(labels, [1.0, 0.98, 0.8, 0.0, 0.0]);
    }

    #[test]
    fn exponential_labels_fall_by_a_factor_per_step() {
        let config = config(0.5, Discounting::Exponential);
        assert_eq!([0, 1, 3].map(|steps| config.label(steps)), [1.0, 0.5, 0.125]);
    }
}
