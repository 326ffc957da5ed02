//! The data read from a run: its configuration, its summary, and the points of its curves, which are the policy updates
//! in its log.

use anyhow::{Context, Result};
use protocol::messages::PolicyUpdate;
use run::config::RunConfig;
use run::folder::RunFolder;
use run::summary::Summary;
use run::time_to_success::TimeToSuccess;
use run::updates::policy_updates;

use crate::figure::{Curve, Figure, Panel};
use crate::statistics::Standing;
use terminal::numbers;
use terminal::print::print_remark;
use terminal::refusal::{Refusal, wrong_usage};

/// A figure with the data of its runs.
pub(crate) type MeasuredFigure = Figure<MeasuredCurve>;

/// A panel with the data of its runs.
pub(crate) type MeasuredPanel = Panel<MeasuredCurve>;

/// A curve with the data of its runs.
pub(crate) struct MeasuredCurve {
    /// Its name.
    pub(crate) name: String,
    /// Success rate that the authors published.
    pub(crate) anchor: Option<f64>,
    /// The runs that could be read.
    pub(crate) runs: Vec<Measured>,
    /// A phrase for each run that is unfinished or could not be read.
    pub(crate) missing: Vec<String>,
}

/// The data of a run.
pub(crate) struct Measured {
    /// Its folder.
    pub(crate) folder: RunFolder,
    /// Its configuration.
    pub(crate) config: RunConfig,
    /// Its summary, if it is finished.
    pub(crate) summary: Option<Summary>,
    /// A point for each policy update; at least one.
    pub(crate) points: Vec<Point>,
    /// Steps and times that it took to reach levels of success.
    pub(crate) times_to_success: Vec<TimeToSuccess>,
}

/// A policy update as a point of curves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Point {
    /// The iteration, from 0.
    pub(crate) iteration: u64,
    /// Environment steps so far.
    pub(crate) environment_steps: u64,
    /// Training episodes so far.
    pub(crate) episodes: u64,
    /// Wall time of training without the pauses of a resumed run, seconds.
    pub(crate) wall_s: f64,
    /// Success rate of the last 100 training episodes.
    pub(crate) success_rate: f64,
    /// Mean reward per step.
    pub(crate) mean_reward: f64,
    /// Mean proximity over the batch's observations.
    pub(crate) mean_proximity: f64,
    /// Mean uncertainty over the batch's observations.
    pub(crate) mean_uncertainty: f64,
    /// Entropy of the policy, nats.
    pub(crate) entropy: f64,
    /// Approximate KL divergence from the policy that acted, nats.
    pub(crate) approximate_kl: f64,
}

impl MeasuredCurve {
    /// Reads the runs of a curve. Runs that do not exist, cannot be read or are unfinished are noted in `missing`.
    pub(crate) fn of(curve: &Curve) -> MeasuredCurve {
        let mut measured = MeasuredCurve {
            name: curve.name.clone(),
            anchor: curve.anchor,
            runs: Vec::new(),
            missing: Vec::new(),
        };
        for folder in &curve.runs {
            let name = name(folder);
            if !folder.config_file().exists() {
                measured.missing.push(format!("{name}: not begun"));
                continue;
            }
            match Measured::of(folder.clone()) {
                Ok(run) => {
                    measured.missing.extend(run.lacks().map(|lack| format!("{name}: {lack}")));
                    measured.runs.push(run);
                }
                Err(error) => measured.missing.push(format!("{name}: {error:#}")),
            }
        }
        measured
    }

    /// Returns the success rates of its runs in their evaluations, as far as there are any.
    pub(crate) fn evaluations(&self) -> Vec<f64> {
        let rate = |run: &Measured| run.summary.as_ref()?.evaluation.success_rate;
        self.runs.iter().filter_map(rate).collect()
    }

    /// Compares its evaluations with those of the first curve of its panel; returns `None` for that curve itself, or if
    /// either has too few seeds.
    pub(crate) fn standing(&self, first: &MeasuredCurve) -> Option<Standing> {
        let compared = self.name != first.name;
        compared.then(|| Standing::of(&self.evaluations(), &first.evaluations()))?
    }
}

impl Measured {
    /// Reads a run.
    ///
    /// # Errors
    /// A usage error when the folder has no run, no log, or no policy update yet.
    pub(crate) fn of(folder: RunFolder) -> Result<Measured> {
        let log = folder.log();
        Measured::if_it_learned(folder)?.ok_or_else(|| {
            let message = "expected policy updates in the log, found none yet";
            wrong_usage(format!("{}: {message}", log.display()))
        })
    }

    /// Reads a run; returns `None` if it has no policy update yet.
    ///
    /// # Errors
    /// A usage error when the folder has no run, or its log cannot be read.
    pub(crate) fn if_it_learned(folder: RunFolder) -> Result<Option<Measured>> {
        let config = folder.config()?;
        let summary = Summary::of_finished(&folder, print_remark);
        // The log of a finished run was there.
        if summary.is_none() && folder.log().try_exists().is_ok_and(|exists| !exists) {
            return Ok(None);
        }
        let updates = policy_updates(&folder)
            .map_err(Refusal::usage)
            .with_context(|| folder.path().display().to_string())?;
        let updates = updates.collect::<Result<Vec<_>, _>>()?;
        if updates.is_empty() {
            return Ok(None);
        }
        let points = updates.iter().map(point).collect();
        let times_to_success = TimeToSuccess::of_updates(&updates);
        Ok(Some(Measured { folder, config, summary, points, times_to_success }))
    }

    /// Returns the name of its folder, with its seed.
    pub(crate) fn name(&self) -> String {
        format!("{} (seed {})", name(&self.folder), self.config.seed)
    }

    /// Returns whether it took environment steps; otherwise its success is known only from its evaluation.
    pub(crate) fn acts(&self) -> bool {
        self.points.last().is_some_and(|point| point.environment_steps > 0)
    }

    /// Returns whether it has a summary.
    pub(crate) fn is_finished(&self) -> bool {
        self.summary.is_some()
    }

    /// Returns a phrase on how far an unfinished run is.
    fn lacks(&self) -> Option<String> {
        if self.is_finished() {
            return None;
        }
        let last = self.points.last();
        let (done, all, what) = if self.config.learner.acts() {
            (last.map(|point| point.environment_steps), self.config.steps, "steps")
        } else {
            (last.map(|point| point.iteration + 1), self.config.iterations(), "iterations at most")
        };
        let [done, all] = [done.unwrap_or(0), all].map(numbers::count);
        Some(format!("unfinished, {done} of {all} {what}"))
    }
}

fn name(folder: &RunFolder) -> String {
    let path = folder.path();
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

fn point(update: &PolicyUpdate) -> Point {
    Point {
        iteration: update.iteration,
        environment_steps: update.environment_steps,
        episodes: update.episodes,
        wall_s: update.wall_s,
        success_rate: update.success_rate,
        mean_reward: update.mean_reward,
        mean_proximity: update.mean_proximity,
        mean_uncertainty: update.mean_uncertainty,
        entropy: update.entropy,
        approximate_kl: update.approximate_kl,
    }
}

#[cfg(test)]
mod tests {
    use mcap_log::{FileWriter, Kind, Metadata, Topic};

    use super::*;
    use run::tasks;

    #[test]
    fn a_run_that_has_only_begun_is_refused_alone_and_missing_in_a_figure() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path().join("begun"));
        std::fs::create_dir_all(folder.log()).unwrap();
        let config = tasks::configuration("navigation", None, &[]).unwrap();
        std::fs::write(folder.config_file(), config.to_text()).unwrap();
        let metadata = Metadata::new(Kind::Run, &config.task.name, config.seed);
        let log = folder.log().join("updates-00000.mcap");
        FileWriter::create(&log, &metadata, &[Topic::PolicyUpdate]).unwrap().seal().unwrap();
        let error = Measured::of(folder.clone()).err().unwrap();
        assert!(format!("{error:#}").contains("expected policy updates"), "{error:#}");

        let runs = vec![folder, RunFolder::new(directory.path().join("nowhere"))];
        let curve = MeasuredCurve::of(&Curve { name: "ours".into(), runs, anchor: None });
        assert!(curve.runs.is_empty(), "a run without updates has no curve");
        assert!(curve.missing[0].starts_with("begun: ") && curve.missing.len() == 2);
        assert_eq!(curve.missing[1], "nowhere: not begun");
    }
}
