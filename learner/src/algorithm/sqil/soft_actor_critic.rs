//! A soft actor-critic for continuous actions (Haarnoja et al., 2018): two Q-functions, a squashed normal
//! policy that is improved by the smaller of the two, and a temperature that is tuned to a target entropy.

use networks::{ActorCritic, Adam, Batch, Distribution, Observations, WindowIndex};
use protocol::seed::Stream;
use protocol::task::{ActionSpec, floats};
use protocol::tensors::Tensors;
use run::config::{RunConfig, SqilConfig};

use super::q_function::{ADAM_EPSILON, QFunction};
use super::{Minibatch, SoftLearner};
use crate::algorithm::Metrics;
use crate::algorithm::policy_trainer::{PolicyTrainer, RowLoss, RowOutput};

/// The two Q-functions, the policy's optimizer and the temperature.
pub(super) struct SoftActorCritic {
    config: SqilConfig,
    action_len: usize,
    q_functions: [QFunction; 2],
    actor: PolicyTrainer,
    log_temperature: Vec<f32>,
    temperature_optimizer: Adam,
}

/// Actions sampled for some observations.
struct SampledActions {
    /// The standard normal numbers that the actions were made from.
    noise: Vec<f32>,
    actions: Vec<f32>,
    log_probs: Vec<f32>,
}

impl SoftActorCritic {
    pub(super) fn new(
        config: &RunConfig,
        own: &SqilConfig,
        network: ActorCritic,
    ) -> SoftActorCritic {
        let action_len = match config.task.action {
            ActionSpec::Continuous { len } => len,
            ActionSpec::Discrete { .. } => unreachable!("soft Q-learning has discrete actions"),
        };
        let q_function = |number| QFunction::new(number, config, own, action_len);
        SoftActorCritic {
            config: own.clone(),
            action_len,
            q_functions: [0, 1].map(q_function),
            actor: PolicyTrainer::new(network, ADAM_EPSILON, f64::INFINITY),
            log_temperature: vec![libm::logf(own.temperature as f32)],
            temperature_optimizer: Adam::new(1, ADAM_EPSILON),
        }
    }

    fn temperature(&self) -> f32 {
        libm::expf(self.log_temperature[0])
    }

    fn draw(&mut self, policy: &[f32], observations: &[u8], stream: &mut Stream) -> SampledActions {
        let distribution = self.actor.network().distribution();
        let rows = self.actor.outputs(policy, observations, <[f32]>::to_vec);
        let numbers = rows.len() * self.action_len;
        let mut drawn = SampledActions {
            noise: vec![0.0; numbers],
            actions: vec![0.0; numbers],
            log_probs: Vec::new(),
        };
        let noise = drawn.noise.chunks_exact_mut(self.action_len);
        let actions = drawn.actions.chunks_exact_mut(self.action_len);
        for ((parameters, noise), action) in rows.iter().zip(noise).zip(actions) {
            drawn.log_probs.push(distribution.draw(parameters, stream, noise, action));
        }
        drawn
    }

    /// Fits both Q-functions to `r + gamma (min Q'(s', a') - alpha log pi(a' | s'))`, where `Q'` are the slow copies
    /// and the policy draws `a'`.
    fn improve_q_functions(
        &mut self,
        policy: &[f32],
        minibatch: &Minibatch,
        stream: &mut Stream,
        learning_rate: f64,
    ) -> f64 {
        let temperature = self.temperature();
        let next = self.draw(policy, &minibatch.next_observations, stream);
        let observations = Observations::Bytes(&minibatch.next_observations);
        let batch = Batch { observations, extra_inputs: &next.actions };
        let [first, second] = self.q_functions.each_ref().map(|one| one.target_values(batch));
        let values = first.iter().zip(&second).zip(&next.log_probs);
        let values: Vec<f32> = values
            .map(|((first, second), log_prob)| first.min(*second) - temperature * log_prob)
            .collect();
        let targets = minibatch.targets(&values, self.config.gamma as f32);
        let actions: Vec<f32> =
            floats(&minibatch.actions).map(|number| number.clamp(-1.0, 1.0)).collect();
        let observations = Observations::Bytes(&minibatch.observations);
        let batch = Batch { observations, extra_inputs: &actions };
        let fit = |one: &mut QFunction| one.fit(batch, &targets, learning_rate);
        self.q_functions.iter_mut().map(fit).sum::<f64>() / 2.0
    }

    /// Moves the policy towards actions that the smaller Q-function values higher.
    fn improve_policy(
        &mut self,
        policy: &mut [f32],
        minibatch: &Minibatch,
        stream: &mut Stream,
        learning_rate: f64,
    ) -> Metrics {
        let observations = &minibatch.observations;
        let drawn = self.draw(policy, observations, stream);
        let own = Observations::Bytes(observations);
        let batch = Batch { observations: own, extra_inputs: &drawn.actions };
        let [first, second] = self.q_functions.each_ref().map(|one| one.action_gradients(batch));
        let smaller = first.0.iter().zip(&second.0).map(|(first, second)| first <= second);
        let rows =
            first.1.chunks_exact(self.action_len).zip(second.1.chunks_exact(self.action_len));
        let gradients = smaller.zip(rows).flat_map(
            |(is_first, (first, second))| {
                if is_first { first } else { second }
            },
        );
        let loss = ActorLoss {
            distribution: self.actor.network().distribution(),
            action_len: self.action_len,
            gradients: gradients.copied().collect(),
            values: first.0.iter().zip(&second.0).map(|(one, other)| one.min(*other)).collect(),
            temperature: self.temperature(),
            weight: 1.0 / minibatch.len() as f32,
            drawn: &drawn,
        };
        let rows: Vec<u32> = (0..minibatch.len() as u32).collect();
        let mut windows = WindowIndex::default();
        let observations = self.actor.index(observations, &mut windows);
        let metrics = self.actor.step(policy, observations, &rows, &loss, learning_rate);
        if self.config.tune_temperature {
            self.tune_temperature(&drawn.log_probs, learning_rate);
        }
        metrics
    }

    /// Tunes the temperature: raises it if the policy's entropy is below minus the number of action dimensions.
    fn tune_temperature(&mut self, log_probs: &[f32], learning_rate: f64) {
        let mean = log_probs.iter().sum::<f32>() / log_probs.len() as f32;
        let derivative = self.action_len as f32 - mean;
        self.temperature_optimizer.update(&mut self.log_temperature, &[derivative], learning_rate);
    }
}

impl SoftLearner for SoftActorCritic {
    fn update(
        &mut self,
        policy: &mut Vec<f32>,
        minibatch: &Minibatch,
        stream: &mut Stream,
        learning_rate: f64,
    ) -> Metrics {
        let value_loss = self.improve_q_functions(policy, minibatch, stream, learning_rate);
        let metrics = self.improve_policy(policy, minibatch, stream, learning_rate);
        let rate = self.config.target_rate;
        self.q_functions.iter_mut().for_each(|one| one.update_targets(rate));
        Metrics { value_loss, ..metrics }
    }

    fn save(&self, tensors: &mut Tensors) {
        for (number, one) in self.q_functions.iter().enumerate() {
            one.save(&format!("q{number}"), tensors);
        }
        self.actor.save("adam", tensors);
        self.temperature_optimizer.save("temperature.adam", tensors);
        tensors.put_f32("temperature.logarithm", self.log_temperature.iter().copied());
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        for (number, one) in self.q_functions.iter_mut().enumerate() {
            one.restore(&format!("q{number}"), tensors)?;
        }
        self.actor.restore("adam", tensors)?;
        self.temperature_optimizer.restore("temperature.adam", tensors)?;
        self.log_temperature = tensors.exactly("temperature.logarithm", 1, Tensors::f32)?;
        Ok(())
    }
}

/// The policy loss `temperature x log pi(a | s) - Q(s, a)` of sampled actions.
struct ActorLoss<'a> {
    distribution: Distribution,
    action_len: usize,
    drawn: &'a SampledActions,
    /// Values of the smaller Q-function.
    values: Vec<f32>,
    /// Its gradients with respect to the drawn actions.
    gradients: Vec<f32>,
    temperature: f32,
    /// One over the number of rows.
    weight: f32,
}

impl RowLoss for ActorLoss<'_> {
    const OF_VALUES: bool = false;

    fn of_row(&self, row: usize, output: RowOutput<'_>, gradients: &mut [f32]) -> (Metrics, f32) {
        let numbers = row * self.action_len..(row + 1) * self.action_len;
        let action_gradients: Vec<f32> = self.gradients[numbers.clone()]
            .iter()
            .map(|derivative| -self.weight * derivative)
            .collect();
        let of_log_prob = self.weight * self.temperature;
        let noise = &self.drawn.noise[numbers];
        let distribution = self.distribution;
        distribution.pathwise_gradient(
            output.parameters,
            noise,
            &action_gradients,
            of_log_prob,
            gradients,
        );
        let log_prob = f64::from(self.drawn.log_probs[row]);
        let weight = f64::from(self.weight);
        let metrics = Metrics {
            policy_loss: weight
                * (f64::from(self.temperature) * log_prob - f64::from(self.values[row])),
            entropy: -weight * log_prob,
            ..Metrics::default()
        };
        (metrics, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use networks::PolicyArchitecture;

    use super::*;

    #[test]
    fn the_temperature_rises_while_there_is_too_little_entropy() {
        let config = run::tasks::configuration("fetch-push", None, &["method=sqil".to_owned()]);
        let config = config.unwrap();
        let spec = config.task.spec();
        let architecture = PolicyArchitecture::from(&config.policy);
        let network = ActorCritic::new(spec.observation, spec.action, &architecture);
        let mut learner = SoftActorCritic::new(&config, config.sqil.as_ref().unwrap(), network);
        let wanted = -(learner.action_len as f32);
        let mut tuned = |entropy: f32| {
            let before = learner.temperature();
            learner.tune_temperature(&[-entropy - 1.0, -entropy + 1.0], 0.01);
            learner.temperature() - before
        };
        assert!(tuned(wanted - 2.0) > 0.0);
        // Adam keeps some momentum.
        assert!((0..5).map(|_| tuned(wanted + 2.0)).last().unwrap() < 0.0);
    }
}
