//! Compares which numbers of demonstrations are scaled with what `goalward` says of them to users.

use networks::RunningNormalizer;
use protocol::task::floats;
use run::config::LEAST_SCALED_DEVIATION;

/// Returns the largest number as networks see it, of numbers in demonstrations with this standard deviation.
fn seen(deviation: f64) -> f32 {
    let shown = [deviation, -deviation].map(|number| (number as f32).to_le_bytes());
    let normalizer = RunningNormalizer::of_demonstrations(1, &shown.concat().repeat(500));
    let mut largest = shown[0];
    normalizer.normalize(&mut largest);
    floats(&largest).sum()
}

#[test]
fn numbers_are_scaled_from_the_deviation_on_that_users_are_told() {
    let [below, above] = [0.95, 1.05].map(|share| seen(share * LEAST_SCALED_DEVIATION));
    assert!(below < 0.02 && above > 0.9, "{below}, {above}");
}
