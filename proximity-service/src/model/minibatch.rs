//! Minibatches of a reward model and their losses.

use std::ops::AddAssign;

use super::input::Rows;
use super::penalty::GradientPenalty;

/// Positions of the rows that a minibatch is made of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Positions {
    /// Positions among the rows of demonstrations.
    pub demonstrations: Vec<usize>,
    /// Positions in the agent's experience.
    pub agent: Vec<usize>,
}

/// Data of a gradient step: rows of demonstrations, then rows of the agent.
pub struct Minibatch {
    /// The normalized rows.
    pub rows: Rows,
    /// Positions of the rows.
    pub positions: Positions,
    /// Gradient penalty of a discriminator, if it has one.
    pub penalty: Option<GradientPenalty>,
}

/// The two terms of a model's loss on a minibatch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Loss on demonstrations.
    pub demonstrations: f64,
    /// Loss on the agent's experience.
    pub agent: f64,
}

impl Losses {
    /// Describes the first of the losses and the gradient norm that is not finite; `None` if all are finite.
    pub(super) fn problem(&self, gradient_norm: f64) -> Option<String> {
        let numbers = [
            ("loss on demonstrations", self.demonstrations),
            ("loss on the agent", self.agent),
            ("gradient norm", gradient_norm),
        ];
        let (name, found) = numbers.into_iter().find(|(_, number)| !number.is_finite())?;
        Some(format!("expected a finite {name}, found {found}"))
    }

    /// Divides both terms by `count`, to turn a sum into a mean. A count of zero leaves the sum as it is.
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
