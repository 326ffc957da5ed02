//! The curves of a run, finished or in progress, for TensorBoard.

use std::fs;
use std::path::Path;
use std::time::UNIX_EPOCH;

use anyhow::{Context, Result};
use mcap_log::{Contents, read_contents};
use protocol::durable;
use run::config::RunConfig;
use run::folder::RunFolder;
use run::summary::Summary;
use run::updates::{Update, begun, updates};

use crate::event_file::EventFile;

/// File beside an event file with the configuration of its run.
const CONFIGURATION: &str = "configuration.toml";

/// The event file of a run.
pub struct TensorBoard {
    run: RunFolder,
    file: EventFile,
    /// When the run was begun, seconds since 1970.
    begun: f64,
    /// The first iteration that is not written yet.
    next: u64,
}

impl TensorBoard {
    /// Creates the event file of a run in `folder`.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn of(run: RunFolder, folder: &Path) -> Result<TensorBoard> {
        let begun = begun(&run).context("when the run was begun")?;
        let begun = begun.duration_since(UNIX_EPOCH)?.as_secs_f64();
        let shown = || folder.display().to_string();
        fs::create_dir_all(folder).with_context(shown)?;
        // Before the event file, whose folder could not be told from that of another run otherwise.
        let configuration = durable::write(&folder.join(CONFIGURATION), run.config()?.to_text());
        configuration.with_context(shown)?;
        let file = EventFile::create(folder, begun).with_context(shown)?;
        Ok(TensorBoard { run, file, begun, next: 0 })
    }

    /// Returns whether the event file in `folder` is of this run, or of one that gives the same curves.
    pub fn is_of(run: &RunFolder, folder: &Path) -> bool {
        let file = folder.join(CONFIGURATION);
        let of_file = fs::read_to_string(&file).ok();
        let of_file = of_file.map(|text| RunConfig::from_text(&text, &file.display().to_string()));
        match (of_file, run.config()) {
            (Some(Ok(of_file)), Ok(config)) => config.same_result_as(&of_file),
            _ => false,
        }
    }

    /// Writes the updates that were added to the log since the last call. An update that is repeated after a process
    /// died has the same values and is not written again.
    ///
    /// # Errors
    /// When the log cannot be read, or the file cannot be written.
    pub fn go_on(&mut self) -> Result<()> {
        if !self.run.log().exists() {
            return Ok(());
        }
        for update in updates(&self.run, read_contents(&self.run.log(), Contents::Updates)?) {
            self.update(&update?)?;
        }
        Ok(self.file.flush()?)
    }

    /// Writes the remaining updates and the evaluation of a finished run.
    ///
    /// # Errors
    /// When the log cannot be read, or the file cannot be written.
    pub fn end(mut self, summary: &Summary) -> Result<()> {
        self.go_on()?;
        let number = |number: Option<f64>| number.unwrap_or(f64::NAN);
        let scalars = [
            ("evaluation/success_rate", number(summary.evaluation.success_rate)),
            ("evaluation/mean_return", number(summary.evaluation.mean_return)),
        ];
        let step = summary.environment_steps.max(summary.iterations);
        self.file.scalars(self.begun + summary.wall_s, step, &scalars)?;
        Ok(self.file.flush()?)
    }

    fn update(&mut self, update: &Update) -> Result<()> {
        let policy = &update.policy;
        if policy.iteration < self.next {
            return Ok(());
        }
        let next = policy.iteration + 1;
        // Behavioral cloning takes no environment steps.
        let step = if policy.environment_steps > 0 { policy.environment_steps } else { next };
        self.file.scalars(self.begun + policy.wall_s, step, &scalars(update))?;
        self.next = next;
        Ok(())
    }
}

fn scalars(Update { policy: update, reward }: &Update) -> Vec<(&'static str, f64)> {
    let mut scalars = vec![
        ("rollout/success_rate", update.success_rate),
        ("rollout/episode_steps", update.mean_episode_steps),
        ("reward/reward", update.mean_reward),
        ("reward/proximity", update.mean_proximity),
        ("reward/uncertainty", update.mean_uncertainty),
        ("policy/loss", update.policy_loss),
        ("policy/value_loss", update.value_loss),
        ("policy/entropy", update.entropy),
        ("policy/approximate_kl", update.approximate_kl),
        ("policy/clip_fraction", update.clip_fraction),
        ("policy/gradient_norm", update.gradient_norm),
        ("policy/learning_rate", update.learning_rate),
        ("policy/held_out_loss", update.held_out_loss),
        ("time/rollout_s", update.rollout_s),
        ("time/scoring_s", update.scoring_s),
        ("time/update_s", update.update_s),
    ];
    scalars.extend(reward.iter().flat_map(|update| {
        [
            ("reward/demonstration_loss", update.demonstration_loss),
            ("reward/agent_loss", update.agent_loss),
        ]
    }));
    scalars
}
