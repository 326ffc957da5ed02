//! The effective configuration of a run: complete, checked, and recorded first in its log.
//!
//! `defaults.toml` beside this file has a value for every key. A task's file
//! (`deploy/tasks/*.toml`, or one of the user's) says what the task is and which values it changes
//! and, under `[preset.NAME]`, what other presets change. The changes of a method follow, then
//! those of the command line. All code after [`RunConfig::assemble`] reads checked values only.

mod check;
mod estimate;
mod evaluation;
mod learner;
mod learning;
mod method;
mod parameters;
mod remark;
mod reward;
mod scoring;
mod settings;
mod unread;
mod wording;

use std::ops::Range;
use std::path::PathBuf;

use protocol::Error;
use protocol::description::Description;
use protocol::dropped::shortened;
use protocol::error::{MESSAGE_CHARS, out_of_range, within};
use protocol::setting::Setting;
use protocol::table::{flat, merge, result_differences};
use protocol::task::{ActionSpec, ObservationSpec, Task};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

pub use estimate::{Estimate, Memory, Work};
pub use evaluation::{ActionChoice, EvaluationConfig};
pub use learner::{
    AfterGoal, CloningConfig, InverseDynamicsConfig, LEARNERS, Learner, LearnerRules, PpoConfig,
    SqilConfig,
};
use mcap_log::Metadata;
pub use parameters::NetworkSize;
pub use protocol::policy::{ActionDistribution, PolicyActivation, PolicyConfig};
pub use reward::{
    Discounting, Discriminator, REWARD_MODELS, RewardConfig, RewardForm, RewardInput,
    RewardModelKind, UpdateOrder,
};
pub(crate) use settings::merged as merged_settings;
pub use settings::set_by_user;

/// The preset that a task's file holds outside of its `preset` tables.
const DEFAULT_PRESET: &str = "goalward";

/// Why a learner's table is always present.
const HAS_DEFAULTS: &str = "a configuration has every table of its learner";

/// Defaults of the keys that tasks have in common, and those for single learners, grids and vectors.
const DEFAULTS: &str = include_str!("defaults.toml");

/// The effective configuration of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// The task.
    pub task: Task,
    /// Name of the method, a policy learner with a reward model.
    pub method: String,
    /// Name of its preset.
    pub preset: String,
    /// The policy learner.
    pub learner: Learner,
    /// Seed of every random stream.
    pub seed: u64,
    /// Environment steps to train for, in iterations of `rollout.lanes x rollout.lane_steps`, rounded up. Lanes
    /// end with an episode, so the steps may be reached an iteration earlier. Behavioral cloning takes none.
    pub steps: u64,
    /// Setting of the environment that the agent is trained and evaluated in.
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
    /// Supervised learning of the policy, for learners that clone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cloning: Option<CloningConfig>,
    /// The inverse dynamics model, for behavioral cloning from observation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inverse_dynamics: Option<InverseDynamicsConfig>,
    /// Soft Q imitation learning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sqil: Option<SqilConfig>,
    /// The reward model and how rewards are made from it (Table 3).
    pub reward: RewardConfig,
    /// The evaluation at the end of training.
    pub evaluation: EvaluationConfig,
    /// When the run is saved.
    pub checkpoint: CheckpointConfig,
    /// How the run is recorded.
    pub log: LogConfig,
    /// Processes and threads. They never change a result.
    pub resources: ResourceConfig,
}

/// The demonstrations of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DemonstrationConfig {
    /// MCAP file; if it is not given, the expert records one for the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// Number of demonstrations that the run learns from.
    pub episodes: u64,
    /// All other keys: how the environment of the demonstrations differs from the agent's.
    #[serde(flatten)]
    pub environment: Setting,
}

/// Lanes and their steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RolloutConfig {
    /// Number of environment streams.
    pub lanes: u64,
    /// Steps of a lane per iteration, on average; a lane ends an iteration at the end of an episode.
    pub lane_steps: u64,
    /// Iterations that actors may be ahead of the policy update: 0 or 1.
    pub lag: u64,
}

impl RolloutConfig {
    /// Spreads episodes evenly over the lanes; returns the number for each lane that runs any.
    pub fn spread(&self, episodes: u64) -> Vec<u64> {
        let lanes = self.lanes.min(episodes);
        (0..lanes).map(|lane| episodes / lanes + u64::from(lane < episodes % lanes)).collect()
    }
}

/// When a run is saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Iterations between checkpoints.
    pub iterations: u64,
    /// Number of checkpoints kept.
    pub keep: usize,
}

/// How a run is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogConfig {
    /// Size at which a file is sealed and the next one opened, MiB.
    pub file_mib: u64,
    /// Whether trajectories are recorded with their observations; otherwise with actions only, from
    /// which `goalward log restore` recomputes the observations.
    pub observations: bool,
}

/// Processes and threads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResourceConfig {
    /// Number of actor processes.
    pub actors: u64,
    /// Threads of the learner; 0 means one per core.
    pub learner_threads: usize,
    /// Threads of the proximity service; 0 means one per core.
    pub service_threads: usize,
    /// Time after which an unfinished lease is handed out again once no others are open, milliseconds.
    pub lease_timeout_ms: u64,
}

impl RunConfig {
    /// Assembles a configuration from the defaults, a task's file, a preset of that file, the changes of a method,
    /// and `key=value` settings, in this order. `methods` has a table for each method. In it, `task` has changes for
    /// single tasks only, `about` is a description, and `like` names the method whose changes it starts from, if
    /// any. The file may also be a run's configuration, which has a preset and a method already: others are refused.
    ///
    /// # Errors
    /// For the first key that is unknown, out of range, or without effect.
    pub fn assemble(
        file: &str,
        methods: &str,
        preset: Option<&str>,
        settings: &[String],
    ) -> Result<Self, Error> {
        let mut file = parse(file, "file")?;
        if file.get("preset").is_some_and(Value::is_str) {
            return Self::repeated(file, preset, settings);
        }
        let preset = preset.unwrap_or(DEFAULT_PRESET);
        let presets = taken(&mut file, "preset");
        let mut table = over_defaults(file, "file")?;
        if preset != DEFAULT_PRESET {
            let Some(Value::Table(changes)) = presets.get(preset) else {
                let known =
                    std::iter::once(DEFAULT_PRESET).chain(presets.keys().map(String::as_str));
                let known = known.collect::<Vec<_>>().join(", ");
                return Err(out_of_range("preset", &format!("one of {known}"), preset));
            };
            merge(&mut table, changes.clone());
        }
        table.insert("preset".to_owned(), Value::String(preset.to_owned()));
        let settings = settings::merged(settings)?;
        let method = settings.get("method").or(table.get("method")).and_then(Value::as_str);
        let method = method.unwrap_or("none").to_owned();
        let methods = parse(methods, "methods")?;
        let task = table.get("task").and_then(|task| task.get("name")).and_then(Value::as_str);
        let changes = method::changes(&methods, &method, task.unwrap_or("none"))?;
        merge(&mut table, changes);
        let learner = settings.get("learner").or(table.get("learner")).cloned();
        unread::leave_out_tables(learner, &mut table);
        Self::changed(table, settings, "file")
    }

    /// Lays settings over the configuration of a run, which includes the changes of its preset and method already.
    fn repeated(run: Table, preset: Option<&str>, settings: &[String]) -> Result<Self, Error> {
        let (table, settings) = (over_defaults(run, "file")?, settings::merged(settings)?);
        let method = settings.get("method").and_then(Value::as_str);
        for (key, wanted) in [("preset", preset), ("method", method)] {
            let own = table.get(key).and_then(Value::as_str).unwrap_or("none");
            let expected = format!("{own}, as in the run whose configuration this is");
            let wanted = wanted.unwrap_or(own);
            within(key, wanted == own, &expected, wanted)?;
        }
        Self::changed(table, settings, "file")
    }

    /// Returns this configuration with `key=value` settings laid over it.
    ///
    /// # Errors
    /// For the first setting that is not `key=value`, unknown, out of range, or without effect.
    pub fn with_settings(&self, settings: &[String]) -> Result<Self, Error> {
        let own = parse(&self.to_text(), "configuration")?;
        Self::changed(own, settings::merged(settings)?, "configuration")
    }

    /// Lays settings over a configuration that is to be trained, and checks that every setting has an effect
    /// and that the run can learn. An error that occurs without the settings, too, is attributed to `origin`.
    fn changed(table: Table, settings: Table, origin: &str) -> Result<Self, Error> {
        let (before, set) = (flat(&table), flat(&settings));
        let mut changed = table.clone();
        merge(&mut changed, settings);
        if let Some(Ok(learner)) = changed.get("learner").cloned().map(Value::try_into) {
            unread::check_tables(learner, &set)?;
        }
        let blamed = |refused: Error| match Self::from_table(table, "--set") {
            Err(own) if own.to_string() == refused.to_string() => refused.of_origin(origin),
            _ => settings::with_likely_key(refused, &set, &before),
        };
        let config = Self::from_table(changed, "--set").map_err(blamed)?;
        config.check_all_is_read(&set, &before)?;
        config.check_learning()?;
        Ok(config)
    }

    /// Returns the configuration that a log file was recorded under; `None` for a file of demonstrations.
    ///
    /// # Errors
    /// As [`RunConfig::from_text`].
    pub fn recorded(metadata: &Metadata) -> Option<Result<Self, Error>> {
        metadata.get("config").map(|text| Self::from_text(text, "of the log"))
    }

    /// Reads a configuration as a run's `config.toml` holds it. Keys that did not exist when it was
    /// written have their defaults.
    ///
    /// # Errors
    /// For the first key that is unknown or out of range.
    pub fn from_text(text: &str, origin: &str) -> Result<Self, Error> {
        Self::from_table(over_defaults(parse(text, origin)?, origin)?, origin)
    }

    fn from_table(mut table: Table, origin: &str) -> Result<Self, Error> {
        if let Some(Ok(learner)) = table.get("learner").cloned().map(Value::try_into) {
            complete_tables(learner, &mut table)?;
        }
        let refused = |error: toml::de::Error| Error::ConfigurationText {
            origin: origin.to_owned(),
            message: line_of(&wording::refusal(&error, &table)),
        };
        let config: RunConfig = Value::Table(table.clone()).try_into().map_err(refused)?;
        config.check()?;
        Ok(config)
    }

    /// Returns the configuration as a complete TOML text.
    pub fn to_text(&self) -> String {
        toml::to_string(self).expect("a configuration has only tables, numbers and texts")
    }

    /// Returns whether another configuration gives the same weights, bit for bit.
    pub fn same_result_as(&self, other: &Self) -> bool {
        self.result_differences(other).is_empty()
    }

    /// Returns the keys that affect the result and have another value in `other`, with both values, in order.
    pub fn result_differences(&self, other: &Self) -> Vec<(String, [String; 2])> {
        let table =
            |config: &Self| config.to_text().parse::<Table>().expect("it has just been written");
        result_differences(&table(self), &table(other))
    }

    /// Returns the setting of the environment that demonstrations for this run are recorded in.
    pub fn demonstration_setting(&self) -> Setting {
        self.environment.with(&self.demonstrations.environment)
    }

    /// Completes this configuration by the description that the program of its task gives: both
    /// settings then have all keys.
    ///
    /// # Errors
    /// If the program's task differs, or has no expert to record the demonstrations.
    pub fn described(mut self, description: Description) -> Result<Self, Error> {
        let Description { task, environment, demonstrations, has_expert } = description;
        let needs_expert = self.imitates() && self.demonstrations.file.is_none();
        let expected = format!(
            "a file (--demonstrations): the task {} has no expert to record one",
            self.task
        );
        within("demonstrations.file", has_expert || !needs_expert, &expected, "none")?;
        let told = |task: &Task| ("tells_success", task.tells_success.to_string());
        let expected = task.spec().named().into_iter().chain([told(&task)]);
        let found = self.task.spec().named().into_iter().chain([told(&self.task)]);
        for ((key, expected), (_, found)) in expected.zip(found) {
            let holds = expected == found;
            let expected = format!("{expected}, as its environment has it");
            within(&format!("task.{key}"), holds, &expected, found)?;
        }
        let expected = "false: its environment gives other bytes for the same seed and actions";
        let holds = task.deterministic || !self.task.deterministic;
        within("task.deterministic", holds, expected, self.task.deterministic)?;
        self.environment = environment;
        for (key, value) in &mut self.demonstrations.environment.0 {
            if let Some(complete) = demonstrations.0.get(key) {
                *value = complete.clone();
            }
        }
        Ok(self)
    }

    /// Returns the environment steps of one iteration, on average.
    pub fn iteration_steps(&self) -> u64 {
        self.rollout.lanes.saturating_mul(self.rollout.lane_steps)
    }

    /// Returns the largest number of iterations that the run takes; behavioral cloning has one for each pass.
    pub fn iterations(&self) -> u64 {
        self.learner.iterations(self)
    }

    /// Returns the environment steps that the run takes; behavioral cloning takes none.
    pub fn steps_wanted(&self) -> u64 {
        if self.learner.acts() { self.steps } else { 0 }
    }

    /// Returns whether the run learns from demonstrations.
    pub fn imitates(&self) -> bool {
        self.learner.imitates() || self.reward.model.imitates
    }

    /// Returns whether the run needs the actions of the demonstrations, too.
    pub fn needs_expert_actions(&self) -> bool {
        self.learner.needs_expert_actions() || self.reward.sees_actions()
    }

    /// Returns whether observations are grids of cells.
    fn is_of_cells(&self) -> bool {
        matches!(self.task.observation, ObservationSpec::Cells { .. })
    }

    /// Returns whether actions are discrete.
    fn has_discrete_actions(&self) -> bool {
        matches!(self.task.action, ActionSpec::Discrete { .. })
    }

    fn cloning(&self) -> &CloningConfig {
        self.cloning.as_ref().expect(HAS_DEFAULTS)
    }

    fn inverse_dynamics(&self) -> &InverseDynamicsConfig {
        self.inverse_dynamics.as_ref().expect(HAS_DEFAULTS)
    }

    fn sqil(&self) -> &SqilConfig {
        self.sqil.as_ref().expect(HAS_DEFAULTS)
    }
}

fn parse(text: &str, origin: &str) -> Result<Table, Error> {
    text.parse::<Table>().map_err(|error| Error::ConfigurationText {
        origin: origin.to_owned(),
        message: format!("{}: {}", place(text, error.span()), line_of(error.message())),
    })
}

/// Lays a configuration's table over the defaults of all tasks and those for its kind of observation.
fn over_defaults(changes: Table, origin: &str) -> Result<Table, Error> {
    let mut defaults = parse(DEFAULTS, "defaults")?;
    taken(&mut defaults, "learners");
    let kinds = ["cells", "vector"].map(|kind| (kind, taken(&mut defaults, kind)));
    let refused = |message| Error::ConfigurationText { origin: origin.to_owned(), message };
    match changes.get("task") {
        Some(Value::Table(task)) => {
            let observation = task.get("observation").and_then(Value::as_table);
            for (kind, of_kind) in kinds {
                if observation.is_some_and(|observation| observation.contains_key(kind)) {
                    merge(&mut defaults, of_kind);
                }
            }
        }
        Some(Value::String(name)) => {
            return Err(refused(format!(
                "expected a table `task` with name, observation, action and horizon_steps, found \
                 task = {name:?}, as older builds of goalward wrote it"
            )));
        }
        _ => {
            let message =
                "expected a table `task` with name, observation, action and horizon_steps";
            return Err(refused(format!("{message}, found none")));
        }
    }
    merge(&mut defaults, changes);
    Ok(defaults)
}

/// Lays the tables of a configuration's learner over their defaults.
fn complete_tables(learner: Learner, table: &mut Table) -> Result<(), Error> {
    let mut learners = taken(&mut parse(DEFAULTS, "defaults")?, "learners");
    for (name, defaults) in taken(&mut learners, learner.name()) {
        let mut complete = Table::from_iter([(name, defaults)]);
        let own = complete.keys().filter_map(|name| Some((name.clone(), table.remove(name)?)));
        let own = own.collect();
        merge(&mut complete, own);
        table.extend(complete);
    }
    Ok(())
}

/// Returns the line in which a span of a text begins, for an error.
fn place(text: &str, span: Option<Range<usize>>) -> String {
    let before = span.and_then(|span| text.get(..span.start)).unwrap_or_default();
    format!("line {}", before.matches('\n').count() + 1)
}

/// Returns a parser's message in one line.
fn line_of(words: &str) -> String {
    shortened(&words.trim().replace('\n', " "), MESSAGE_CHARS)
}

/// Takes the table called `key` out of another one; returns an empty one if there is none.
fn taken(table: &mut Table, key: &str) -> Table {
    match table.remove(key) {
        Some(Value::Table(inner)) => inner,
        _ => Table::new(),
    }
}

fn names(table: &Table) -> String {
    table.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
}
