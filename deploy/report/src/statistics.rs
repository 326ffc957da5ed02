//! Statistics over a few seeds: means with intervals, and whether two methods are told apart.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Minimum number of seeds for an interval. The interval of two is over twelve times as wide as their distance.
pub(crate) const FEWEST: usize = 3;

/// Quantile at the upper end of a 95 % interval.
const UPPER: f64 = 0.975;

/// A mean over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Estimate {
    /// The mean.
    pub(crate) mean: f64,
    /// The ends of its 95 % interval, by Student's t distribution; `None` for fewer than three seeds.
    pub(crate) interval: Option<[f64; 2]>,
}

impl Estimate {
    /// Estimates the mean from a value for each seed; returns `None` without values.
    pub(crate) fn of(values: &[f64]) -> Option<Estimate> {
        let Moments { mean, squared_error } = Moments::of(values)?;
        let interval = (values.len() >= FEWEST).then(|| {
            let half = quantile(values.len() as f64 - 1.0) * squared_error.sqrt();
            [mean - half, mean + half]
        });
        Some(Estimate { mean, interval })
    }

    /// Returns the interval clamped to [0, 1], for a mean of shares.
    pub(crate) fn share(&self) -> Option<[f64; 2]> {
        Some(self.interval?.map(|end| end.clamp(0.0, 1.0)))
    }
}

/// How a method compares with another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Standing {
    /// Its mean is higher, and the interval of the difference excludes 0.
    Ahead,
    /// Its mean is lower, and the interval of the difference excludes 0.
    Behind,
    /// The interval of the difference contains 0, but every seed is above every seed of the other.
    EverySeedAbove,
    /// The interval of the difference contains 0, but every seed is below every seed of the other.
    EverySeedBelow,
    /// The interval of the difference contains 0.
    NotToldApart,
}

impl Standing {
    /// Compares a method with another by Welch's 95 % interval of the difference of their means; returns `None` if
    /// either has fewer than three seeds.
    pub(crate) fn of(own: &[f64], other: &[f64]) -> Option<Standing> {
        if own.len().min(other.len()) < FEWEST {
            return None;
        }
        let [(one, own_freedom), (two, other_freedom)] =
            [own, other].map(|values| (Moments::of(values), values.len() as f64 - 1.0));
        let [one, two] = [one?, two?];
        let squared = one.squared_error + two.squared_error;
        let summed =
            one.squared_error.powi(2) / own_freedom + two.squared_error.powi(2) / other_freedom;
        let freedom = squared.powi(2) / summed;
        // If all seeds of both methods agree, the variance is 0 and the degrees of freedom are undefined.
        let half = if squared > 0.0 { quantile(freedom) * squared.sqrt() } else { 0.0 };
        let difference = one.mean - two.mean;
        // Seeds that fail widen the interval, however clear the order is.
        Some(match Standing::by([difference - half, difference + half], 0.0) {
            Standing::NotToldApart if is_above(own, other) => Standing::EverySeedAbove,
            Standing::NotToldApart if is_above(other, own) => Standing::EverySeedBelow,
            decided => decided,
        })
    }

    /// Compares by an interval and the value at which neither method is better.
    pub(crate) fn by([low, high]: [f64; 2], even: f64) -> Standing {
        match (low > even, high < even) {
            (true, _) => Standing::Ahead,
            (_, true) => Standing::Behind,
            _ => Standing::NotToldApart,
        }
    }

    /// Returns the wording in a report.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Standing::Ahead => "ahead",
            Standing::Behind => "behind",
            Standing::EverySeedAbove => "every seed above",
            Standing::EverySeedBelow => "every seed below",
            Standing::NotToldApart => "not told apart",
        }
    }
}

/// Returns whether every value is above every other one.
fn is_above(values: &[f64], others: &[f64]) -> bool {
    values.iter().all(|value| others.iter().all(|other| value > other))
}

/// A mean and the square of its standard error, which is NaN for a single value.
struct Moments {
    mean: f64,
    squared_error: f64,
}

impl Moments {
    fn of(values: &[f64]) -> Option<Moments> {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let squared_error = squares / (count - 1.0) / count;
        (!values.is_empty()).then_some(Moments { mean, squared_error })
    }
}

/// Returns the half-width of a 95 % interval in standard errors.
fn quantile(freedom: f64) -> f64 {
    let student = StudentsT::new(0.0, 1.0, freedom).expect("there are degrees of freedom");
    student.inverse_cdf(UPPER)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// scipy 1.17: `t.interval(0.95, 4, mean, sem)`.
    #[test]
    fn intervals_are_those_of_student() {
        let found = Estimate::of(&[0.965, 0.985, 0.985, 0.995, 0.985]).unwrap();
        let [low, high] = found.interval.unwrap();
        assert!((found.mean - 0.983).abs() < 1e-12, "{found:?}");
        assert!((low - 0.969_398).abs() < 1e-6 && (high - 0.996_602).abs() < 1e-6, "{found:?}");
        assert_eq!(Estimate::of(&[0.5, 0.75]), Some(Estimate { mean: 0.625, interval: None }));
        assert_eq!(Estimate::of(&[]), None);
        let wide = Estimate::of(&[0.0, 0.5, 1.0]).unwrap();
        assert_eq!(wide.share(), Some([0.0, 1.0]));
    }

    /// scipy 1.17: `ttest_ind(a, b, equal_var=False).confidence_interval()` is (-0.007, 0.187) for
    /// the first pair, and with 0.85 instead of 0.9 and 0.95 (0.040, 0.200) for the second.
    #[test]
    fn words_follow_the_interval_of_the_difference() {
        let ours = [0.95, 0.95, 0.92, 0.93, 0.95];
        let standing = |other: &[f64]| Standing::of(&ours, other);
        assert_eq!(standing(&[0.85, 0.90, 0.75, 0.95, 0.80]), Some(Standing::NotToldApart));
        assert_eq!(standing(&[0.85, 0.85, 0.75, 0.85, 0.80]), Some(Standing::Ahead));
        assert_eq!(standing(&[0.99, 0.99, 0.98]), Some(Standing::Behind));
        assert_eq!(standing(&[0.0, 0.1, 0.79]), Some(Standing::EverySeedAbove));
        assert_eq!(Standing::of(&[0.0, 0.1, 0.79], &ours), Some(Standing::EverySeedBelow));
        assert_eq!(standing(&[0.1, 0.1]), None, "two seeds say nothing");
        assert_eq!(Standing::of(&[0.0; 3], &[0.0; 3]), Some(Standing::NotToldApart));
    }
}
