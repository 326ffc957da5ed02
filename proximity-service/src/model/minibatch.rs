//! What a gradient step of a reward model is taken on, and what it lost there.

use std::ops::AddAssign;

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
    /// What is no number among losses and the norm of their gradient.
    pub(super) fn problem(&self, gradient_norm: f64) -> Option<String> {
        let numbers = [
            ("loss on demonstrations", self.demonstrations),
            ("loss on the agent", self.agent),
            ("gradient norm", gradient_norm),
        ];
        let (name, found) = numbers.into_iter().find(|(_, number)| !number.is_finite())?;
        Some(format!("expected a finite {name}, found {found}"))
    }

    /// Divides both terms, to make a mean of a sum; of a sum of none that is zero.
    pub(super) fn divided_by(self, count: usize) -> Losses {
        let count = count.max(1) as f64;
        Losses { demonstrations: self.demonstrations / count, agent: self.agent / count }
    }
}

impl AddAssign for Losses {
    fn add_assign(&mut self, other: Losses) {
        self.demonstrations += other.demonstrations;
        self.agent += other.agent;
    }
}
