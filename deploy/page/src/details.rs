//! The details of a run: its configuration, settings that are not the default, its summary.

use anyhow::Result;
use protocol::setting;
use run::folder::RunFolder;
use run::overview::{self, State};
use run::repeat::{self, Difference};
use run::summary::Summary;
use serde::Serialize;

use crate::collections;
use crate::curves::Curves;
use crate::listed::Listed;
use crate::published::Success;
use crate::{published, seeds};

/// A run as its view shows it.
#[derive(Debug, Serialize)]
pub(crate) struct Details {
    run: Listed,
    /// Names of the curve that it is a seed of; runs with a name in common are seeds of the same curve.
    curve: Vec<String>,
    configuration: String,
    /// `None` for a task of the user's own, whose defaults are not known.
    differences: Option<Vec<Difference>>,
    summary: Option<Summary>,
    /// Why its training failed.
    failure: Option<String>,
    /// What the authors published for its method, task and setting.
    published: Option<Success>,
    command: String,
    /// Whether its environment may render pictures: it is a Python environment whose episodes can be re-simulated.
    renders: bool,
    /// Names of its collections of episodes.
    collections: Vec<String>,
    /// Iterations of its checkpoints.
    checkpoints: Vec<u64>,
    trouble: Vec<String>,
}

impl Details {
    /// Collects the details of a run.
    ///
    /// # Errors
    /// When its configuration cannot be read.
    pub(crate) fn of(folder: &RunFolder, run: Listed, curves: &Curves) -> Result<Details> {
        let config = folder.config()?;
        let mut trouble = curves.trouble.clone();
        let summary = Summary::of_finished(folder, |remark| trouble.push(remark.to_owned()));
        let failed = run.overview.state == State::Failed;
        Ok(Details {
            failure: overview::failure(folder).filter(|_| failed),
            run,
            curve: seeds::curve(folder, &config),
            configuration: config.to_text(),
            differences: repeat::is_of_ours(&config).then(|| repeat::differences(&config)),
            published: published::success(&config),
            summary,
            command: repeat::command(folder, &config),
            renders: config.environment.0.contains_key(setting::MAKE) && config.task.deterministic,
            collections: collections::names(folder, &config),
            checkpoints: folder
                .checkpoint_folders()
                .into_iter()
                .map(|(number, _)| number)
                .collect(),
            trouble,
        })
    }
}
