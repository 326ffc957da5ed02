//! The demonstrations of a run, read from their MCAP file by whoever learns from them.

use std::path::Path;

use rand::seq::SliceRandom;

use crate::Error;
use crate::config::RunConfig;
use crate::log::{Ending, FileReader, Record};
use crate::run::RunFolder;
use crate::seed::{self, Purpose};
use crate::setting::Setting;
use crate::task::{Spec, floats};
use crate::trajectory::{Encoded, Trajectory};
use crate::weights::to_bytes;

/// The demonstrations a run learns from: as many as it asks for, and where its file has more, each
/// seed takes its own subset. Actions are in the measure of the run's own action scale.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, has too few, or lacks actions that the method needs.
pub fn load(folder: &RunFolder, config: &RunConfig) -> Result<Vec<Trajectory>, Error> {
    let own = || folder.demonstrations_file();
    let file = config.demonstrations.file.clone().unwrap_or_else(own);
    let mut reader = FileReader::open(&file)?;
    let recorded = recorded_scale(&reader);
    let with_actions = config.needs_expert_actions();
    let mut trajectories = rest(&mut reader, &file, &config.task.spec(), with_actions)?;
    let (found, wanted) = (trajectories.len(), config.demonstrations.episodes as usize);
    if found < wanted {
        let message = format!("expected at least {wanted} demonstrations, found {found}");
        return Err(Error::Demonstrations { path: file, message });
    }
    let mut chosen: Vec<usize> = (0..found).collect();
    chosen.shuffle(&mut seed::stream(config.seed, Purpose::DemonstrationSubset, 0, 0));
    chosen.truncate(wanted);
    chosen.sort_unstable();
    let factors = factors(&recorded, &config.environment.action_scale);
    let taken = |at: usize| rescaled(std::mem::take(&mut trajectories[at]), &factors);
    Ok(chosen.into_iter().map(taken).collect())
}

/// The action scale that demonstrations were recorded with; a file that does not tell had none.
fn recorded_scale(reader: &FileReader) -> Vec<f32> {
    let setting = reader.metadata().get("setting");
    let setting = setting.and_then(|text| serde_json::from_str::<Setting>(text).ok());
    setting.unwrap_or_default().action_scale
}

/// What each number of a recorded action is multiplied with so that it acts alike under another
/// scale; none where both are the same.
fn factors(recorded: &[f32], own: &[f32]) -> Vec<f32> {
    if recorded == own {
        return Vec::new();
    }
    let factor = |scale: &[f32], index| scale.get(index).copied().unwrap_or(1.0);
    let numbers = 0..recorded.len().max(own.len());
    numbers.map(|index| factor(recorded, index) / factor(own, index)).collect()
}

fn rescaled(trajectory: Trajectory, factors: &[f32]) -> Trajectory {
    if factors.is_empty() {
        return trajectory;
    }
    let factors = factors.iter().cycle();
    let numbers = floats(&trajectory.continuous_actions).zip(factors);
    let numbers: Vec<f32> = numbers.map(|(number, factor)| number * factor).collect();
    Trajectory { continuous_actions: to_bytes(&numbers), ..trajectory }
}

/// Every demonstration of a file.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, or lacks actions where they are needed.
pub fn read(file: &Path, spec: &Spec, with_actions: bool) -> Result<Vec<Trajectory>, Error> {
    rest(&mut FileReader::open(file)?, file, spec, with_actions)
}

/// What a reader has not given yet of a file of demonstrations.
fn rest(
    reader: &mut FileReader,
    file: &Path,
    spec: &Spec,
    with_actions: bool,
) -> Result<Vec<Trajectory>, Error> {
    let failed = |message: String| Error::Demonstrations { path: file.to_owned(), message };
    let mut trajectories = Vec::new();
    for entry in &mut *reader {
        let Record::Trajectory(bytes) = entry?.record else { continue };
        let number = trajectories.len();
        let of_this = |message: String| failed(format!("demonstration {number}: {message}"));
        let encoded = Encoded::decode(bytes, spec).map_err(|error| of_this(error.to_string()))?;
        let trajectory = encoded.trajectory;
        if !trajectory.success {
            return Err(of_this("expected one that reaches the goal".to_owned()));
        }
        if with_actions && trajectory.actions().is_empty() {
            let message =
                "expected the expert's actions, which this method needs, found states only";
            return Err(of_this(message.to_owned()));
        }
        trajectories.push(trajectory);
    }
    match reader.ending() {
        Some(Ending::Complete) => Ok(trajectories),
        Some(ending) => {
            Err(failed(format!("{ending}; `goalward log repair` keeps what is readable")))
        }
        None => Err(failed("expected an end, found none".to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_action_acts_alike_under_another_scale() {
        assert!(factors(&[0.4, 0.4], &[0.4, 0.4]).is_empty());
        assert_eq!(factors(&[0.5, 2.0], &[]), [0.5, 2.0]);
        assert_eq!(factors(&[], &[0.5, 2.0]), [2.0, 0.5]);
        let continuous_actions = to_bytes(&[1.0, 1.0, -2.0, 3.0]);
        let trajectory = Trajectory { continuous_actions, ..Trajectory::default() };
        let found = rescaled(trajectory, &factors(&[0.5, 2.0], &[0.25, 1.0])).continuous_actions;
        assert_eq!(floats(&found).collect::<Vec<_>>(), [2.0, 2.0, -4.0, 6.0]);
    }
}
