//! A Python environment as the actor sees it: a slot of the process that holds it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use environments::{ActionScale, Environment, EnvironmentError, Setting, Step};
use protocol::ending::Ending;
use protocol::error::within;
use protocol::seed::Stream;
use protocol::setting::{MAKE, SOURCES};
use protocol::task::{ActionSpec, ObservationSpec, Spec, floats, write_floats};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use serde_json::json;
use toml::Table;
use xxhash_rust::xxh3::Xxh3;

use super::link::Link;
use crate::frame::{Answer, Hello, Request};

/// The key of a setting that makes the environment render pictures.
pub const RENDER: &str = "render";

/// The setting of a Python environment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PythonSetting {
    /// `gym:ID`, `gym:module:ID` or `python:module:function`.
    pub make: String,
    /// Keyword arguments.
    #[serde(default)]
    pub kwargs: Table,
    /// What tells success: `is_success` or `success` of a step's info; `terminated`; `reward`, that is, a reward above
    /// 0 at termination; `module:function`; `none`; or `auto`, which is determined by a trial step.
    #[serde(default = "auto")]
    pub success: String,
    /// Whether every episode gets a new environment, because one episode affects the next.
    #[serde(default)]
    pub rebuild: bool,
    /// Factors that multiply the numbers of a continuous action before they are clipped to [-1, 1]; if empty,
    /// actions are only clipped.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub action_scale: Vec<f64>,
    /// `module:function` of an expert: called with the environment when an episode has begun, it returns a
    /// function from observations to actions. Empty if there is no expert.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub expert: String,
    /// Longest episode, in steps; 0 takes the environment's own limit.
    #[serde(default)]
    pub horizon_steps: u32,
    /// Whether the environment renders pictures of its states.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub render: bool,
    /// Versions of Python and its packages that the task was described with.
    #[serde(default)]
    pub versions: BTreeMap<String, String>,
    /// SHA-256 of the files of the user's own modules that the task was described with. Modules of installed
    /// packages are left out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub sources: BTreeMap<String, String>,
}

fn auto() -> String {
    "auto".to_owned()
}

/// The running processes, by the options they were started with. Environments with the same options share a
/// process, which stays when an actor has no lane for a while.
static LINKS: Mutex<Vec<(String, Arc<Mutex<Link>>)>> = Mutex::new(Vec::new());

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PythonSetting {
    /// Returns the options that a process is started with, as JSON.
    pub(super) fn options(&self) -> String {
        let PythonSetting { make, kwargs, success, expert, render, .. } = self;
        json!({
            "environment": make,
            "kwargs": kwargs,
            "success": success,
            "expert": expert,
            "render": render,
        })
        .to_string()
    }

    /// Checks that packages and modules are those that the task was described with.
    fn require(
        &self,
        versions: &BTreeMap<String, String>,
        sources: &BTreeMap<String, String>,
    ) -> Result<(), EnvironmentError> {
        // The environment of the demonstrations may use other packages than the agent's, and have its class in
        // another module.
        for (package, expected) in &self.versions {
            let Some(found) = versions.get(package) else { continue };
            let key = format!("versions.{package}");
            within(&key, found == expected, &format!("{found}, which is installed"), expected)?;
        }
        for (module, expected) in &self.sources {
            let Some(found) = sources.get(module) else { continue };
            let key = format!("{SOURCES}.{module}");
            within(&key, found == expected, &format!("{found}, as its file is now"), expected)?;
        }
        Ok(())
    }
}

/// Returns a setting as a demonstrations file records it: without hashes of modules, because states stay valid
/// when a module is changed later.
pub(crate) fn as_recorded(setting: &Setting) -> Setting {
    let mut recorded = setting.clone();
    if recorded.0.contains_key(MAKE) {
        recorded.0.remove(SOURCES);
    }
    recorded
}

/// Returns the process for a setting; starts it if there is none.
fn link(setting: &PythonSetting) -> Result<Arc<Mutex<Link>>, EnvironmentError> {
    let (make, options) = (&setting.make, setting.options());
    let mut links = locked(&LINKS);
    links.retain(|(_, link)| !locked(link).has_ended());
    let known = links.iter().find(|(known, _)| *known == options);
    if let Some((_, link)) = known {
        return Ok(Arc::clone(link));
    }
    let link = Link::start(&options)?;
    let dropped = &link.hello().dropped;
    if !dropped.is_empty() {
        tracing::warn!("{make}: texts are left out: {}", dropped.join(", "));
    }
    let link = Arc::new(Mutex::new(link));
    links.push((options, Arc::clone(&link)));
    Ok(link)
}

/// Ends the processes that no environment needs any more, after they have closed their own environments.
pub fn close() {
    locked(&LINKS).clear();
}

/// Makes a Python environment.
///
/// # Errors
/// When there is no Python or no such environment, or when no task can have its spaces.
pub fn make(setting: &Setting) -> Result<Box<dyn Environment>, EnvironmentError> {
    Ok(Box::new(Slot::new(setting.read()?)?))
}

/// A slot of a Python process.
pub(super) struct Slot {
    link: Arc<Mutex<Link>>,
    number: u16,
    setting: PythonSetting,
    spec: Spec,
    scale: ActionScale,
    labels: Vec<String>,
    steps: u32,
    success: bool,
    is_running: bool,
    /// Hash of the rewards and observations that the episode has returned.
    state: Xxh3,
}

impl Slot {
    /// Takes a slot of the process for a setting.
    pub(super) fn new(setting: PythonSetting) -> Result<Slot, EnvironmentError> {
        Slot::of(link(&setting)?, setting)
    }

    /// Takes another slot of the same process.
    pub(super) fn another(&self) -> Result<Slot, EnvironmentError> {
        Slot::of(Arc::clone(&self.link), self.setting.clone())
    }

    /// Takes a slot of a process that nothing else uses.
    pub(super) fn on(link: Link, setting: PythonSetting) -> Result<Slot, EnvironmentError> {
        Slot::of(Arc::new(Mutex::new(link)), setting)
    }

    fn of(link: Arc<Mutex<Link>>, setting: PythonSetting) -> Result<Slot, EnvironmentError> {
        let hello = locked(&link).hello().clone();
        let Hello { observation, action, horizon_steps, labels, success, .. } = hello;
        let Hello { versions, sources, .. } = hello;
        setting.require(&versions, &sources)?;
        let horizon_steps = match setting.horizon_steps {
            0 => horizon_steps.unwrap_or(0),
            steps => steps,
        };
        let some = horizon_steps > 0;
        let expected = "at least 1: the environment has no limit of its own";
        within("environment.horizon_steps", some, expected, horizon_steps)?;
        let scale = match action {
            ActionSpec::Continuous { len } => ActionScale::new(&setting.action_scale, len)?,
            ActionSpec::Discrete { .. } => ActionScale::new(&setting.action_scale, 0)?,
        };
        let number = locked(&link).take_slot();
        Ok(Slot {
            link,
            number,
            setting: PythonSetting { success, versions, sources, ..setting },
            spec: Spec { observation, action, horizon_steps },
            scale,
            labels,
            steps: 0,
            success: false,
            is_running: false,
            state: Xxh3::new(),
        })
    }

    /// Takes in and checks what the episode returned, and writes the observation.
    fn take(&mut self, answer: &Answer, observation: &mut [u8]) -> Result<(), EnvironmentError> {
        observation.copy_from_slice(&answer.observation);
        self.state.update(&answer.reward.to_le_bytes());
        self.state.update(observation);
        if !answer.reward.is_finite() {
            let found = answer.reward;
            return Err(EnvironmentError::Raised(format!(
                "expected a finite reward at step {}, found {found}",
                self.steps
            )));
        }
        if let ObservationSpec::Vector { .. } = self.spec.observation {
            let wrong = floats(observation).enumerate().find(|(_, number)| !number.is_finite());
            if let Some((index, found)) = wrong {
                let label = self.labels.get(index).map_or("observation", String::as_str);
                return Err(EnvironmentError::Raised(format!(
                    "expected finite numbers in the observation, found {found} in {label} at step {}",
                    self.steps
                )));
            }
        }
        Ok(())
    }
}

impl Environment for Slot {
    fn spec(&self) -> Spec {
        self.spec
    }

    fn setting(&self) -> Setting {
        Setting::of(&self.setting)
    }

    fn labels(&self) -> Vec<String> {
        self.labels.clone()
    }

    fn tells_success(&self) -> bool {
        self.setting.success != "none"
    }

    fn reset(
        &mut self,
        stream: &mut Stream,
        observation: &mut [u8],
    ) -> Result<(), EnvironmentError> {
        let seed = stream.random::<u32>() >> 1;
        let answer = {
            let mut link = locked(&self.link);
            link.announce(self.number, Request::Reset { seed, rebuild: self.setting.rebuild });
            link.answer(self.number)?
        };
        (self.steps, self.success, self.is_running) = (0, false, true);
        self.state = Xxh3::new();
        self.take(&answer, observation)
    }

    fn announce(&mut self, action: &[u8]) -> Result<(), EnvironmentError> {
        environments::check_action(&self.spec, self.is_running, action)?;
        let mut scaled = action.to_vec();
        if let ActionSpec::Continuous { .. } = self.spec.action {
            write_floats(self.scale.scaled(action), &mut scaled);
        }
        locked(&self.link).announce(self.number, Request::Step(&scaled));
        Ok(())
    }

    fn step(&mut self, action: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError> {
        if !locked(&self.link).is_announced(self.number) {
            self.announce(action)?;
        }
        let answer = locked(&self.link).answer(self.number)?;
        self.steps += 1;
        self.take(&answer, observation)?;
        self.success |= answer.success;
        let ending = match (answer.terminated, self.success) {
            (true, true) => Some(Ending::GoalReached),
            (true, false) => Some(Ending::Failed),
            _ if answer.truncated => Some(Ending::Truncated),
            _ => self.spec.ending(false, self.steps),
        };
        self.is_running = ending.is_none();
        Ok(Step { reward: answer.reward, ending, success: self.success })
    }

    fn expert_action(&mut self, action: &mut [u8]) -> Result<bool, EnvironmentError> {
        if self.setting.expert.is_empty() || !self.is_running {
            return Ok(false);
        }
        let found = locked(&self.link).expert_action(self.number)?;
        environments::check_action(&self.spec, true, &found)?;
        action.copy_from_slice(&found);
        if let ActionSpec::Continuous { .. } = self.spec.action {
            write_floats(self.scale.unscaled(floats(&found)), action);
        }
        Ok(true)
    }

    fn picture(&mut self) -> Result<Option<Vec<u8>>, EnvironmentError> {
        if !self.setting.render {
            return Ok(None);
        }
        let picture = locked(&self.link).picture(self.number)?;
        Ok((!picture.is_empty()).then_some(picture))
    }

    fn state_hash(&self) -> u64 {
        self.state.digest()
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        locked(&self.link).give_back(self.number);
    }
}
