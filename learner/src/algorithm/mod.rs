//! Policy learners: what turns a batch into better weights.

pub mod ppo;

/// Figures of one update, means over its minibatches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Clipped surrogate loss.
    pub policy_loss: f64,
    /// Clipped value loss.
    pub value_loss: f64,
    /// Entropy of the policy, nats.
    pub entropy: f64,
    /// Mean of `(ratio - 1) - ln ratio`, nats.
    pub approximate_kl: f64,
    /// Share of samples outside the clip range.
    pub clip_fraction: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f64,
}

impl Figures {
    /// Adds another minibatch's or shard's figures.
    pub fn add(&mut self, other: &Figures) {
        self.policy_loss += other.policy_loss;
        self.value_loss += other.value_loss;
        self.entropy += other.entropy;
        self.approximate_kl += other.approximate_kl;
        self.clip_fraction += other.clip_fraction;
        self.gradient_norm += other.gradient_norm;
    }

    /// Divides every figure, to make a mean of a sum.
    pub fn divided_by(&self, count: f64) -> Figures {
        Figures {
            policy_loss: self.policy_loss / count,
            value_loss: self.value_loss / count,
            entropy: self.entropy / count,
            approximate_kl: self.approximate_kl / count,
            clip_fraction: self.clip_fraction / count,
            gradient_norm: self.gradient_norm / count,
        }
    }
}
