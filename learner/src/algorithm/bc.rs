//! Behavioral cloning (paper, Section 4.1 and Appendix G.3): each iteration is one pass over the expert's
//! observations and actions, until the loss on held-out demonstrations stops falling.

use anyhow::Result;
use networks::RunningNormalizer;
use protocol::messages::Score;
use protocol::seed::{self, Purpose};
use protocol::task::Spec;
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, Trajectory};
use rand::seq::SliceRandom;
use run::config::CloningConfig;

use crate::algorithm::cloning::{Cloning, Pairs, Settings};
use crate::algorithm::{Metrics, PolicyLearner, Schedule, Setup};
use crate::state::PolicyState;

/// The learner of behavioral cloning.
pub(super) struct Bc {
    config: CloningConfig,
    passes: u64,
    cloning: Cloning,
    training: Pairs,
    held_out: Pairs,
    best: Best,
}

/// The weights with the lowest held-out loss so far.
struct Best {
    loss: f64,
    parameters: Vec<f32>,
    /// Passes since then.
    age: u64,
    finished: bool,
}

impl Bc {
    /// Creates an untrained learner.
    pub(super) fn new(of: Setup<'_>) -> Bc {
        let Setup { config, network, normalizer, demonstrations } = of;
        let spec = config.task.spec();
        let cloning = config.cloning.clone().expect("checked with the configuration");
        let (held_out, training) = split(demonstrations, cloning.validation, config.seed);
        let parameters = network.parameter_count();
        Bc {
            passes: config.iterations(),
            cloning: Cloning::new(network, spec.action.bytes(), settings(&cloning)),
            training: pairs(&training, &spec, normalizer),
            held_out: pairs(&held_out, &spec, normalizer),
            best: Best {
                loss: f64::MAX,
                parameters: vec![0.0; parameters],
                age: 0,
                finished: false,
            },
            config: cloning,
        }
    }
}

/// Returns the cloning settings of a configuration.
pub(super) fn settings(config: &CloningConfig) -> Settings {
    let &CloningConfig { batch, adam_epsilon, max_gradient_norm, deviations, .. } = config;
    Settings { batch, adam_epsilon, max_gradient_norm, deviations }
}

/// Splits demonstrations into held-out ones and the others.
fn split(
    demonstrations: &[Trajectory],
    part: f64,
    run_seed: u64,
) -> (Vec<&Trajectory>, Vec<&Trajectory>) {
    let mut all: Vec<&Trajectory> = demonstrations.iter().collect();
    all.shuffle(&mut seed::stream(run_seed, Purpose::HeldOutDemonstrations, 0, 0));
    let training = all.split_off((part * all.len() as f64) as usize);
    (all, training)
}

fn pairs(demonstrations: &[&Trajectory], spec: &Spec, normalizer: &RunningNormalizer) -> Pairs {
    let mut pairs = Pairs::default();
    for demonstration in demonstrations {
        let acted_on = demonstration.steps as usize * spec.observation.bytes();
        pairs.observations.extend(&demonstration.observations()[..acted_on]);
        pairs.actions.extend(demonstration.actions());
    }
    normalizer.normalize(&mut pairs.observations);
    pairs
}

impl PolicyLearner for Bc {
    fn update(
        &mut self,
        policy: &mut PolicyState,
        _trajectories: &[Encoded],
        _scores: &[Score],
        schedule: &Schedule,
    ) -> Result<Metrics> {
        let Schedule { run_seed, iteration, learning_rate } = *schedule;
        let count = self.training.observations.len() / self.cloning.row_bytes();
        let mut rows: Vec<u32> = (0..count as u32).collect();
        rows.shuffle(&mut seed::stream(run_seed, Purpose::CloningBatches, iteration, 0));
        let parameters = &mut policy.parameters;
        let mut metrics = self.cloning.train(parameters, &self.training, &rows, learning_rate)?;
        let held_out = self.cloning.loss(parameters, &self.held_out);
        metrics.held_out_loss = held_out.unwrap_or_default();
        metrics.expect_finite(format_args!("pass {}", iteration + 1))?;
        let last = iteration + 1 == self.passes;
        self.best.judge(parameters, held_out, self.config.patience, last);
        Ok(metrics)
    }

    fn is_finished(&self) -> bool {
        self.best.finished
    }

    fn save(&self, tensors: &mut Tensors) {
        self.cloning.save("adam", tensors);
        tensors.put_f32("best.parameters", self.best.parameters.iter().copied());
        tensors.put_f64("best.loss", [self.best.loss]);
        tensors.put_u64("best.age", [self.best.age, u64::from(self.best.finished)]);
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.cloning.restore("adam", tensors)?;
        let count = self.best.parameters.len();
        let age = tensors.exactly("best.age", 2, Tensors::u64)?;
        self.best = Best {
            loss: tensors.exactly("best.loss", 1, Tensors::f64)?[0],
            parameters: tensors.exactly("best.parameters", count, Tensors::f32)?,
            age: age[0],
            finished: age[1] == 1,
        };
        Ok(())
    }
}

impl Best {
    /// Takes in the result of a pass; without a held-out loss the last pass is the best. When training ends, it
    /// replaces the last weights by the best.
    fn judge(&mut self, parameters: &mut Vec<f32>, loss: Option<f64>, patience: u64, last: bool) {
        if loss.is_none_or(|loss| loss < self.loss) {
            self.loss = loss.unwrap_or(self.loss);
            self.parameters.clone_from(parameters);
            self.age = 0;
        } else {
            self.age += 1;
        }
        self.finished = last || self.age >= patience;
        if self.finished {
            parameters.clone_from(&self.parameters);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_weights_are_kept_until_patience_ends() {
        let mut best = Best { loss: f64::INFINITY, parameters: vec![0.0], age: 0, finished: false };
        let mut parameters = vec![1.0];
        best.judge(&mut parameters, Some(0.5), 2, false);
        parameters = vec![2.0];
        best.judge(&mut parameters, Some(0.6), 2, false);
        assert!(!best.finished && parameters == [2.0]);
        best.judge(&mut parameters, Some(0.7), 2, false);
        assert!(best.finished && parameters == [1.0]);
    }

    #[test]
    fn where_nothing_is_held_out_all_passes_are_trained_and_the_last_counts() {
        let few = vec![Trajectory::default(); 4];
        let (held_out, training) = split(&few, 0.2, 1);
        assert_eq!((held_out.len(), training.len()), (0, 4));
        let mut best = Best { loss: f64::MAX, parameters: vec![0.0], age: 0, finished: false };
        let mut parameters = vec![0.0];
        for pass in 1..=3_u8 {
            assert!(!best.finished);
            parameters = vec![f32::from(pass)];
            best.judge(&mut parameters, None, 1, pass == 3);
        }
        assert!(best.finished && parameters == [3.0]);
    }

    #[test]
    fn whole_demonstrations_are_held_out() {
        let demonstrations: Vec<Trajectory> =
            (0..10).map(|episode| Trajectory { episode, ..Trajectory::default() }).collect();
        let (held_out, training) = split(&demonstrations, 0.2, 1);
        let mut all: Vec<u64> =
            held_out.iter().chain(&training).map(|demonstration| demonstration.episode).collect();
        all.sort_unstable();
        assert_eq!((held_out.len(), training.len()), (2, 8));
        assert_eq!(all, (0..10).collect::<Vec<_>>());
    }
}
