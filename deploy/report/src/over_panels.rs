//! Comparison of methods over all panels of a figure, by the metrics of Agarwal et al. (2021): interquartile means and
//! probabilities of improvement, with stratified bootstrap intervals.

use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::measured::MeasuredFigure;
use crate::statistics::{FEWEST, Standing};

/// Number of bootstrap samples.
const SAMPLES: usize = 2000;

/// Share of the samples beyond each end of an interval.
const BEYOND: f64 = 0.025;

/// Share of the scores that an interquartile mean leaves out at each end.
const TRIMMED: f64 = 0.25;

/// Success rates of a method in its evaluations: for each panel, one per seed.
type Scores = Vec<Vec<f64>>;

/// A number with the ends of its 95 % interval.
pub(crate) type Bounded = (f64, [f64; 2]);

/// A method over all panels.
pub(crate) struct OverPanels {
    /// The name of its curves.
    pub(crate) name: String,
    /// Number of evaluated runs.
    pub(crate) runs: usize,
    /// Mean of the middle half of all runs' success rates.
    pub(crate) interquartile_mean: Bounded,
    /// Probability that a run of it is better than one of the first method; `None` for the first method itself.
    pub(crate) improvement: Option<Bounded>,
}

impl OverPanels {
    /// Compares it with the first method; returns `None` for the first method itself.
    pub(crate) fn standing(&self) -> Option<Standing> {
        Some(Standing::by(self.improvement?.1, 0.5))
    }
}

/// Returns the methods for which every panel of a figure has evaluated runs of enough seeds for an interval. The others
/// are compared with the first. Returns no methods if there is only one panel or only one method.
pub(crate) fn over_panels(figure: &MeasuredFigure) -> Vec<OverPanels> {
    let names = figure.panels.iter().flat_map(|panel| &panel.curves).map(|curve| &curve.name);
    let mut found: Vec<(&String, Scores)> = Vec::new();
    for name in names {
        if found.iter().all(|(known, _)| *known != name) {
            found.extend(scores(figure, name).map(|scores| (name, scores)));
        }
    }
    if figure.panels.len() < 2 || found.len() < 2 {
        return Vec::new();
    }
    let first = &found[0].1;
    let row = |(place, (name, scores)): (usize, &(&String, Scores))| OverPanels {
        name: (*name).clone(),
        runs: scores.iter().map(Vec::len).sum(),
        interquartile_mean: bootstrapped([scores], |[own]| interquartile_mean(own)),
        improvement: (place > 0)
            .then(|| bootstrapped([scores, first], |[own, other]| improvement(own, other))),
    };
    found.iter().enumerate().map(row).collect()
}

fn scores(figure: &MeasuredFigure, name: &str) -> Option<Scores> {
    let panels = figure.panels.iter().map(|panel| {
        let curve = panel.curves.iter().find(|curve| curve.name == name)?;
        let rates = curve.evaluations();
        (rates.len() >= FEWEST).then_some(rates)
    });
    panels.collect()
}

/// Returns the mean of all scores without the lowest and the highest quarter.
fn interquartile_mean(scores: &Scores) -> f64 {
    let mut all: Vec<f64> = scores.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    let cut = (TRIMMED * all.len() as f64) as usize;
    let middle = &all[cut..all.len() - cut];
    middle.iter().sum::<f64>() / middle.len() as f64
}

/// Returns the share of pairs of seeds in which the first method is better, ties counting half; the mean over panels.
fn improvement(own: &Scores, other: &Scores) -> f64 {
    let panel = |(own, other): (&Vec<f64>, &Vec<f64>)| {
        let pairs = own.iter().flat_map(|one| other.iter().map(move |two| one.total_cmp(two)));
        let won: f64 = pairs.map(|order| 0.5 + 0.5 * f64::from(order as i8)).sum();
        won / (own.len() * other.len()) as f64
    };
    own.iter().zip(other).map(panel).sum::<f64>() / own.len() as f64
}

/// Returns a statistic with its bootstrap interval, resampling the seeds of each panel.
fn bootstrapped<const N: usize>(
    scores: [&Scores; N],
    statistic: impl Fn([&Scores; N]) -> f64,
) -> Bounded {
    // A fixed seed, so that a report always has the same numbers.
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut drawn: Vec<f64> = (0..SAMPLES)
        .map(|_| {
            let again = scores.map(|scores| resampled(scores, &mut rng));
            statistic(again.each_ref())
        })
        .collect();
    drawn.sort_by(f64::total_cmp);
    let beyond = (BEYOND * SAMPLES as f64) as usize;
    (statistic(scores), [drawn[beyond], drawn[SAMPLES - 1 - beyond]])
}

fn resampled(scores: &Scores, rng: &mut impl Rng) -> Scores {
    let mut again = |own: &Vec<f64>| own.iter().filter_map(|_| own.choose(rng).copied()).collect();
    scores.iter().map(&mut again).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The success rates of five seeds on four tasks.
    fn scores(panels: [[f64; 5]; 4]) -> Scores {
        panels.map(Vec::from).to_vec()
    }

    fn near((value, [low, high]): Bounded, expected: [f64; 3], tolerance: f64) {
        assert!((value - expected[0]).abs() < 1e-9, "{value} against {expected:?}");
        let ends = [low - expected[1], high - expected[2]];
        assert!(ends.iter().all(|off| off.abs() < tolerance), "{low}, {high} against {expected:?}");
    }

    /// rliable 1.2.0: `aggregate_iqm` and `probability_of_improvement` of the same scores, with
    /// `get_interval_estimates`. Its random numbers differ, hence the tolerance.
    #[test]
    fn statistics_are_those_of_rliable() {
        let ours = scores([
            [0.99, 0.985, 0.995, 0.97, 0.985],
            [0.95, 0.95, 0.92, 0.93, 0.95],
            [0.95, 0.94, 0.94, 0.965, 0.965],
            [0.67, 0.70, 0.62, 0.55, 0.71],
        ]);
        let other = scores([
            [0.38, 0.42, 0.33, 0.40, 0.36],
            [0.80, 0.95, 0.84, 0.78, 0.96],
            [0.87, 0.61, 0.95, 0.89, 0.97],
            [0.13, 0.24, 0.15, 0.66, 0.20],
        ]);
        let means = [&ours, &other].map(|own| bootstrapped([own], |[own]| interquartile_mean(own)));
        near(means[0], [0.946, 0.9385, 0.953], 0.002);
        near(means[1], [0.612, 0.542, 0.689], 0.01);
        let better = bootstrapped([&other, &ours], |[own, other]| improvement(own, other));
        near(better, [0.18, 0.05, 0.325], 0.02);
        assert_eq!(Standing::by(better.1, 0.5), Standing::Behind);
    }
}
