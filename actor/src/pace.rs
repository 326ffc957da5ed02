//! How long an environment takes per step, and how many lanes are worth stepping at once as a result.

/// Maximum number of lanes that are stepped at once.
pub(crate) const LANES_AT_ONCE: usize = 16;

/// Target duration of a turn of all lanes, in seconds. A turn's cost besides its steps (inference, or a message
/// to another process) is a few hundredths of that. More lanes would save less than they cost other actors,
/// which are idle at the end of a rollout while one actor holds leases that it has no time for.
const TURN: f64 = 3e-3;

/// Weight of the newest turn in the moving average.
const NEWEST: f64 = 0.1;

/// The pace of an actor's environment.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    /// Seconds per step; `None` before the first step.
    step: Option<f64>,
}

impl Pace {
    /// Takes in a turn of `steps` steps that took `seconds`.
    pub(crate) fn note(&mut self, seconds: f64, steps: usize) {
        let newest = seconds / steps.max(1) as f64;
        self.step = Some(self.step.map_or(newest, |step| step + NEWEST * (newest - step)));
    }

    /// Returns the number of lanes to step at once.
    pub(crate) fn at_once(&self) -> usize {
        let fitting = self.step.map(|step| (TURN / step).ceil());
        fitting.map_or(LANES_AT_ONCE, |lanes| (lanes as usize).clamp(1, LANES_AT_ONCE))
    }

    /// Returns the number of lanes to hold: one more, so that the next lease is there before another ends.
    pub(crate) fn held(&self) -> usize {
        (self.at_once() + 1).min(LANES_AT_ONCE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slower_an_environment_the_fewer_lanes() {
        let mut pace = Pace::default();
        assert_eq!((pace.at_once(), pace.held()), (16, 16), "nothing is known yet");
        pace.note(0.16, 16);
        assert_eq!((pace.at_once(), pace.held()), (1, 2), "ten milliseconds a step");
        let settled = |pace: &mut Pace, step: f64| {
            (0..100).for_each(|_| pace.note(step, 1));
            (pace.at_once(), pace.held())
        };
        assert_eq!(settled(&mut pace, 0.0011), (3, 4), "a millisecond");
        assert_eq!(settled(&mut pace, 0.0001), (16, 16), "a tenth of it");
        pace.note(0.0003, 1);
        assert_eq!((pace.at_once(), pace.held()), (16, 16), "one slow step is no slow environment");
        assert_eq!(settled(&mut pace, 0.0), (16, 16), "none at all");
    }
}
