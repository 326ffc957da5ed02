//! `goalward replay --with`: the rewards that the episodes of a log would have earned from another reward model.
//! The model processes the recorded batches as in a run, learning from each, or it is the trained model of another
//! run and stays fixed.

use std::collections::HashMap;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use mcap_log::{Batches, Record, read_run};
use protocol::messages::Score;
use protocol::trajectory::{Encoded, Trajectory};
use run::config::{RunConfig, UpdateOrder};
use run::folder::RunFolder;
use serde::Serialize;

use crate::model::{self, RewardModel};
use crate::trained::trained_model;

/// Maximum number of points of a curve.
const POINTS: usize = 60;

/// Two returns of an episode, the undiscounted sums of its rewards, and its outcome.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Returns {
    /// Return from the recorded rewards.
    pub(crate) recorded: f64,
    /// Return from the other reward model.
    pub(crate) other: f64,
    /// Whether the episode reached its goal; `None` if the task does not tell.
    pub(crate) success: Option<bool>,
}

/// Comparison of the returns, as printed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Comparison {
    /// Episodes scored again.
    pub(crate) episodes: u64,
    /// Mean returns: recorded, other.
    pub(crate) all: Option<[f64; 2]>,
    /// Mean returns of episodes that reached the goal.
    pub(crate) reached: Option<[f64; 2]>,
    /// Mean returns of episodes that did not.
    pub(crate) missed: Option<[f64; 2]>,
    /// Correlation of the two returns over all episodes.
    pub(crate) correlation: Option<f64>,
    /// Share of pairs of a successful and a failed episode in which the successful one has the larger return (ties
    /// count as half): recorded, other.
    pub(crate) ordered: Option<[f64; 2]>,
    /// Mean returns over the course of the log, for groups of equally many episodes.
    pub(crate) curve: Vec<Point>,
}

/// Mean returns of consecutive episodes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Point {
    /// Number of episodes up to and including this group.
    pub(crate) episodes: u64,
    /// Mean returns: recorded, other.
    pub(crate) all: Option<[f64; 2]>,
    /// Mean returns of episodes that reached the goal.
    pub(crate) reached: Option<[f64; 2]>,
    /// Mean returns of episodes that did not.
    pub(crate) missed: Option<[f64; 2]>,
}

/// Scores the batches of the run's log at `log` again under `config`, or with the trained model of another run, and
/// writes one line per episode.
///
/// # Errors
/// When the log cannot be read, has no updates, or lacks a score; when the model cannot be made or diverges.
pub(crate) fn rescore(
    folder: &RunFolder,
    log: &Path,
    config: &RunConfig,
    trained: Option<&RunFolder>,
    lines: &mut impl Write,
) -> Result<Comparison> {
    let task = folder.config()?.task;
    let spec = task.spec();
    let mut model = match trained {
        None => model::of_run(folder, config)?,
        Some(other) => trained_model(other, config, &spec)?,
    };
    if trained.is_none() {
        drop(model.pretrain(Duration::MAX)?);
    }
    writeln!(lines, "iteration,lane,episode,steps,success,recorded_return,other_return")?;
    let mut batches = Batches::new(spec);
    let mut scores: HashMap<(u64, u64), Score> = HashMap::new();
    let mut returns = Vec::new();
    for entry in read_run(log)? {
        match entry?.record {
            Record::Trajectory(bytes) => batches.add(bytes)?,
            Record::Score(score) => {
                scores.insert((score.lane, score.episode), score);
            }
            Record::PolicyUpdate(update) => {
                let batch = batches.take(&update)?;
                let again =
                    score(&mut *model, update.iteration, &batch, config, trained.is_some())?;
                for (encoded, again) in batch.iter().zip(&again) {
                    let key = (encoded.key.lane, encoded.key.episode);
                    let recorded = scores.remove(&key).with_context(|| {
                        format!(
                            "iteration {} lane {} episode {}: expected its score in the log, found none",
                            update.iteration, key.0, key.1
                        )
                    })?;
                    let pair = compare(encoded, &recorded, again, task.tells_success)?;
                    write_line(lines, encoded, &pair)?;
                    returns.push(pair);
                }
            }
            _ => {}
        }
    }
    ensure!(!returns.is_empty(), "expected scored episodes in {}, found none", log.display());
    Ok(comparison(&returns))
}

/// Scores and improves as the service would in an iteration; a model that `stays` is not improved.
fn score(
    model: &mut dyn RewardModel,
    iteration: u64,
    batch: &[Encoded],
    config: &RunConfig,
    stays: bool,
) -> Result<Vec<Score>> {
    let first = config.reward.order == UpdateOrder::ImproveFirst;
    if first && !stays {
        model.improve(iteration, batch)?;
    }
    let scores = model.score(iteration, batch);
    if !first && !stays {
        model.improve(iteration, batch)?;
    }
    Ok(scores)
}

fn compare(
    encoded: &Encoded,
    recorded: &Score,
    again: &Score,
    tells_success: bool,
) -> Result<Returns> {
    let (expected, found) = (recorded.rewards.len(), again.rewards.len());
    let Trajectory { lane, episode, .. } = encoded.trajectory;
    ensure!(
        expected == found,
        "lane {lane} episode {episode}: expected {expected} rewards, found {found}"
    );
    let sum = |score: &Score| score.rewards.iter().map(|reward| f64::from(*reward)).sum();
    let success = tells_success.then_some(encoded.trajectory.success);
    Ok(Returns { recorded: sum(recorded), other: sum(again), success })
}

fn write_line(lines: &mut impl Write, encoded: &Encoded, returns: &Returns) -> Result<()> {
    let Trajectory { iteration, lane, episode, steps, .. } = &encoded.trajectory;
    let Returns { recorded, other, success } = returns;
    let success = success.map_or(String::new(), |success| u8::from(success).to_string());
    writeln!(lines, "{iteration},{lane},{episode},{steps},{success},{recorded:.6},{other:.6}")?;
    Ok(())
}

/// Returns the mean returns of some of the episodes.
fn means(returns: &[Returns], are_some: impl Fn(&Returns) -> bool) -> Option<[f64; 2]> {
    let chosen: Vec<_> = returns.iter().filter(|pair| are_some(pair)).collect();
    let mean = |of: fn(&Returns) -> f64| {
        chosen.iter().map(|pair| of(pair)).sum::<f64>() / chosen.len() as f64
    };
    (!chosen.is_empty()).then(|| [mean(|pair| pair.recorded), mean(|pair| pair.other)])
}

fn comparison(returns: &[Returns]) -> Comparison {
    let share = returns.len().div_ceil(POINTS).max(1);
    let point = |(number, some): (usize, &[Returns])| Point {
        episodes: (number * share + some.len()) as u64,
        all: means(some, |_| true),
        reached: means(some, |pair| pair.success == Some(true)),
        missed: means(some, |pair| pair.success == Some(false)),
    };
    let of_both = [|pair: &Returns| pair.recorded, |pair: &Returns| pair.other];
    let ordered = of_both.map(|of| ordered(returns, of));
    Comparison {
        episodes: returns.len() as u64,
        all: means(returns, |_| true),
        reached: means(returns, |pair| pair.success == Some(true)),
        missed: means(returns, |pair| pair.success == Some(false)),
        correlation: correlation(returns),
        ordered: match ordered {
            [Some(recorded), Some(other)] => Some([recorded, other]),
            _ => None,
        },
        curve: returns.chunks(share).enumerate().map(point).collect(),
    }
}

/// Computes Pearson's correlation; `None` if one side does not vary.
fn correlation(returns: &[Returns]) -> Option<f64> {
    let count = returns.len() as f64;
    let mean = |of: fn(&Returns) -> f64| returns.iter().map(of).sum::<f64>() / count;
    let (recorded, other) = (mean(|pair| pair.recorded), mean(|pair| pair.other));
    let sums = returns.iter().fold([0.0; 3], |[both, own, others], pair| {
        let (x, y) = (pair.recorded - recorded, pair.other - other);
        [both + x * y, own + x * x, others + y * y]
    });
    let [both, own, others] = sums;
    let scale = (own * others).sqrt();
    (scale > 0.0).then(|| both / scale)
}

/// Computes the share of pairs of a successful and a failed episode in which the former has the larger return,
/// counting ties as half; `None` if there is no such pair.
fn ordered(returns: &[Returns], of: impl Fn(&Returns) -> f64) -> Option<f64> {
    let mut sorted: Vec<_> = returns.iter().map(|pair| (of(pair), pair.success)).collect();
    sorted.sort_by(|one, other| one.0.total_cmp(&other.0));
    let (mut succeeded, mut failed, mut pairs) = (0.0, 0.0, 0.0);
    for group in sorted.chunk_by(|one, other| one.0 == other.0) {
        let count = |ending| group.iter().filter(|(_, success)| *success == Some(ending)).count();
        let [reached, missed] = [true, false].map(|ending| count(ending) as f64);
        pairs += reached * (failed + missed / 2.0);
        succeeded += reached;
        failed += missed;
    }
    (succeeded * failed > 0.0).then(|| pairs / (succeeded * failed))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn returns(recorded: f64, other: f64, success: bool) -> Returns {
        Returns { recorded, other, success: Some(success) }
    }

    #[test]
    fn a_comparison_says_which_returns_tell_success() {
        let found = comparison(&[
            returns(1.0, -1.0, true),
            returns(0.5, -0.5, true),
            returns(0.0, 0.0, false),
            returns(0.5, -0.5, false),
        ]);
        assert_eq!(found.episodes, 4);
        assert_eq!((found.reached, found.missed), (Some([0.75, -0.75]), Some([0.25, -0.25])));
        assert!((found.correlation.unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(found.ordered, Some([0.875, 0.125]));
        assert_eq!(found.curve.len(), 4);
        let all = Some([0.5, -0.5]);
        let last = Point { episodes: 4, all, reached: None, missed: all };
        assert_eq!(found.curve[3], last);
    }

    #[test]
    fn what_cannot_be_said_is_left_out() {
        let found = comparison(&[returns(1.0, 2.0, true), returns(1.0, 3.0, true)]);
        assert_eq!((found.missed, found.correlation, found.ordered), (None, None, None));
        let found = comparison(&[Returns { recorded: 1.0, other: 2.0, success: None }]);
        assert_eq!((found.all, found.reached, found.missed), (Some([1.0, 2.0]), None, None));
    }
}
