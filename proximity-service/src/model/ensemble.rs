//! The ensemble of every learned reward model: its training step, scores and state.
//!
//! Members differ only in their initial weights, priors and, if bootstrapped, minibatches. Members are trained, and
//! shards of rows scored, on several threads. Each result is computed by one thread in a fixed order, so the number
//! of threads never changes a bit.

use networks::{
    Ensemble, Network, Prepared, PreparedEnsemble, RewardArchitecture, RowScore, RunningNormalizer,
    Shard, ShardedTrainer, Squashing, Step, WindowIndex, Workspace,
};
use protocol::seed::{self, Purpose};
use protocol::tensors::Tensors;
use protocol::weights;
use rayon::ThreadPool;
use rayon::prelude::*;
use run::config::RewardConfig;

use super::input::{Input, Rows};
use super::minibatch::{Losses, Minibatch};

/// Adam's epsilon, as in the authors' code.
const ADAM_EPSILON: f64 = 1e-8;

/// Rows that one thread scores at a time.
const SHARD_ROWS: usize = 64;

/// An ensemble with its optimizers.
pub struct TrainableEnsemble {
    input: Input,
    normalizer: RunningNormalizer,
    ensemble: Ensemble,
    trainers: Vec<ShardedTrainer<Network>>,
    /// Distinct windows of the minibatches: one entry for all members, or one for each.
    windows: Vec<WindowIndex>,
    prepared: PreparedEnsemble,
    threads: ThreadPool,
}

impl TrainableEnsemble {
    /// Creates a new ensemble over rows of `input`.
    pub fn new(
        input: Input,
        config: &RewardConfig,
        run_seed: u64,
        normalizer: RunningNormalizer,
        squashing: Squashing,
        threads: ThreadPool,
    ) -> Self {
        let architecture = RewardArchitecture {
            cells: config.encoder(),
            hidden: config.hidden.clone(),
            ..RewardArchitecture::default()
        };
        let network = Network::new(input.network_shape(&architecture));
        let members = 0..config.ensemble as u64;
        let streams =
            |purpose| members.clone().map(move |member| seed::stream(run_seed, purpose, member, 0));
        let mut ensemble = Ensemble::new(network, streams(Purpose::RewardWeights), squashing);
        if config.prior > 0.0 {
            ensemble = ensemble.with_priors(streams(Purpose::RewardPrior), config.prior as f32);
        }
        let trainer = |member: &Vec<f32>| {
            let trainer = ShardedTrainer::new(member.len(), ADAM_EPSILON, f64::INFINITY);
            trainer.with_weight_decay(config.weight_decay)
        };
        TrainableEnsemble {
            input,
            normalizer,
            trainers: ensemble.members.iter().map(trainer).collect(),
            windows: Vec::new(),
            prepared: ensemble.prepare(),
            ensemble,
            threads,
        }
    }

    /// Splits and normalizes rows for the networks.
    pub fn normalized(&self, rows: Vec<u8>) -> Rows {
        let mut rows = self.input.split(rows);
        self.normalizer.normalize(&mut rows.observations);
        rows
    }

    /// Takes one optimizer step of every member, on the shared minibatch or on the member's own. `loss` reads the
    /// outputs of one member and writes their gradients. Call [`TrainableEnsemble::prepare`] before scoring rows.
    ///
    /// # Errors
    /// When a loss or the gradient norm of a member is not finite; the message names the member.
    pub fn train(
        &mut self,
        minibatches: &[Minibatch],
        loss: impl Fn(&Minibatch, &[f32], &mut [f32]) -> Losses + Sync,
        learning_rate: f64,
    ) -> Result<Losses, String> {
        let network = &self.ensemble.network;
        self.windows.resize_with(minibatches.len(), WindowIndex::default);
        let indexed = minibatches.iter().zip(&mut self.windows);
        let batches: Vec<_> = indexed
            .map(|(minibatch, windows)| (minibatch, minibatch.rows.indexed(network, windows)))
            .collect();
        let priors = &self.prepared.priors;
        let members = self.ensemble.members.par_iter_mut().zip(&mut self.trainers).enumerate();
        type Member<'a> = (usize, (&'a mut Vec<f32>, &'a mut ShardedTrainer<Network>));
        let train = |(number, (member, trainer)): Member<'_>| {
            let (minibatch, batch) = batches[number % batches.len()];
            let of_member = |shard: Shard<'_, Network>, sum: &mut [f32]| {
                differentiate(shard, priors.get(number), minibatch, &loss, sum)
            };
            // Losses are means over the rows or pairs of a minibatch, so a minibatch is one shard.
            trainer.step(network, member, batch, usize::MAX, learning_rate, of_member)
        };
        let steps: Vec<Step<Losses>> = self.threads.install(|| members.map(train).collect());
        let mut sum = Losses::default();
        for (member, Step { terms, gradient_norm }) in steps.into_iter().enumerate() {
            if let Some(problem) = terms.problem(gradient_norm) {
                return Err(format!("member {member}: {problem}"));
            }
            sum += terms;
        }
        Ok(sum.divided_by(self.trainers.len()))
    }

    /// Checks that weights and optimizer states are finite.
    ///
    /// # Errors
    /// When an array is not; the message names it.
    pub fn expect_finite(&self) -> Result<(), String> {
        let mut tensors = Tensors::default();
        self.save(&mut tensors);
        tensors.expect_finite()
    }

    /// Makes the trained weights those that rows are scored with.
    pub fn prepare(&mut self) {
        self.prepared = self.ensemble.prepare();
    }

    /// Scores rows, in order.
    pub fn scores(&self, rows: &[u8]) -> Vec<RowScore> {
        let score = |(workspace, windows): &mut (Workspace, WindowIndex), shard: &[u8]| {
            let rows = self.normalized(shard.to_vec());
            let batch = rows.indexed(&self.ensemble.network, windows);
            self.ensemble.score(&self.prepared, batch, workspace)
        };
        let shards = rows.par_chunks(SHARD_ROWS * self.input.row_bytes());
        let scores = || shards.map_init(Default::default, score).collect::<Vec<_>>();
        self.threads.install(scores).concat()
    }

    /// Returns the networks and the normalizer of their observations.
    pub fn networks(&self) -> (&Ensemble, &RunningNormalizer) {
        (&self.ensemble, &self.normalizer)
    }

    /// Returns the hash of the members' weights, without priors.
    pub fn sha256(&self) -> String {
        weights::sha256(self.ensemble.members.iter().map(Vec::as_slice))
    }

    /// Adds weights (including priors), optimizer states and normalization to a checkpoint.
    pub fn save(&self, tensors: &mut Tensors) {
        tensors.put_f64("moments", self.normalizer.to_numbers());
        let members = self.ensemble.members.iter().zip(&self.trainers).enumerate();
        for (number, (member, trainer)) in members {
            tensors.put_f32(&format!("member{number}.parameters"), member.iter().copied());
            trainer.save(&format!("member{number}.adam"), tensors);
        }
        for (number, prior) in self.ensemble.priors.iter().enumerate() {
            tensors.put_f32(&prior_name(number), prior.iter().copied());
        }
    }

    /// Restores what [`TrainableEnsemble::save`] added.
    ///
    /// # Errors
    /// When the arrays do not fit this ensemble.
    pub fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        let moments = self.normalizer.to_numbers().len();
        let moments = tensors.exactly("moments", moments, Tensors::f64)?;
        self.normalizer = RunningNormalizer::from_numbers(&moments);
        let members = self.ensemble.members.iter_mut().zip(&mut self.trainers).enumerate();
        for (number, (member, trainer)) in members {
            let name = format!("member{number}.parameters");
            *member = tensors.exactly(&name, member.len(), Tensors::f32)?;
            trainer.restore(&format!("member{number}.adam"), tensors)?;
        }
        self.ensemble.priors = self.restored_priors(tensors)?;
        self.prepare();
        Ok(())
    }

    /// Returns the priors in a checkpoint, which may have none. They replace those of the configuration.
    fn restored_priors(&self, tensors: &Tensors) -> Result<Vec<Vec<f32>>, String> {
        if !tensors.has(&prior_name(0)) {
            return Ok(Vec::new());
        }
        let parameters = self.ensemble.network.parameter_count();
        let members = 0..self.ensemble.members.len();
        let prior = |member| tensors.exactly(&prior_name(member), parameters, Tensors::f32);
        members.map(prior).collect()
    }
}

/// Returns the name of a member's prior in a checkpoint.
fn prior_name(member: usize) -> String {
    format!("member{member}.prior")
}

/// Adds the gradient of a minibatch's loss and of its penalty to `sum` and returns the losses.
fn differentiate(
    shard: Shard<'_, Network>,
    prior: Option<&Prepared>,
    minibatch: &Minibatch,
    loss: impl Fn(&Minibatch, &[f32], &mut [f32]) -> Losses,
    sum: &mut [f32],
) -> Losses {
    let Shard { network, prepared, batch, workspace, .. } = shard;
    let prior = prior.map(|prior| network.forward(prior, batch, workspace).clone());
    // Evaluated last, since back-propagation needs its intermediate values.
    let mut outputs = network.forward(prepared, batch, workspace).clone();
    if let Some(prior) = prior {
        outputs += prior;
    }
    let mut gradients = outputs.clone();
    let losses = loss(minibatch, outputs.as_slice(), gradients.as_mut_slice());
    network.backward(prepared, batch, workspace, &gradients, sum);
    if let Some(penalty) = &minibatch.penalty {
        penalty.differentiate(network, prepared, workspace, sum);
    }
    losses
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{GoalProximity, Learned, RewardModel};
    use crate::tests::{assert_reproducible, config, learned, place, pretrained};

    #[test]
    fn members_are_as_large_as_the_configuration_foresees() {
        for settings in [
            "fetch-pick reward.hidden=[1,2,3]",
            "fetch-push reward.input=state-action",
            "ant-reach method=gaifo",
            "ant-reach method=gaifo-next-state",
            "navigation reward.hidden=[] reward.pool=4",
            "navigation reward.convolution_channels=[2,3,4,5]",
            "navigation reward.input=state-action",
            "navigation method=gail reward.hidden=[9,33] reward.features=5",
            "navigation",
            "navigation method=gaifo",
            "fetch-pick method=gail",
        ] {
            let words: Vec<String> = settings.split(' ').map(str::to_owned).collect();
            let config = run::tasks::configuration(&words[0], None, &words[1..]).unwrap();
            let input = Input::new(&config.task.spec(), config.reward.input);
            let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            let ensemble = TrainableEnsemble::new(
                input,
                &config.reward,
                1,
                RunningNormalizer::new(0),
                Squashing::ClampedMean,
                threads,
            );
            let parameters = ensemble.ensemble.members[0].len() as f64;
            assert_eq!(config.member_size().parameters, parameters, "{settings}");
        }
    }

    #[test]
    fn weight_decay_keeps_the_members_small() {
        let size = |weight_decay| -> f32 {
            let mut model: Learned<GoalProximity> =
                learned(&RewardConfig { weight_decay, ..config() }, 2);
            pretrained(&mut model);
            let member = model.save().f32("member0.parameters").unwrap();
            member.iter().map(|weight| weight * weight).sum()
        };
        let [without, with] = [0.0, 1.0].map(size);
        assert!(with < 0.8 * without, "{with} with decay, {without} without");
    }

    fn with_priors(prior: f64) -> Learned<GoalProximity> {
        let mut model = learned(&RewardConfig { prior, ..config() }, 2);
        pretrained(&mut model);
        model
    }

    #[test]
    fn priors_tell_what_was_not_demonstrated_and_members_learn_all_the_same() {
        assert_reproducible::<GoalProximity>(&RewardConfig { prior: 3.0, ..config() });
        let [without, with] = [0.0, 3.0].map(|prior| {
            let model = with_priors(prior);
            let [known, unknown] = [0.0, 2.0].map(|row| model.estimate(&place(0.9, row)).unwrap());
            let near = known.proximity[0];
            assert!((near - 0.9).abs() < 0.1, "{near} with a prior of {prior}");
            [known.uncertainty[0], unknown.uncertainty[0]]
        });
        assert!(with[1] > 1.5 * without[1], "{with:?} with priors, {without:?} without");
        assert!(with[1] > 5.0 * with[0], "{with:?} with priors");
    }

    #[test]
    fn a_checkpoint_brings_its_priors_along() {
        let at = place(0.4, 1.0);
        let trained = [0.0, 3.0].map(with_priors);
        for model in &trained {
            for mut other in [0.0, 1.0].map(with_priors) {
                other.restore(&model.save()).unwrap();
                assert_eq!(other.estimate(&at).unwrap(), model.estimate(&at).unwrap());
            }
        }
    }
}
