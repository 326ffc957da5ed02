//! Reward models and the rewards made from them (Table 3).

use std::fmt;

use protocol::dropped::shortened;
use protocol::encoder::CellsArchitecture;
use protocol::error::FOUND_CHARS;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The reward model and how rewards are made from it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RewardConfig {
    /// The reward model.
    pub model: &'static RewardModelKind,
    /// What the model sees of a step.
    pub input: RewardInput,
    /// Form of the reward per step.
    pub form: RewardForm,
    /// Whether the final proximity is added at the end of an episode (Eq. 5).
    pub final_bonus: bool,
    /// Lambda, the weight of the uncertainty penalty (Eq. 5); 0 switches it off.
    pub uncertainty: f64,
    /// Number added to the reward of every step. Below 0, ending an episode early pays; above 0, going on does.
    pub offset: f64,
    /// Weight of a discriminator's gradient penalty, for vector tasks; 0 switches it off.
    pub gradient_penalty: f64,
    /// Weight of the loss on the agent's observations (Eq. 4, second term), for proximity.
    pub agent_weight: f64,
    /// Number of segments that `nearest-state` divides each episode and each demonstration into. It
    /// searches for the nearest state only in the segment of the same number; 1 searches everywhere.
    pub segments: usize,
    /// How proximity falls with the steps to the goal.
    pub discounting: Discounting,
    /// Delta of the discounting: decrease per step if linear (Eq. 1), base if exponential.
    pub delta: f64,
    /// Number of members of the ensemble.
    pub ensemble: usize,
    /// Whether each member learns from its own bootstrap resample of the demonstrations, in its own
    /// minibatches; otherwise all members see the same.
    pub bootstrap: bool,
    /// Weight of each member's prior, a random network that is never trained and whose output is added to the
    /// member's (Osband et al., 2018); 0 switches priors off.
    pub prior: f64,
    /// Weight decay (AdamW): each gradient step multiplies the weights by
    /// `1 - learning_rate * weight_decay`; 0 switches it off.
    pub weight_decay: f64,
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: Vec<usize>,
    /// Kernel size of the convolutions.
    pub convolution_kernel: usize,
    /// Side of the squares that are max-pooled after the first convolution.
    pub pool: usize,
    /// Features that the encoder outputs for a grid.
    pub features: usize,
    /// Widths of the hidden tanh layers.
    pub hidden: Vec<usize>,
    /// Whether the model sees observations normalized by their moments in the demonstrations, for vector tasks.
    pub normalize_observations: bool,
    /// Adam's learning rate, offline and in the first iteration.
    pub learning_rate: f64,
    /// Whether it falls linearly to 0, after which the ensemble stops learning.
    pub learning_rate_decay: bool,
    /// Environment steps over which it falls; 0 means the steps of the run.
    pub decay_steps: u64,
    /// Passes over the demonstrations before the agent acts; 0 switches offline training off.
    pub pretraining_epochs: u64,
    /// Rows of demonstrations in a batch, and as many of the agent. Ranking and temporal distance have as many
    /// pairs within demonstrations; ranking, online, as many pairs of an expert's and an agent's row besides.
    pub batch: usize,
    /// Rows of demonstrations sampled for an online update, and as many of the agent; fewer of both
    /// if there are not enough of one. 0 switches online training off.
    pub samples: usize,
    /// Number of agent observations kept, the newest. A batch comes lane by lane, so of a larger
    /// batch the last lanes are kept.
    pub experience: usize,
    /// Whether these include what the agent saw after reaching the goal. If not, the environment tells
    /// the reward model of success.
    pub experience_after_goal: bool,
    /// Share of an episode's highest estimated proximity from which on the agent counts as having arrived: what it saw
    /// afterwards is not kept. For models of single states without a discriminator; 0 switches it off.
    pub arrival: f64,
    /// Order of scoring and updates within an iteration.
    pub order: UpdateOrder,
}

impl RewardConfig {
    /// Returns the encoder of grids.
    pub fn encoder(&self) -> CellsArchitecture {
        CellsArchitecture {
            channels: self.convolution_channels.clone(),
            kernel: self.convolution_kernel,
            pool: self.pool,
            features: self.features,
        }
    }

    /// Returns the proximity label, in [0, 1], of a demonstration's observation `steps_to_goal`
    /// steps before the goal (Eq. 1); at the goal it is 1.
    pub fn label(&self, steps_to_goal: u32) -> f64 {
        let steps = f64::from(steps_to_goal);
        match self.discounting {
            Discounting::Linear => (1.0 - self.delta * steps).max(0.0),
            Discounting::Exponential => libm::pow(self.delta, steps),
        }
    }

    /// Returns the segment of a step in an episode of `steps` steps.
    pub fn segment(&self, step: usize, steps: usize) -> usize {
        (step * self.segments / (steps + 1)).min(self.segments - 1)
    }

    /// Returns whether an ensemble keeps learning while the agent acts.
    pub fn trains_online(&self) -> bool {
        self.model.trains && self.model.online && self.samples > 0
    }

    /// Returns the number of agent observations that each ensemble keeps: 0 if it does not learn from them.
    pub fn experience_kept(&self) -> usize {
        if self.trains_online() { self.experience } else { 0 }
    }

    /// Returns whether the reward model sees actions.
    pub fn sees_actions(&self) -> bool {
        self.model.trains && self.input == RewardInput::StateAction
    }

    /// Returns why a run does not read this key of the table `reward`; `None` if it does.
    pub(super) fn unread(&self, key: &str) -> Option<String> {
        let idle = "with reward.samples = 0 nothing is learned while the agent acts";
        let why = match key {
            key if READ_ONLINE.contains(&key) && !self.trains_online() => Some(idle),
            "arrival" if self.arrival > 0.0 && self.input != RewardInput::State => {
                Some("the model is not one of single states")
            }
            _ => None,
        };
        self.model.unread(key).or_else(|| why.map(str::to_owned))
    }
}

/// Keys that only affect how an ensemble learns while the agent acts.
const READ_ONLINE: [&str; 7] = [
    "agent_weight",
    "arrival",
    "experience",
    "experience_after_goal",
    "order",
    "learning_rate_decay",
    "decay_steps",
];

/// A reward model, as far as configurations, demonstrations and estimates need to know it. Only the
/// proximity service, which has a constructor for each name, knows how it makes rewards.
#[derive(Debug, PartialEq, Eq)]
pub struct RewardModelKind {
    /// Its name in a configuration.
    pub name: &'static str,
    /// Whether it gives rewards. The model `none` does not, for policy learners that need no rewards.
    pub rewards: bool,
    /// Whether it needs demonstrations.
    pub imitates: bool,
    /// Whether it trains an ensemble on them.
    pub trains: bool,
    /// Whether a discriminator tells demonstrations from the agent's experience.
    pub discriminator: Discriminator,
    /// Whether it trains on labels that fall with the steps to the goal.
    pub labels: bool,
    /// Whether it trains on pairs of rows.
    pub pairs: bool,
    /// Whether it keeps learning while the agent acts, from what the agent sees.
    pub online: bool,
    /// Inputs that it supports.
    pub inputs: &'static [RewardInput],
    /// Forms of reward that it supports.
    pub forms: &'static [RewardForm],
    /// Keys of the table `reward` that it reads if it trains no ensemble.
    pub reads: &'static [&'static str],
}

/// The discriminator of a reward model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Discriminator {
    /// There is none.
    None,
    /// It is the whole model. It needs the agent's experience, so there is no offline training; it has a row for each
    /// step and its own forms of reward.
    Alone,
    /// It has an ensemble of its own, beside that of proximity, which is multiplied by its probability.
    BesideProximity,
}

/// Values of most models, which train an ensemble on demonstrations.
const TRAINED: RewardModelKind = RewardModelKind {
    name: "",
    rewards: true,
    imitates: true,
    trains: true,
    discriminator: Discriminator::None,
    labels: false,
    pairs: false,
    online: true,
    inputs: &[RewardInput::State, RewardInput::StateAction],
    forms: &[RewardForm::Difference, RewardForm::Absolute, RewardForm::Airl],
    reads: &[],
};

/// Values of models that need no demonstrations and learn nothing.
const FIXED: RewardModelKind = RewardModelKind { imitates: false, trains: false, ..TRAINED };

/// All reward models.
pub const REWARD_MODELS: &[RewardModelKind] = &[
    // How close a state is to the goal, by regression on the steps to it: the paper's method.
    RewardModelKind { name: "proximity", labels: true, ..TRAINED },
    // Proximity times the probability that the state is the expert's.
    RewardModelKind {
        name: "proximity-discriminator",
        discriminator: Discriminator::BesideProximity,
        labels: true,
        inputs: &[RewardInput::State],
        ..TRAINED
    },
    // How close a state is to the goal, learned from which of two states comes later (Figure 7).
    RewardModelKind { name: "ranking", pairs: true, ..TRAINED },
    // Whether a state, a transition or a state-action pair is the expert's: GAIfO-s, GAIfO, GAIL.
    RewardModelKind {
        name: "discriminator",
        discriminator: Discriminator::Alone,
        inputs: &[
            RewardInput::State,
            RewardInput::NextState,
            RewardInput::Transition,
            RewardInput::StateAction,
        ],
        forms: &[RewardForm::Airl, RewardForm::Gail],
        ..TRAINED
    },
    // How much closer to the goal one state is than another, by regression on the steps between them.
    RewardModelKind {
        name: "temporal-distance",
        labels: true,
        pairs: true,
        online: false,
        inputs: &[RewardInput::Transition],
        forms: &[RewardForm::Difference],
        ..TRAINED
    },
    // How close a state is to the nearest one of the demonstrations.
    RewardModelKind {
        name: "nearest-state",
        trains: false,
        reads: &["normalize_observations", "segments"],
        ..TRAINED
    },
    // The environment's own reward.
    RewardModelKind { name: "environment", ..FIXED },
    // No reward.
    RewardModelKind { name: "none", rewards: false, ..FIXED },
];

impl RewardModelKind {
    /// Returns the model of this name.
    pub fn named(name: &str) -> Option<&'static RewardModelKind> {
        REWARD_MODELS.iter().find(|model| model.name == name)
    }

    /// Returns whether it has a discriminator, alone or beside proximity.
    pub fn has_discriminator(&self) -> bool {
        self.discriminator != Discriminator::None
    }

    /// Returns whether it is a discriminator and nothing else.
    pub fn is_discriminator(&self) -> bool {
        self.discriminator == Discriminator::Alone
    }

    /// Returns the rows of a demonstration of `steps` steps in each of its ensembles: one for each
    /// step if the model is a discriminator or sees actions, otherwise one for each observation.
    pub fn rows(&self, input: RewardInput, steps: u64) -> u64 {
        let of_steps = self.is_discriminator() || input == RewardInput::StateAction;
        steps + u64::from(!of_steps)
    }

    /// Returns whether it is a single trained ensemble, which can be exported as a network.
    pub fn is_one_ensemble(&self) -> bool {
        self.trains && self.discriminator != Discriminator::BesideProximity
    }

    /// Returns whether it compares states only within segments.
    pub fn reads_segments(&self) -> bool {
        self.reads.contains(&"segments")
    }

    /// Returns why it does not read this key of the table `reward`; `None` if it does.
    fn unread(&self, key: &str) -> Option<String> {
        let read = match key {
            "model" => true,
            _ if !self.trains => self.reads.contains(&key),
            "segments" => false,
            "discounting" | "delta" => self.labels,
            "agent_weight" => self.labels && self.online,
            "samples" => self.online,
            key if READ_ONLINE.contains(&key) => self.online,
            "pretraining_epochs" => !self.is_discriminator(),
            "final_bonus" => self.forms.contains(&RewardForm::Absolute), // the bonus is a proximity, too
            _ => true,
        };
        (!read).then(|| format!("the reward model {} does not read it", self.name))
    }
}

impl Serialize for RewardModelKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name)
    }
}

impl<'de> Deserialize<'de> for &'static RewardModelKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        RewardModelKind::named(&name).ok_or_else(|| {
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
    /// The state in which a step acts.
    State,
    /// The state that a step reaches.
    NextState,
    /// A state and the next one.
    Transition,
    /// A state and the action taken there.
    StateAction,
}

/// Form of the reward per step.
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

impl RewardInput {
    /// Returns whether a row is a single state, so that a model can score any state by itself.
    pub fn is_single_state(self) -> bool {
        matches!(self, RewardInput::State | RewardInput::NextState)
    }
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

/// Order of scoring and updates within an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpdateOrder {
    /// Score the batch, then update policy and reward model at the same time (Algorithm 1).
    ScoreFirst,
    /// Update the reward model, then score the batch with it (the authors' code).
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
