//! The updates in a run's log, as rows of numbers.

use mcap_log::{Contents, read_contents};
use run::folder::RunFolder;
use run::updates::{Update, updates};
use serde::Serialize;

/// The names of a row's numbers.
const COLUMNS: [&str; 22] = [
    "iteration",
    "environment_steps",
    "episodes",
    "wall_s",
    "success_rate",
    "mean_reward",
    "mean_proximity",
    "mean_uncertainty",
    "mean_episode_steps",
    "entropy",
    "approximate_kl",
    "clip_fraction",
    "policy_loss",
    "held_out_loss",
    "value_loss",
    "gradient_norm",
    "learning_rate",
    "demonstration_loss",
    "agent_loss",
    "rollout_s",
    "scoring_s",
    "update_s",
];

/// A number for each of [`COLUMNS`]. A missing one is NaN, which becomes `null` in JSON.
type Row = [f64; COLUMNS.len()];

/// The curves of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Curves {
    rows: Vec<Row>,
    /// Errors in reading the log, a line each.
    pub(crate) trouble: Vec<String>,
}

/// Rows from a given one on, as a browser gets them.
#[derive(Debug, Serialize)]
pub(crate) struct Rows<'a> {
    columns: [&'static str; COLUMNS.len()],
    rows: &'a [Row],
    next: usize,
}

impl Curves {
    /// Reads the curves of a run. Rows after a damaged record may be missing.
    pub(crate) fn of(folder: &RunFolder) -> Curves {
        let mut curves = Curves::default();
        // A run that has only begun has no log yet, which is not an error.
        if !folder.log().exists() {
            return curves;
        }
        let mut reader = match read_contents(&folder.log(), Contents::Updates) {
            Ok(reader) => reader,
            Err(error) => {
                curves.trouble.push(error.to_string());
                return curves;
            }
        };
        for update in updates(reader.by_ref()) {
            match update {
                Ok(update) => curves.rows.push(row(update)),
                Err(error) => curves.trouble.push(error.to_string()),
            }
        }
        let lost = reader.endings().iter().filter(|(_, ending)| ending.lost());
        curves.trouble.extend(lost.map(|(path, ending)| format!("{}: {ending}", path.display())));
        curves
    }

    /// Returns the rows from index `from` on.
    pub(crate) fn from(&self, from: usize) -> Rows<'_> {
        let rows = self.rows.get(from..).unwrap_or_default();
        Rows { columns: COLUMNS, rows, next: self.rows.len() }
    }
}

fn row(Update { policy: update, reward }: Update) -> Row {
    // 0 means that no demonstrations are held out.
    let held_out_loss = Some(update.held_out_loss).filter(|&loss| loss != 0.0);
    let losses = reward.map_or([f64::NAN; 2], |loss| [loss.demonstration_loss, loss.agent_loss]);
    [
        update.iteration as f64,
        update.environment_steps as f64,
        update.episodes as f64,
        update.wall_s,
        update.success_rate,
        update.mean_reward,
        update.mean_proximity,
        update.mean_uncertainty,
        update.mean_episode_steps,
        update.entropy,
        update.approximate_kl,
        update.clip_fraction,
        update.policy_loss,
        held_out_loss.unwrap_or(f64::NAN),
        update.value_loss,
        update.gradient_norm,
        update.learning_rate,
        losses[0],
        losses[1],
        update.rollout_s,
        update.scoring_s,
        update.update_s,
    ]
}

#[cfg(test)]
mod tests {
    use protocol::messages::PolicyUpdate;

    use super::*;

    #[test]
    fn a_learner_that_holds_nothing_out_has_no_loss_on_it() {
        let place = COLUMNS.iter().position(|&column| column == "held_out_loss").unwrap();
        let held_out = |held_out_loss| {
            let policy = PolicyUpdate { held_out_loss, ..PolicyUpdate::default() };
            row(Update { policy, reward: None })[place]
        };
        assert_eq!(held_out(0.25), 0.25);
        assert!(held_out(0.0).is_nan());
    }
}
