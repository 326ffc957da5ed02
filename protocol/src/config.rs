//! What a run is: the effective configuration, complete, checked once, recorded first in its log.
//!
//! A task's file (`deploy/tasks/*.toml`) holds the default preset and, under `[preset.NAME]`, what
//! other presets change. Flags of the command line change single keys. Everything after
//! [`RunConfig::assemble`] reads checked values only.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::Error;
use crate::error::{out_of_range, within};
use crate::setting::Setting;
use crate::table::{flat, merge, parse_setting};
use crate::task::{ObservationSpec, Task};

/// The preset a task's file holds without a table of its own.
pub const DEFAULT_PRESET: &str = "goalward";

/// The effective configuration of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// The task.
    pub task: Task,
    /// The method: a policy learner with a reward model.
    pub method: Method,
    /// Name of the preset it came from.
    pub preset: String,
    /// Seed of every random stream.
    pub seed: u64,
    /// Environment steps to train for; the run ends with the iteration that reaches them.
    pub steps: u64,
    /// The starts and goals the agent is trained and evaluated on, and how its actions act.
    #[serde(default)]
    pub environment: Setting,
    /// Which demonstrations the run learns from.
    pub demonstrations: DemonstrationConfig,
    /// How the policy is rolled out.
    pub rollout: RolloutConfig,
    /// Shape of the policy (paper, Appendix G.2).
    pub policy: PolicyConfig,
    /// Proximal policy optimization (Table 2).
    pub ppo: PpoConfig,
    /// The reward model and the reward made from it (Table 3).
    pub reward: RewardConfig,
    /// Episodes run when training ends.
    pub evaluation: EvaluationConfig,
    /// When the run is saved.
    pub checkpoint: CheckpointConfig,
    /// How the run is recorded.
    pub log: LogConfig,
    /// Processes and threads. They never change a result.
    pub resources: ResourceConfig,
}

/// A policy learner with a reward model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// PPO on the goal-proximity reward: the paper's method.
    GoalProximity,
    /// PPO on the environment's own reward: an upper reference.
    EnvironmentReward,
}

impl std::fmt::Display for Method {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Method::GoalProximity => "goal-proximity",
            Method::EnvironmentReward => "environment-reward",
        })
    }
}

/// Demonstrations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemonstrationConfig {
    /// MCAP file; where it is not given, the expert records one for the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// How many are learned from.
    pub episodes: u64,
    /// Part of starts and goals they may use, in (0, 1].
    pub coverage: f64,
    /// How far their starts and goals spread ([`Setting::noise`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
}

/// Lanes and their steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RolloutConfig {
    /// Environment streams.
    pub lanes: u64,
    /// Steps of a lane per iteration, on average; a lane ends at an episode's end.
    pub lane_steps: u64,
    /// Iterations that actors may be ahead of the policy update: 0 or 1.
    pub lag: u64,
}

impl RolloutConfig {
    /// A number of episodes spread evenly over the lanes: how many each of the first lanes runs.
    pub fn spread(&self, episodes: u64) -> Vec<u64> {
        let lanes = self.lanes.min(episodes);
        (0..lanes).map(|lane| episodes / lanes + u64::from(lane < episodes % lanes)).collect()
    }
}

/// Shape of the policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: [usize; 3],
    /// Numbers the encoder makes of a grid.
    pub features: usize,
    /// Hidden layers of actor and critic, for vector tasks.
    pub hidden: Vec<usize>,
    /// Whether actor and critic share the encoder, for grid tasks.
    pub shared_trunk: bool,
    /// Whether observations are shifted and scaled by their running moments, for vector tasks.
    pub normalize_observations: bool,
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

/// The reward model and the reward made from it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RewardConfig {
    /// Reward per step.
    pub form: RewardForm,
    /// Whether the final proximity is added at the end of an episode (Eq. 5).
    pub final_bonus: bool,
    /// Lambda: weight of the uncertainty penalty (Eq. 5); 0 switches it off.
    pub uncertainty: f64,
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
    /// Observations of each kind in a batch.
    pub batch: usize,
    /// Observations of each kind drawn for an online update; 0 switches online training off.
    pub samples: usize,
    /// Agent observations kept, newest first.
    pub experience: usize,
    /// Order within an iteration.
    pub order: UpdateOrder,
}

/// Reward per step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RewardForm {
    /// Increase of proximity (Eq. 5).
    Difference,
    /// Proximity itself (ablation, Figure 6).
    Absolute,
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

/// Episodes run when training ends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// How many.
    pub episodes: u64,
    /// How actions are chosen.
    pub actions: ActionChoice,
}

/// How a policy's actions are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionChoice {
    /// Drawn from the policy, as in training and in the paper's curves.
    Sample,
    /// The most probable action, or the mean.
    Mode,
}

/// When a run is saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Iterations between checkpoints.
    pub iterations: u64,
    /// How many are kept.
    pub keep: usize,
}

/// How a run is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogConfig {
    /// A file is sealed and the next one opened at this size, MiB.
    pub file_mib: u64,
    /// Whether trajectories are recorded with their observations, or with actions only, from which
    /// `goalward log restore` makes the observations again.
    pub observations: bool,
}

/// Processes and threads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResourceConfig {
    /// Actor processes.
    pub actors: u64,
    /// Threads of the learner; 0 takes one per core.
    pub learner_threads: usize,
    /// Threads of the proximity service; 0 takes one per core.
    pub service_threads: usize,
    /// A lease not finished after this long is handed out again, milliseconds.
    pub lease_timeout_ms: u64,
}

impl RunConfig {
    /// Puts a configuration together: a task's file, a preset of it, then `key=value` settings.
    pub fn assemble(file: &str, preset: &str, settings: &[String]) -> Result<Self, Error> {
        let text_error = |origin: &str, message: String| Error::ConfigurationText {
            origin: origin.to_owned(),
            message: message.trim().to_owned(),
        };
        let mut table: Table =
            file.parse().map_err(|error: toml::de::Error| text_error("file", error.to_string()))?;
        let presets = match table.remove("preset") {
            Some(Value::Table(presets)) => presets,
            _ => Table::new(),
        };
        if preset != DEFAULT_PRESET {
            let Some(Value::Table(changes)) = presets.get(preset) else {
                let known: Vec<_> = presets.keys().map(String::as_str).collect();
                let known = format!("one of {DEFAULT_PRESET}, {}", known.join(", "));
                return Err(out_of_range("preset", &known, preset));
            };
            merge(&mut table, changes.clone());
        }
        table.insert("preset".to_owned(), Value::String(preset.to_owned()));
        for setting in settings {
            let change = parse_setting(setting)
                .map_err(|message| text_error(&format!("--set {setting}"), message))?;
            merge(&mut table, change);
        }
        Self::from_table(table)
    }

    /// Reads a complete configuration, as a run's `config.toml` holds it.
    pub fn from_text(text: &str, origin: &str) -> Result<Self, Error> {
        let table = text.parse::<Table>().map_err(|error| Error::ConfigurationText {
            origin: origin.to_owned(),
            message: error.to_string().trim().to_owned(),
        })?;
        Self::from_table(table)
    }

    fn from_table(table: Table) -> Result<Self, Error> {
        let config: RunConfig =
            Value::Table(table).try_into().map_err(|error: toml::de::Error| {
                Error::ConfigurationText {
                    origin: "values".to_owned(),
                    message: error.to_string().trim().replace('\n', " "),
                }
            })?;
        config.check()?;
        Ok(config)
    }

    /// The configuration as a complete TOML text.
    pub fn to_text(&self) -> String {
        toml::to_string(self).expect("a configuration has only tables, numbers and texts")
    }

    /// Whether another configuration gives the same weights, bit for bit.
    pub fn same_result_as(&self, other: &Self) -> bool {
        self.result_difference(other).is_none()
    }

    /// The first key of those that decide the result whose value is another one in `other`, with
    /// both values.
    pub fn result_difference(&self, other: &Self) -> Option<(String, [String; 2])> {
        self.result_differences(other).into_iter().next()
    }

    /// Every such key, in order.
    pub fn result_differences(&self, other: &Self) -> Vec<(String, [String; 2])> {
        let values = |config: &Self| {
            let mut table = config.to_text().parse::<Table>().expect("it has just been written");
            for key in ["resources", "checkpoint", "log"] {
                table.remove(key);
            }
            flat(&table)
        };
        let (own, others) = (values(self), values(other));
        let keys: BTreeSet<&String> = own.keys().chain(others.keys()).collect();
        let shown = |values: &BTreeMap<String, Value>, key| {
            values.get(key).map_or("nothing".to_owned(), Value::to_string)
        };
        let differing = keys.into_iter().filter(|key| own.get(*key) != others.get(*key));
        differing.map(|key| (key.clone(), [shown(&own, key), shown(&others, key)])).collect()
    }

    /// What an expert's demonstrations for this run start from and reach.
    pub fn demonstration_setting(&self) -> Setting {
        let DemonstrationConfig { coverage, noise, .. } = self.demonstrations;
        Setting { coverage, noise, ..self.environment.clone() }
    }

    /// Environment steps of one iteration, on average.
    pub fn iteration_steps(&self) -> u64 {
        self.rollout.lanes * self.rollout.lane_steps
    }

    /// Iterations the run takes.
    pub fn iterations(&self) -> u64 {
        self.steps.div_ceil(self.iteration_steps())
    }

    fn check(&self) -> Result<(), Error> {
        let at_least_one = [
            ("steps", self.steps),
            ("demonstrations.episodes", self.demonstrations.episodes),
            ("rollout.lanes", self.rollout.lanes),
            ("rollout.lane_steps", self.rollout.lane_steps),
            ("policy.features", self.policy.features as u64),
            ("ppo.epochs", self.ppo.epochs),
            ("ppo.minibatches", self.ppo.minibatches),
            ("reward.batch", self.reward.batch as u64),
            ("reward.experience", self.reward.experience as u64),
            ("checkpoint.iterations", self.checkpoint.iterations),
            ("checkpoint.keep", self.checkpoint.keep as u64),
            ("log.file_mib", self.log.file_mib),
            ("resources.actors", self.resources.actors),
            ("resources.lease_timeout_ms", self.resources.lease_timeout_ms),
        ];
        for (key, number) in at_least_one {
            within(key, number >= 1, "at least 1", number)?;
        }
        let spec = self.task.spec();
        self.environment.check("environment", &spec)?;
        self.demonstration_setting().check("demonstrations", &spec)?;
        self.check_limits()?;
        self.check_fractions()
    }

    fn check_limits(&self) -> Result<(), Error> {
        let seed = self.seed;
        within("seed", seed <= i64::MAX as u64, "below 2^63", seed)?;
        within("rollout.lag", self.rollout.lag <= 1, "0 or 1", self.rollout.lag)?;
        within("rollout.lanes", self.rollout.lanes <= 4096, "at most 4096", self.rollout.lanes)?;
        let (lane_steps, horizon) = (self.rollout.lane_steps, self.task.spec().horizon_steps);
        let expected = format!("at least the longest episode, {horizon}");
        within("rollout.lane_steps", lane_steps >= u64::from(horizon), &expected, lane_steps)?;
        let normalized = self.policy.normalize_observations;
        let vector = matches!(self.task.spec().observation, ObservationSpec::Vector { .. });
        within("policy.normalize_observations", vector || !normalized, "false for a grid", true)?;
        let normalized = self.reward.normalize_observations;
        within("reward.normalize_observations", vector || !normalized, "false for a grid", true)?;
        let actors = self.resources.actors;
        within("resources.actors", actors <= 64, "at most 64", actors)?;
        let ensemble = self.reward.ensemble;
        within("reward.ensemble", (1..=32).contains(&ensemble), "1 to 32", ensemble)?;
        let needs_two = self.reward.uncertainty > 0.0;
        within("reward.ensemble", ensemble >= 2 || !needs_two, "2 for uncertainty", ensemble)?;
        let (samples, batch) = (self.reward.samples, self.reward.batch);
        within(
            "reward.samples",
            samples == 0 || samples >= batch,
            "0 or at least a batch",
            samples,
        )?;
        let (minibatches, steps) = (self.ppo.minibatches, self.iteration_steps());
        within("ppo.minibatches", minibatches <= steps / 2, "at most half the steps", minibatches)
    }

    fn check_fractions(&self) -> Result<(), Error> {
        let positive = [
            ("ppo.learning_rate", self.ppo.learning_rate),
            ("ppo.adam_epsilon", self.ppo.adam_epsilon),
            ("ppo.clip", self.ppo.clip),
            ("ppo.max_gradient_norm", self.ppo.max_gradient_norm),
            ("reward.learning_rate", self.reward.learning_rate),
        ];
        for (key, number) in positive {
            within(key, number.is_finite() && number > 0.0, "above 0", number)?;
        }
        let not_negative = [
            ("ppo.value_clip", self.ppo.value_clip),
            ("ppo.value_coefficient", self.ppo.value_coefficient),
            ("ppo.entropy_coefficient", self.ppo.entropy_coefficient),
            ("ppo.target_kl", self.ppo.target_kl),
            ("reward.uncertainty", self.reward.uncertainty),
        ];
        for (key, number) in not_negative {
            within(key, number.is_finite() && number >= 0.0, "0 or above", number)?;
        }
        let unit = [
            ("ppo.gamma", self.ppo.gamma),
            ("ppo.gae_lambda", self.ppo.gae_lambda),
            ("reward.delta", self.reward.delta),
        ];
        for (key, number) in unit {
            within(key, number > 0.0 && number <= 1.0, "above 0 and at most 1", number)?;
        }
        Ok(())
    }
}
