//! What a gradient step of a reward model is taken on, and what it lost there.

use super::input::Rows;
use super::penalty::GradientPenalty;

/// The rows of a minibatch, by their positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MinibatchRows {
    /// Those of demonstrations.
    pub demonstrations: Vec<usize>,
    /// Those of the agent's experience.
    pub agent: Vec<usize>,
}

/// What a gradient step is taken on: rows of demonstrations, then rows of the agent.
pub struct Minibatch {
    /// The rows, normalized.
    pub rows: Rows,
    /// Which ones they are.
    pub drawn: MinibatchRows,
    /// What the discriminator's gradient is penalized by, if it is.
    pub penalty: Option<GradientPenalty>,
}

/// The two terms of a model's loss on a minibatch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// On demonstrations.
    pub demonstrations: f64,
    /// On the agent's experience.
    pub agent: f64,
}

impl Losses {
    /// What is no number among losses and their gradient.
    pub(super) fn problem(&self, gradient: &[f32]) -> Option<String> {
        let losses =
            [("loss on demonstrations", self.demonstrations), ("loss on the agent", self.agent)];
        let lost = losses.into_iter().find(|(_, loss)| !loss.is_finite());
        // Without an early end, so that it is vectorised.
        let is_finite = gradient.iter().fold(true, |all, derivative| all & derivative.is_finite());
        match lost {
            Some((name, loss)) => Some(format!("expected a finite {name}, found {loss}")),
            None if !is_finite => Some("expected a finite gradient, found none".to_owned()),
            None => None,
        }
    }

    /// The mean of each term; zero if there are none.
    pub fn mean(losses: &[Losses]) -> Losses {
        let count = losses.len().max(1) as f64;
        Losses {
            demonstrations: losses.iter().map(|loss| loss.demonstrations).sum::<f64>() / count,
            agent: losses.iter().map(|loss| loss.agent).sum::<f64>() / count,
        }
    }
}
