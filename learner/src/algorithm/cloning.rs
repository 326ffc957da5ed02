//! Maximum likelihood: a network's action distribution is fitted to actions that were taken. Behavioral cloning fits
//! the policy to the expert's actions; inverse dynamics fits the action between two observations to the agent's own.

use networks::{ActorCritic, Distribution, WindowIndex};
use protocol::tensors::Tensors;
use run::process::Final;

use crate::algorithm::Metrics;
use crate::algorithm::policy_trainer::{PolicyTrainer, RowLoss, RowOutput};

/// Training pairs: rows of observations, as the network sees them, and the action of each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pairs {
    /// Observations, each row of the same length.
    pub(crate) observations: Vec<u8>,
    /// Actions, each of the same length.
    pub(crate) actions: Vec<u8>,
}

/// Settings of the training.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    /// Rows of a minibatch.
    pub(crate) batch: usize,
    /// Adam's epsilon.
    pub(crate) adam_epsilon: f64,
    /// Largest norm of a gradient.
    pub(crate) max_gradient_norm: f64,
    /// Whether standard deviations are fitted, too.
    pub(crate) deviations: bool,
}

/// A network in training.
pub(crate) struct Cloning {
    trainer: PolicyTrainer,
    settings: Settings,
    action_bytes: usize,
}

impl Cloning {
    /// Creates the training of a network whose actions have `action_bytes` bytes each.
    pub(crate) fn new(network: ActorCritic, action_bytes: usize, settings: Settings) -> Cloning {
        let Settings { adam_epsilon, max_gradient_norm, .. } = settings;
        let trainer = PolicyTrainer::new(network, adam_epsilon, max_gradient_norm);
        Cloning { trainer, settings, action_bytes }
    }

    /// Trains on the pairs that `rows` names, in that order.
    ///
    /// # Errors
    /// [`Final`] at the first minibatch with a loss or gradient that is NaN or infinite.
    pub(crate) fn train(
        &mut self,
        parameters: &mut [f32],
        pairs: &Pairs,
        rows: &[u32],
        learning_rate: f64,
    ) -> Result<Metrics, Final> {
        let mut metrics = Metrics::default();
        let minibatches = rows.chunks(self.settings.batch);
        let count = minibatches.len();
        let mut windows = WindowIndex::default();
        let observations = self.trainer.index(&pairs.observations, &mut windows);
        for (number, minibatch) in minibatches.enumerate() {
            let loss = NegativeLogLikelihood {
                distribution: self.trainer.network().distribution(),
                actions: &pairs.actions,
                action_bytes: self.action_bytes,
                deviations: self.settings.deviations,
                weight: 1.0 / minibatch.len() as f32,
            };
            let own = self.trainer.step(parameters, observations, minibatch, &loss, learning_rate);
            own.expect_finite(format_args!("cloning, minibatch {} of {count}", number + 1))?;
            metrics += own;
        }
        Ok(metrics.divided_by(count.max(1) as f64))
    }

    /// Returns the mean negative log-likelihood of the actions of all pairs, in nats; `None` if there are no pairs.
    pub(crate) fn loss(&mut self, parameters: &[f32], pairs: &Pairs) -> Option<f64> {
        let distribution = self.trainer.network().distribution();
        let rows = self.trainer.outputs(parameters, &pairs.observations, <[f32]>::to_vec);
        let actions = pairs.actions.chunks_exact(self.action_bytes);
        let losses = rows.iter().zip(actions).map(|(parameters, action)| {
            -f64::from(distribution.log_probability(parameters, action))
        });
        (!rows.is_empty()).then(|| losses.sum::<f64>() / rows.len() as f64)
    }

    /// Returns the most probable action of every row, concatenated.
    pub(crate) fn modes(&mut self, parameters: &[f32], observations: &[u8]) -> Vec<u8> {
        let (distribution, bytes) = (self.trainer.network().distribution(), self.action_bytes);
        let mode = |outputs: &[f32]| {
            let mut action = vec![0; bytes];
            distribution.mode(outputs, &mut action);
            action
        };
        self.trainer.outputs(parameters, observations, mode).concat()
    }

    /// Returns the number of observation bytes per row.
    pub(crate) fn row_bytes(&self) -> usize {
        self.trainer.row_bytes()
    }

    /// Adds the optimizer's state.
    pub(crate) fn save(&self, name: &str, tensors: &mut Tensors) {
        self.trainer.save(name, tensors);
    }

    /// Restores what [`Cloning::save`] added.
    pub(crate) fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        self.trainer.restore(name, tensors)
    }
}

/// Negative log-likelihood of the actions.
struct NegativeLogLikelihood<'a> {
    distribution: Distribution,
    actions: &'a [u8],
    action_bytes: usize,
    deviations: bool,
    /// One over the number of rows of the minibatch.
    weight: f32,
}

impl RowLoss for NegativeLogLikelihood<'_> {
    const OF_VALUES: bool = false;

    fn of_row(&self, row: usize, output: RowOutput<'_>, gradients: &mut [f32]) -> (Metrics, f32) {
        let action = &self.actions[row * self.action_bytes..(row + 1) * self.action_bytes];
        let distribution = self.distribution;
        distribution.gradient(output.parameters, action, -self.weight, 0.0, gradients);
        if let (Distribution::Gaussian { len }, false) = (distribution, self.deviations) {
            gradients[len..].fill(0.0);
        }
        let weight = f64::from(self.weight);
        let log_probability = distribution.log_probability(output.parameters, action);
        let metrics = Metrics {
            policy_loss: -weight * f64::from(log_probability),
            entropy: weight * f64::from(distribution.entropy(output.parameters)),
            ..Metrics::default()
        };
        (metrics, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_are_fitted_only_where_they_are_wanted() {
        let gradients = |deviations| {
            let loss = NegativeLogLikelihood {
                distribution: Distribution::Gaussian { len: 1 },
                actions: &0.5f32.to_le_bytes(),
                action_bytes: 4,
                deviations,
                weight: 1.0,
            };
            let mut gradients = [9.0; 2];
            let output = RowOutput { parameters: &[0.2, -1.0], value: 0.0 };
            loss.of_row(0, output, &mut gradients);
            gradients
        };
        let [fitted, fixed] = [true, false].map(gradients);
        assert!(fitted[0] < 0.0 && fitted[0] == fixed[0], "{fitted:?}, {fixed:?}");
        assert!(fitted[1].abs() > 0.1 && fixed[1] == 0.0, "{fitted:?}, {fixed:?}");
    }
}
