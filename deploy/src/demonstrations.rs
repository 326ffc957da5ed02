//! The demonstrations of a run. A file that the user gives is checked before anything is begun; otherwise the task's
//! expert records them.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Result, bail};
use mcap_log::Kind;
use protocol::policy::LEAST_SCALED_DEVIATION;
use protocol::setting::Setting;
use protocol::task::{ObservationSpec, Task, floats};
use run::config::RunConfig;
use run::folder::RunFolder;

use crate::output::Output;
use crate::programs::{self, Ended, Program};
use terminal::refusal::Refusal;

/// Words of the status line while an expert records.
pub(crate) const RECORDING: &str = "recording demonstrations";

/// Most numbers of an observation that a remark names.
const NAMED: usize = 8;

/// Demonstrations to be recorded.
pub(crate) struct Recording<'a> {
    pub(crate) task: &'a Task,
    pub(crate) episodes: u64,
    pub(crate) setting: Setting,
    /// Run whose policy is the expert; if `None`, the task's own expert.
    pub(crate) policy: Option<&'a Path>,
    pub(crate) seed: u64,
    pub(crate) file: &'a Path,
    /// Whether an existing file may be replaced.
    pub(crate) force: bool,
}

impl<'a> Recording<'a> {
    /// Returns the recording that a run learns from unless the user gives it a file.
    pub(crate) fn for_run(config: &'a RunConfig, file: &'a Path) -> Self {
        Recording {
            task: &config.task,
            episodes: config.demonstrations.episodes,
            setting: config.demonstration_setting(),
            policy: None,
            seed: config.seed,
            file,
            force: false,
        }
    }

    /// Returns the command of an actor that records them and gives up when its standard input ends. The caller decides
    /// where the actor's output goes.
    ///
    /// # Errors
    /// When the actor's program is missing.
    pub(crate) fn actor(&self) -> Result<Command> {
        let Recording { task, episodes, setting, policy, seed, file, force } = self;
        let mut actor = Program::acting_in(task).command()?;
        actor
            .args(["demonstrate", &task.name])
            .args(["--episodes", &episodes.to_string()])
            .args(["--setting", &serde_json::to_string(setting)?])
            .args(["--seed", &seed.to_string()])
            .arg("--out")
            .arg(file)
            .args(force.then_some("--force"))
            .stdin(Stdio::piped());
        if let Some(run) = policy {
            actor.arg("--policy").arg(run);
        }
        Ok(actor)
    }

    /// Records them with an [`actor`](Self::actor) and shows its progress. Returns `None` if the user has stopped it.
    ///
    /// # Errors
    /// When the actor cannot start.
    pub(crate) fn record(&self, actor: &mut Command) -> Result<Option<Ended>> {
        let ended = programs::run_unless_stopped(actor, RECORDING)?;
        if ended.is_none() {
            // An actor that did not stop in time was killed and has left an unfinished file.
            mcap_log::remove_abandoned(self.file, Kind::Demonstrations)?;
        }
        Ok(ended)
    }
}

/// Records demonstrations into a run's folder; returns false if the user has stopped it.
///
/// # Errors
/// When the expert fails, with its last lines of output; wrong usage, when its demonstrations are too few.
pub(crate) fn record_for_run(folder: &RunFolder, config: &RunConfig) -> Result<bool> {
    let file = folder.demonstrations_file();
    let output = Output::of(folder, "demonstrations");
    let recording = Recording::for_run(config, &file);
    let mut actor = recording.actor()?;
    actor.env("NO_COLOR", "1").stderr(output.open()?);
    match recording.record(&mut actor)? {
        Some(Ended { status, .. }) if !status.success() => {
            bail!("recording demonstrations failed ({status}); {}", output.last_lines())
        }
        Some(_) => check(&file, config).map(|()| true),
        None => Ok(false),
    }
}

/// Checks that a file has the demonstrations that a run is to learn from.
///
/// # Errors
/// Wrong usage, when the file is missing, damaged, too short, or of another task, shape or setting.
pub(crate) fn check(file: &Path, config: &RunConfig) -> Result<()> {
    run::demonstrations::of_file(file, config).map_err(Refusal::usage)?;
    Ok(())
}

/// Returns the configuration with what its file of demonstrations records about them, except where the user's
/// `settings` say otherwise.
///
/// # Errors
/// Wrong usage, when the file cannot be read or is of another task.
pub(crate) fn adopt(config: RunConfig, settings: &[String]) -> Result<RunConfig> {
    Ok(run::demonstrations::adopt(config, settings).map_err(Refusal::usage)?)
}

/// Returns a remark about a file that does not say how its demonstrations were recorded, or in which numbers vary too
/// little to be scaled.
///
/// # Errors
/// As [`adopt`].
pub(crate) fn remark(file: &Path, task: &Task) -> Result<Option<String>> {
    let tells = run::demonstrations::tells_setting(file, task).map_err(Refusal::usage)?;
    let unknown = || {
        format!(
            "{} does not say how it was recorded: assuming the agent's environment and unscaled \
             actions",
            file.display()
        )
    };
    let remarks = [(!tells).then(unknown), remark_on_units(file, task)?];
    let remarks: Vec<String> = remarks.into_iter().flatten().collect();
    Ok((!remarks.is_empty()).then(|| remarks.join("; ")))
}

/// Returns a remark about the numbers that vary in a file, but too little to be scaled, as those of a large unit do.
/// The units of the paper's tasks are given.
fn remark_on_units(file: &Path, task: &Task) -> Result<Option<String>> {
    let ObservationSpec::Vector { len } = task.observation else { return Ok(None) };
    if run::tasks::names().any(|name| name == task.name) {
        return Ok(None);
    }
    let shown = run::demonstrations::read(file, task, false).map_err(Refusal::usage)?;
    let rows = shown.iter().flat_map(|one| one.observations().chunks_exact(4 * len));
    let deviations = deviations(rows, len).into_iter().enumerate();
    let small = deviations.filter(|(_, found)| *found > 0.0 && *found < LEAST_SCALED_DEVIATION);
    let label = |number: usize| task.labels.get(number).cloned();
    let name = |(number, _): (usize, f64)| label(number).unwrap_or_else(|| number.to_string());
    let mut names: Vec<String> = small.map(name).collect();
    if names.is_empty() {
        return Ok(None);
    }
    let more = names.len().saturating_sub(NAMED);
    names.truncate(NAMED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    Ok(Some(format!(
        "these numbers of the observation have a standard deviation below {LEAST_SCALED_DEVIATION} in {}, so \
         networks see them unscaled: {}{more}; in a smaller unit they would count more",
        file.display(),
        names.join(", ")
    )))
}

/// Returns the standard deviation of each of the `len` numbers in some rows, exactly 0 for one that is constant.
fn deviations<'a>(rows: impl Iterator<Item = &'a [u8]>, len: usize) -> Vec<f64> {
    let (mut count, mut moments) = (0.0, vec![[0.0; 2]; len]);
    for row in rows {
        count += 1.0;
        for ([mean, squares], number) in moments.iter_mut().zip(floats(row).map(f64::from)) {
            let distance = number - *mean;
            *mean += distance / count;
            *squares += distance * (number - *mean);
        }
    }
    moments.into_iter().map(|[_, squares]| (squares / count).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use mcap_log::{FileWriter, Metadata, Topic};
    use protocol::task::write_floats;
    use protocol::trajectory::{Encoded, Source, Trajectory};

    use super::*;

    #[test]
    fn numbers_in_a_unit_that_is_too_large_are_named() {
        let text = "[task]\nname = \"road\"\nlabels = [\"km\", \"lane\", \"m\"]\nhorizon_steps = 10\n\
                    observation.vector.len = 3\naction.discrete.count = 2\n";
        let task = run::tasks::of_text(text, "road", None, &[]).unwrap().task;
        let mut values = vec![0; 3 * 12];
        write_floats((0..3_u8).map(f32::from).flat_map(|m| [m / 1e3, 5.0, m]), &mut values);
        let driven = Trajectory {
            task: "road".to_owned(),
            source: Source::Demonstration as i32,
            steps: 2,
            observation_shape: vec![3],
            values: values.into(),
            success: true,
            steps_to_goal: 2,
            ..Trajectory::default()
        };
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("given.mcap");
        let metadata = Metadata::new(Kind::Demonstrations, "road", 1).with("setting", "{}");
        let mut writer = FileWriter::create(&file, &metadata, &[Topic::Trajectory]).unwrap();
        writer.trajectory(&Encoded::encode(driven), 0).unwrap();
        writer.seal().unwrap();
        let said = remark(&file, &task).unwrap().unwrap();
        assert!(said.starts_with("these numbers") && said.contains("unscaled: km; "), "{said}");
    }
}
