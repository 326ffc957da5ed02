//! The check every action passes before it touches a state, whether a network chose it or a log
//! holds it.

use crate::EnvironmentError;
use protocol::task::{ActionSpec, Spec, floats};

/// Refuses an action that does not fit the spec: its length in bytes, a discrete action that the
/// task does not have, or a number that is not finite. Finite numbers outside [-1, 1] are fine, the
/// environment clips them.
pub(crate) fn check(spec: &Spec, action: &[u8]) -> Result<(), EnvironmentError> {
    let (task, expected) = (spec.task, spec.action.bytes());
    if action.len() != expected {
        return Err(EnvironmentError::ActionLength { task, expected, found: action.len() });
    }
    match spec.action {
        ActionSpec::Discrete { count } => {
            let found = action[0];
            if usize::from(found) >= count {
                return Err(EnvironmentError::ActionUnknown { task, count, found });
            }
        }
        ActionSpec::Continuous { .. } => {
            if let Some((index, found)) =
                floats(action).enumerate().find(|(_, number)| !number.is_finite())
            {
                return Err(EnvironmentError::ActionNotFinite { task, index, found });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::task::{Task, write_floats};

    fn check_floats(numbers: [f32; 3]) -> Result<(), EnvironmentError> {
        let spec = Spec { action: ActionSpec::Continuous { len: 3 }, ..Task::Navigation.spec() };
        let mut action = [0; 12];
        write_floats(numbers, &mut action);
        check(&spec, &action)
    }

    #[test]
    fn a_discrete_action_must_exist() {
        let spec = Task::Navigation.spec();
        assert_eq!(check(&spec, &[3]), Ok(()));
        assert_eq!(
            check(&spec, &[4]).unwrap_err().to_string(),
            "navigation: expected an action below 4, found action 4"
        );
    }

    #[test]
    fn a_continuous_action_must_be_finite() {
        assert_eq!(check_floats([-7.0, 0.0, 1.0]), Ok(()));
        assert_eq!(
            check_floats([0.0, f32::NAN, 0.0]).unwrap_err().to_string(),
            "navigation: expected finite numbers in the action, found NaN at index 1"
        );
        assert!(check_floats([0.0, 0.0, f32::INFINITY]).is_err());
    }

    #[test]
    fn an_action_must_have_its_length() {
        assert_eq!(
            check(&Task::Navigation.spec(), &[]).unwrap_err().to_string(),
            "navigation: expected an action of 1 bytes, found 0 bytes"
        );
    }
}
