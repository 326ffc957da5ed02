//! The demonstrations of a run, read from their MCAP file by whoever learns from them.

use std::path::Path;

use rand::seq::SliceRandom;

use crate::Error;
use crate::config::RunConfig;
use crate::log::{Ending, FileReader, Record};
use crate::run::RunFolder;
use crate::seed::{self, Purpose};
use crate::task::Spec;
use crate::trajectory::{Encoded, Trajectory};

/// The demonstrations a run learns from: as many as it asks for, and where its file has more, each
/// seed takes its own subset.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, has too few, or lacks actions that the method needs.
pub fn load(folder: &RunFolder, config: &RunConfig) -> Result<Vec<Trajectory>, Error> {
    let own = || folder.demonstrations_file();
    let file = config.demonstrations.file.clone().unwrap_or_else(own);
    let mut trajectories = read(&file, &config.task.spec(), config.needs_expert_actions())?;
    let (found, wanted) = (trajectories.len(), config.demonstrations.episodes as usize);
    if found < wanted {
        let message = format!("expected at least {wanted} demonstrations, found {found}");
        return Err(Error::Demonstrations { path: file, message });
    }
    let mut chosen: Vec<usize> = (0..found).collect();
    chosen.shuffle(&mut seed::stream(config.seed, Purpose::DemonstrationSubset, 0, 0));
    chosen.truncate(wanted);
    chosen.sort_unstable();
    Ok(chosen.into_iter().map(|at| std::mem::take(&mut trajectories[at])).collect())
}

/// Every demonstration of a file.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, or lacks actions where they are needed.
pub fn read(file: &Path, spec: &Spec, with_actions: bool) -> Result<Vec<Trajectory>, Error> {
    let failed = |message: String| Error::Demonstrations { path: file.to_owned(), message };
    let mut reader = FileReader::open(file)?;
    let mut trajectories = Vec::new();
    for entry in &mut reader {
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
