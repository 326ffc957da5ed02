//! Mean and variance: running, of the policy's observations (Table 2) and of returns (the authors' code); or fixed,
//! of demonstrations.
//!
//! Batches are merged by Chan's parallel update in double precision, in the given order.

use protocol::policy::LEAST_SCALED_DEVIATION;
use protocol::task::floats;

/// Added to a variance before its root is taken.
const EPSILON: f64 = 1e-8;

/// Mean and variance of a stream of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunningMoments {
    /// Mean of the numbers so far.
    pub mean: f64,
    /// Population variance of the numbers so far.
    pub variance: f64,
    /// Number of numbers so far, plus a small initial weight.
    pub count: f64,
}

impl Default for RunningMoments {
    fn default() -> Self {
        Self { mean: 0.0, variance: 1.0, count: 1e-4 }
    }
}

impl RunningMoments {
    /// Updates the moments with a batch.
    pub fn update(&mut self, batch: impl ExactSizeIterator<Item = f64> + Clone) {
        if batch.len() == 0 {
            return;
        }
        let count = batch.len() as f64;
        let mean = batch.clone().sum::<f64>() / count;
        let squares = batch.map(|number| (number - mean) * (number - mean)).sum::<f64>();
        self.merge(count, mean, squares);
    }

    /// Merges `count` numbers with the given mean and sum of squared distances from it.
    pub fn merge(&mut self, count: f64, mean: f64, squares: f64) {
        let (distance, total) = (mean - self.mean, self.count + count);
        let between = distance * distance * self.count * count / total;
        self.variance = (self.variance * self.count + squares + between) / total;
        self.mean += distance * count / total;
        self.count = total;
    }

    /// Computes the standard deviation, which returns are divided by; it is never zero.
    pub fn standard_deviation(&self) -> f64 {
        (self.variance + EPSILON).sqrt()
    }
}

/// Normalizes vector observations number by number.
#[derive(Clone, Debug, PartialEq)]
pub struct RunningNormalizer {
    /// Moments of each number of the observation.
    pub moments: Vec<RunningMoments>,
}

impl RunningNormalizer {
    /// Normalized observations are clipped to this many standard deviations.
    pub const CLIP: f64 = 10.0;

    /// Creates a normalizer for observations of `len` numbers that has seen no data.
    pub fn new(len: usize) -> Self {
        Self { moments: vec![RunningMoments::default(); len] }
    }

    /// Creates a normalizer from the moments of observations of `len` numbers in demonstrations. A number that
    /// hardly varies there is not scaled: otherwise the first different value would outweigh all other numbers. If
    /// such a number would be clipped, it is centered, so that differences remain visible.
    pub fn of_demonstrations<'a>(
        len: usize,
        observations: impl IntoIterator<Item = &'a [u8]>,
    ) -> Self {
        let observations = observations.into_iter().collect::<Vec<_>>().concat();
        let mut normalizer = Self::new(len);
        normalizer.update(&observations);
        // With the initial weight, a number that is constant far from 0 would seem to vary.
        let alone = RunningMoments { count: 0.0, ..RunningMoments::default() };
        let mut own = Self { moments: vec![alone; len] };
        own.update(&observations);
        for (moments, own) in normalizer.moments.iter_mut().zip(own.moments) {
            if own.standard_deviation() < LEAST_SCALED_DEVIATION {
                let mean = if own.mean.abs() < Self::CLIP { 0.0 } else { own.mean };
                *moments = RunningMoments { mean, ..RunningMoments::default() };
            }
        }
        normalizer
    }

    /// Returns the mean, variance and count of each number, one after another: the complete state.
    pub fn to_numbers(&self) -> Vec<f64> {
        let numbers = |moments: &RunningMoments| [moments.mean, moments.variance, moments.count];
        self.moments.iter().flat_map(numbers).collect()
    }

    /// Restores a normalizer from the result of [`RunningNormalizer::to_numbers`].
    pub fn from_numbers(numbers: &[f64]) -> Self {
        let moments = |three: &[f64; 3]| {
            let [mean, variance, count] = *three;
            RunningMoments { mean, variance, count }
        };
        Self { moments: numbers.as_chunks().0.iter().map(moments).collect() }
    }

    /// Updates the moments with observations, given as bytes one after another.
    ///
    /// # Panics
    /// If the bytes are not whole observations.
    pub fn update(&mut self, observations: &[u8]) {
        let len = self.moments.len();
        if len == 0 {
            return;
        }
        assert_eq!(observations.len() % (4 * len), 0, "observations have {len} numbers");
        let rows = observations.len() / (4 * len);
        for (index, moments) in self.moments.iter_mut().enumerate() {
            let number = |row: usize| {
                let at = 4 * (row * len + index);
                floats(&observations[at..at + 4]).map(f64::from).sum()
            };
            moments.update((0..rows).map(number));
        }
    }

    /// Normalizes observations in place, given as bytes one after another. A normalizer for zero numbers leaves
    /// them unchanged.
    ///
    /// # Panics
    /// If the bytes are not whole observations.
    pub fn normalize(&self, observations: &mut [u8]) {
        let len = self.moments.len();
        if len == 0 {
            return;
        }
        assert_eq!(observations.len() % (4 * len), 0, "observations have {len} numbers");
        let scales: Vec<_> = self
            .moments
            .iter()
            .map(|moments| (moments.mean, moments.standard_deviation()))
            .collect();
        for row in observations.chunks_exact_mut(4 * len) {
            for (number, (mean, deviation)) in row.as_chunks_mut::<4>().0.iter_mut().zip(&scales) {
                let distance = f64::from(f32::from_le_bytes(*number)) - mean;
                let normalized = (distance / deviation).clamp(-Self::CLIP, Self::CLIP);
                *number = (normalized as f32).to_le_bytes();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_batches_are_those_of_the_whole() {
        let numbers: Vec<f64> = (0..1000).map(|index| f64::from(index * 37 % 101) / 7.0).collect();
        let mut moments = RunningMoments::default();
        for batch in numbers.chunks(33) {
            moments.update(batch.iter().copied());
        }
        let mean = numbers.iter().sum::<f64>() / 1000.0;
        let variance = numbers.iter().map(|number| (number - mean).powi(2)).sum::<f64>() / 1000.0;
        assert!((moments.mean - mean).abs() < 1e-5);
        assert!((moments.variance - variance).abs() < 1e-4);
        assert_eq!(moments.count, 1000.0 + 1e-4);
    }

    #[test]
    fn observations_are_centered_scaled_and_clipped() {
        let bytes = |numbers: &[f32]| -> Vec<u8> {
            numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
        };
        let mut normalizer = RunningNormalizer::new(2);
        normalizer.update(&bytes(&[1.0, 5.0, 3.0, 5.0]));
        let mut normalized = bytes(&[3.0, 5.0, 1e9, -1e9]);
        normalizer.normalize(&mut normalized);
        let numbers: Vec<f32> = floats(&normalized).collect();
        assert!((numbers[0] - 1.0).abs() < 1e-3 && numbers[1].abs() < 0.1);
        assert_eq!(numbers[2..], [10.0, -10.0]);
        assert_eq!(RunningNormalizer::from_numbers(&normalizer.to_numbers()), normalizer);
    }

    #[test]
    fn numbers_that_hardly_vary_are_left_alone_or_centered() {
        let bytes = |numbers: [f32; 4]| numbers.map(f32::to_le_bytes).concat();
        let shown = [bytes([1.0, 5.0, 20.0, 100.0]), bytes([3.0, 5.002, 20.0, 100.0])].concat();
        let normalizer = RunningNormalizer::of_demonstrations(4, [&shown.repeat(500)[..]]);
        let mut normalized = bytes([3.0, 7.0, 20.5, 99.0]);
        normalizer.normalize(&mut normalized);
        let numbers: Vec<f32> = floats(&normalized).collect();
        for (number, expected) in numbers.iter().zip([1.0, 7.0, 0.5, -1.0]) {
            assert!((number - expected).abs() < 1e-3, "{numbers:?}");
        }
    }

    /// Returns the largest number as networks see it, of numbers in demonstrations with this standard deviation.
    fn seen(deviation: f64) -> f32 {
        let shown = [deviation, -deviation].map(|number| (number as f32).to_le_bytes());
        let normalizer = RunningNormalizer::of_demonstrations(1, [&shown.concat().repeat(500)[..]]);
        let mut largest = shown[0];
        normalizer.normalize(&mut largest);
        floats(&largest).sum()
    }

    #[test]
    fn numbers_are_scaled_from_the_deviation_on_that_users_are_told() {
        let [below, above] = [0.95, 1.05].map(|share| seen(share * LEAST_SCALED_DEVIATION));
        assert!(below < 0.02 && above > 0.9, "{below}, {above}");
    }
}
