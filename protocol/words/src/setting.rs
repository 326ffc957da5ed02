//! What an environment draws its starts and goals from, and how actions act in it: the axes along
//! which the paper makes its tasks harder (Section 4.3 and Appendix C).

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::{out_of_range, within};
use crate::task::{ActionSpec, Spec, Task};

/// The starts and goals of an environment, and how actions act in it.
///
/// What is not given has the task's own default: the spread of its demonstrations, the paper's
/// ranges, no contact forces, actions as they are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Setting {
    /// The part of starts and goals used, in (0, 1]. The paper has 0.25, 0.5, 0.75 and 1.
    pub coverage: f64,
    /// How far starts and goals spread. Fetch tasks: a factor of their ranges, 1 being that of the
    /// demonstrations. Ant Reach: half the width of the uniform noise on the starting pose, 0 for
    /// the demonstrations, in meters and radians. Navigation has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
    /// Where objects and goals of the Fetch tasks lie. Others have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ranges: Option<Ranges>,
    /// Whether Ant Reach observes contact forces; they are zeros in the authors' runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_forces: Option<bool>,
    /// What each number of a continuous action is multiplied with before it is clipped to [-1, 1];
    /// empty leaves actions as they are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub action_scale: Vec<f32>,
}

/// Where objects and goals of the Fetch tasks lie around their centers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ranges {
    /// To both sides of the center, as the paper says.
    #[default]
    Symmetric,
    /// Away from the gripper only, as in the authors' code.
    OneSided,
}

impl Default for Setting {
    fn default() -> Self {
        Setting {
            coverage: 1.0,
            noise: None,
            ranges: None,
            contact_forces: None,
            action_scale: Vec::new(),
        }
    }
}

impl Setting {
    /// The noise there is: where none is given, that of the task's demonstrations. Navigation has none.
    pub fn effective_noise(&self, task: Task) -> Option<f64> {
        self.noise.or(match task {
            Task::Navigation => None,
            Task::FetchPick | Task::FetchPush => Some(1.0),
            Task::AntReach => Some(0.0),
        })
    }

    /// Checks that the task has such a setting. `part` is where the configuration has it:
    /// `environment` or `demonstrations`.
    ///
    /// # Errors
    /// Names the first key that is out of its range, or that the task does not have.
    pub fn check(&self, part: &str, spec: &Spec) -> Result<(), Error> {
        let task = spec.task;
        let no_such = |key: &str, found: String| {
            let expected = format!("absent, {task} has none");
            Err(out_of_range(&format!("{part}.{key}"), &expected, found))
        };
        self.check_coverage(part, task)?;
        let largest_noise = match task {
            Task::Navigation => None,
            Task::FetchPick | Task::FetchPush => Some(4.0),
            Task::AntReach => Some(0.5),
        };
        match (self.noise, largest_noise) {
            (Some(noise), None) => return no_such("noise", noise.to_string()),
            (Some(noise), Some(largest)) => {
                let expected = format!("0 to {largest}");
                let holds = (0.0..=largest).contains(&noise);
                within(&format!("{part}.noise"), holds, &expected, noise)?;
            }
            (None, _) => {}
        }
        let fetch = matches!(task, Task::FetchPick | Task::FetchPush);
        if self.ranges.is_some() && !fetch {
            return no_such("ranges", "some".to_owned());
        }
        if let Some(found) = self.contact_forces.filter(|_| task != Task::AntReach) {
            return no_such("contact_forces", found.to_string());
        }
        self.check_action_scale(part, spec)
    }

    fn check_coverage(&self, part: &str, task: Task) -> Result<(), Error> {
        let (key, found) = (format!("{part}.coverage"), self.coverage);
        match task {
            Task::Navigation | Task::AntReach => {
                within(&key, found > 0.0 && found <= 1.0, "above 0 and at most 1", found)
            }
            Task::FetchPick | Task::FetchPush => {
                let parts = [0.25, 0.5, 0.75, 1.0];
                within(&key, parts.contains(&found), "0.25, 0.5, 0.75 or 1", found)
            }
        }
    }

    fn check_action_scale(&self, part: &str, spec: &Spec) -> Result<(), Error> {
        let (key, found) = (format!("{part}.action_scale"), self.action_scale.len());
        let len = match spec.action {
            ActionSpec::Continuous { len } => len,
            ActionSpec::Discrete { .. } => 0,
        };
        let expected = format!("empty or {len} numbers, as the action has");
        within(&key, found == 0 || found == len, &expected, format!("{found} numbers"))?;
        for &number in &self.action_scale {
            within(&key, number.is_finite() && number > 0.0, "of numbers above 0", number)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(task: Task, setting: Setting) -> String {
        setting.check("environment", &task.spec()).unwrap_err().to_string()
    }

    #[test]
    fn a_task_takes_only_what_it_has() {
        for task in Task::ALL {
            assert!(Setting::default().check("environment", &task.spec()).is_ok(), "{task}");
        }
        let noise = |noise| Setting { noise: Some(noise), ..Setting::default() };
        assert!(noise(1.75).check("environment", &Task::FetchPick.spec()).is_ok());
        assert!(refusal(Task::Navigation, noise(1.0)).contains("absent, navigation has none"));
        assert!(refusal(Task::FetchPush, noise(-1.0)).contains("`environment.noise` must be 0 to"));
        assert!(refusal(Task::AntReach, noise(f64::NAN)).contains("found NaN"));
        let coverage = |coverage| Setting { coverage, ..Setting::default() };
        assert!(refusal(Task::Navigation, coverage(0.0)).contains("above 0 and at most 1"));
        assert!(
            refusal(Task::FetchPick, coverage(0.6)).contains("0.25, 0.5, 0.75 or 1, found 0.6")
        );
        let forces = Setting { contact_forces: Some(true), ..Setting::default() };
        assert!(refusal(Task::FetchPick, forces).contains("contact_forces"));
        let ranges = Setting { ranges: Some(Ranges::OneSided), ..Setting::default() };
        assert!(refusal(Task::AntReach, ranges).contains("ranges"));
    }

    #[test]
    fn an_action_scale_fits_the_action() {
        let scale =
            |numbers: &[f32]| Setting { action_scale: numbers.to_vec(), ..Setting::default() };
        assert!(scale(&[0.1, 0.2, 0.3]).check("environment", &Task::FetchPush.spec()).is_ok());
        assert!(refusal(Task::FetchPush, scale(&[0.1])).contains("3 numbers"));
        assert!(refusal(Task::FetchPush, scale(&[0.1, 0.0, 0.2])).contains("above 0"));
        assert!(refusal(Task::Navigation, scale(&[0.1])).contains("environment.action_scale"));
    }
}
