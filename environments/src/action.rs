//! The check that every action passes before it acts, whether a network chose it or a log holds it, and the scale that
//! is applied to continuous actions.

use crate::EnvironmentError;
use protocol::error::within;
use protocol::setting::ACTION_SCALE;
use protocol::task::{ActionSpec, Spec, floats};

/// Refuses an action that does not fit the spec, and every action while no episode is running.
///
/// # Errors
/// The errors that [`Environment::step`](crate::Environment::step) documents for refused actions.
pub fn check_action(spec: &Spec, running: bool, action: &[u8]) -> Result<(), EnvironmentError> {
    check(spec, action)?;
    if running { Ok(()) } else { Err(EnvironmentError::NotRunning) }
}

/// Refuses an action that does not fit the spec: a wrong length in bytes, a discrete action that the task does not
/// have, or a number that is not finite. Finite numbers outside [-1, 1] are accepted; the environment clips them.
fn check(spec: &Spec, action: &[u8]) -> Result<(), EnvironmentError> {
    let (expected, found) = (spec.action.bytes(), action.len());
    if found != expected {
        return Err(EnvironmentError::ActionLength { expected, found });
    }
    match spec.action {
        ActionSpec::Discrete { count } => {
            let found = action[0];
            if usize::from(found) >= count {
                return Err(EnvironmentError::ActionUnknown { count, found });
            }
        }
        ActionSpec::Continuous { .. } => {
            if let Some((index, found)) =
                floats(action).enumerate().find(|(_, number)| !number.is_finite())
            {
                return Err(EnvironmentError::ActionNotFinite { index, found });
            }
        }
    }
    Ok(())
}

/// The factors that multiply the numbers of a continuous action before it acts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActionScale {
    /// One factor for each number, or empty for a scale of one.
    factors: Vec<f32>,
}

impl ActionScale {
    /// Makes the scale for actions of `len` numbers from the factors in a setting.
    ///
    /// # Errors
    /// When `factors` is neither empty nor of length `len`, or when a factor is not above 0 or, in 32 bits, not
    /// finite.
    pub fn new(factors: &[f64], len: usize) -> Result<ActionScale, protocol::Error> {
        let found = factors.len();
        let expected = format!("empty or {len} numbers, as the action has");
        within(ACTION_SCALE, found == 0 || found == len, &expected, format!("{found} numbers"))?;
        let holds = |factor: f32| factor.is_finite() && factor > 0.0;
        for &number in factors {
            let expected = "of numbers above 0 and finite in 32 bits";
            within(ACTION_SCALE, holds(number as f32), expected, number)?;
        }
        Ok(ActionScale { factors: factors.iter().map(|&number| number as f32).collect() })
    }

    /// Returns the numbers of a checked action as they act: scaled, then clipped to [-1, 1].
    pub fn scaled<'a>(&'a self, action: &'a [u8]) -> impl Iterator<Item = f32> + 'a {
        let numbers = floats(action).enumerate();
        numbers.map(|(index, number)| (number * self.factor(index)).clamp(-1.0, 1.0))
    }

    /// Returns the action that [`ActionScale::scaled`] maps to these numbers, up to the rounding of the last bit.
    pub fn unscaled(&self, numbers: impl Iterator<Item = f32>) -> impl Iterator<Item = f32> {
        numbers.enumerate().map(|(index, number)| number / self.factor(index))
    }

    /// Returns the first `LEN` numbers of [`ActionScale::scaled`], padded with zeros.
    pub(crate) fn clipped<const LEN: usize>(&self, action: &[u8]) -> [f32; LEN] {
        let mut numbers = [0.0; LEN];
        numbers.iter_mut().zip(self.scaled(action)).for_each(|(number, scaled)| *number = scaled);
        numbers
    }

    fn factor(&self, index: usize) -> f32 {
        self.factors.get(index).copied().unwrap_or(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fetch::FetchTask;
    use crate::navigation;
    use protocol::task::write_floats;

    fn bytes(numbers: [f32; 3]) -> [u8; 12] {
        let mut action = [0; 12];
        write_floats(numbers, &mut action);
        action
    }

    fn scale(factors: &[f64]) -> ActionScale {
        ActionScale::new(factors, 3).expect("a scale of three numbers")
    }

    #[test]
    fn a_scale_fits_the_action() {
        let refusal = |factors: &[f64]| ActionScale::new(factors, 3).unwrap_err().to_string();
        assert!(refusal(&[0.1]).contains("`action_scale` must be empty or 3 numbers"));
        for number in [0.0, 1e-50, -1.0, 1e39, f64::NAN, f64::INFINITY] {
            assert!(refusal(&[0.1, number, 0.2]).contains("above 0"), "{number}");
        }
    }

    #[test]
    fn an_action_is_scaled_before_it_is_clipped() {
        assert_eq!(scale(&[]).clipped(&bytes([0.5, -3.0, 1.5])), [0.5, -1.0, 1.0]);
        assert_eq!(scale(&[0.1, 0.25, 4.0]).clipped(&bytes([5.0, -2.0, 0.5])), [0.5, -0.5, 1.0]);
    }

    #[test]
    fn the_inverse_of_a_scale_undoes_it() {
        let unscaled = |scale: &ActionScale, numbers: [f32; 3]| {
            scale.unscaled(numbers.into_iter()).collect::<Vec<_>>()
        };
        assert_eq!(unscaled(&scale(&[]), [0.5, -3.0, 1.5]), [0.5, -3.0, 1.5]);
        let scale = scale(&[0.5, 0.25, 4.0]);
        assert_eq!(unscaled(&scale, [0.5, -1.0, 1.0]), [1.0, -4.0, 0.25]);
        assert_eq!(scale.clipped(&bytes([1.0, -4.0, 0.25])), [0.5, -1.0, 1.0]);
    }

    fn check_floats(numbers: [f32; 3]) -> Result<(), EnvironmentError> {
        check(&FetchTask::Push.spec(), &bytes(numbers))
    }

    #[test]
    fn a_discrete_action_must_exist() {
        let spec = navigation::SPEC;
        assert_eq!(check(&spec, &[3]), Ok(()));
        assert_eq!(
            check(&spec, &[4]).unwrap_err().to_string(),
            "expected an action below 4, found action 4"
        );
    }

    #[test]
    fn a_continuous_action_must_be_finite() {
        assert_eq!(check_floats([-7.0, 0.0, 1.0]), Ok(()));
        assert_eq!(
            check_floats([0.0, f32::NAN, 0.0]).unwrap_err().to_string(),
            "expected finite numbers in the action, found NaN at index 1"
        );
        assert!(check_floats([0.0, 0.0, f32::INFINITY]).is_err());
    }

    #[test]
    fn an_action_must_have_its_length() {
        assert_eq!(
            check(&navigation::SPEC, &[]).unwrap_err().to_string(),
            "expected an action of 1 bytes, found 0 bytes"
        );
    }
}
