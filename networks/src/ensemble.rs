//! The ensemble. Its mean gives the proximity and its spread the uncertainty (Section 3.3).

use protocol::seed::Stream;

use crate::batch::Batch;
use crate::loss::sigmoid;
use crate::network::{Network, Prepared, Workspace};

/// Copies of one network with a single output, whose parameters are drawn independently.
#[derive(Clone, Debug)]
pub struct Ensemble {
    /// Network that all members share.
    pub network: Network,
    /// Parameters of each member.
    pub members: Vec<Vec<f32>>,
    /// Parameters of each member's prior, or empty without priors. A prior has the same shape, is never trained,
    /// and adds its output to the member's (randomized prior functions, Osband et al., 2018).
    pub priors: Vec<Vec<f32>>,
    /// How the members' outputs become a proximity.
    pub squashing: Squashing,
}

/// The parameters of an ensemble, packed for evaluation.
#[derive(Clone, Debug)]
pub struct PreparedEnsemble {
    /// Parameters of each member.
    pub members: Vec<Prepared>,
    /// Parameters of each member's prior, or empty without priors.
    pub priors: Vec<Prepared>,
}

/// How the outputs of an ensemble's members become a proximity in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Squashing {
    /// Their mean, clamped after averaging.
    ClampedMean,
    /// The sigmoid of their mean.
    SigmoidOfMean,
    /// The mean of their sigmoids.
    MeanOfSigmoids,
}

impl Squashing {
    /// Returns the proximity for a [`RowScore::mean`].
    pub fn proximity(self, mean: f32) -> f32 {
        match self {
            Squashing::ClampedMean => mean.clamp(0.0, 1.0),
            Squashing::SigmoidOfMean => sigmoid(mean),
            Squashing::MeanOfSigmoids => mean,
        }
    }
}

/// Output of an ensemble for one row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowScore {
    /// Mean over the members.
    pub mean: f32,
    /// Sample standard deviation over the members (divided by their number minus one).
    pub standard_deviation: f32,
}

impl RowScore {
    /// Computes the score of one row from each member's output. The standard deviation of a single member is 0.
    pub fn of(outputs: impl ExactSizeIterator<Item = f32> + Clone) -> Self {
        let count = outputs.len();
        let mean = outputs.clone().map(f64::from).sum::<f64>() / count as f64;
        let square = |output: f32| (f64::from(output) - mean) * (f64::from(output) - mean);
        let variance = outputs.map(square).sum::<f64>() / count.saturating_sub(1).max(1) as f64;
        Self { mean: mean as f32, standard_deviation: variance.sqrt() as f32 }
    }
}

impl Ensemble {
    /// Creates an ensemble without priors, drawing one member from each stream.
    ///
    /// # Panics
    /// If the network does not have exactly one output.
    pub fn new(
        network: Network,
        streams: impl IntoIterator<Item = Stream>,
        squashing: Squashing,
    ) -> Self {
        assert_eq!(network.outputs(), 1, "outputs of a member of an ensemble");
        let streams = streams.into_iter();
        let members = streams.map(|mut stream| network.initial_parameters(&mut stream)).collect();
        Self { network, members, priors: Vec::new(), squashing }
    }

    /// Draws a prior for each member, each from its own stream, and scales the prior's output by `weight`.
    ///
    /// # Panics
    /// If the number of streams differs from the number of members.
    #[must_use]
    pub fn with_priors(mut self, streams: impl IntoIterator<Item = Stream>, weight: f32) -> Self {
        let ranges = self.network.parameter_ranges();
        let output_layer = ranges.last().expect("there is an output layer").clone();
        let prior = |mut stream: Stream| {
            let mut prior = self.network.initial_parameters(&mut stream);
            prior[output_layer.clone()].iter_mut().for_each(|parameter| *parameter *= weight);
            prior
        };
        self.priors = streams.into_iter().map(prior).collect();
        assert_eq!(self.priors.len(), self.members.len(), "priors of an ensemble");
        self
    }

    /// Packs all parameters for evaluation.
    pub fn prepare(&self) -> PreparedEnsemble {
        let all = |networks: &[Vec<f32>]| {
            networks.iter().map(|parameters| self.network.prepare(parameters)).collect()
        };
        PreparedEnsemble { members: all(&self.members), priors: all(&self.priors) }
    }

    /// Scores every row of a batch.
    ///
    /// # Panics
    /// As [`Network::forward`].
    pub fn score(
        &self,
        prepared: &PreparedEnsemble,
        batch: Batch<'_>,
        workspace: &mut Workspace,
    ) -> Vec<RowScore> {
        let outputs = self.outputs(prepared, batch, workspace);
        let rows = outputs.len() / prepared.members.len();
        let row = |row: usize| {
            let members = 0..prepared.members.len();
            RowScore::of(members.map(|member| outputs[member * rows + row]))
        };
        (0..rows).map(row).collect()
    }

    /// Returns `members x rows` outputs, priors included.
    fn outputs(
        &self,
        prepared: &PreparedEnsemble,
        batch: Batch<'_>,
        workspace: &mut Workspace,
    ) -> Vec<f32> {
        let mut outputs = Vec::new();
        for member in &prepared.members {
            let own = self.network.forward(member, batch, workspace);
            outputs.extend_from_slice(own.as_slice());
        }
        let rows = outputs.len() / prepared.members.len();
        for (prior, outputs) in prepared.priors.iter().zip(outputs.chunks_exact_mut(rows)) {
            let own = self.network.forward(prior, batch, workspace);
            outputs.iter_mut().zip(own.as_slice()).for_each(|(output, prior)| *output += prior);
        }
        if self.squashing == Squashing::MeanOfSigmoids {
            outputs.iter_mut().for_each(|output| *output = sigmoid(*output));
        }
        outputs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::RewardArchitecture;
    use protocol::seed::{Purpose, stream};
    use protocol::task::{ObservationSpec, write_floats};

    #[test]
    fn a_prior_adds_its_output_times_the_weight() {
        let architecture = RewardArchitecture { hidden: vec![5], ..Default::default() };
        let vector = ObservationSpec::Vector { len: 2 };
        let network = Network::new(architecture.network_shape(vector, 1, 0));
        let streams = |purpose| (0..2).map(move |member| stream(1, purpose, member, 0));
        let without =
            Ensemble::new(network, streams(Purpose::RewardWeights), Squashing::ClampedMean);
        let mut bytes = vec![0; 3 * 8];
        write_floats([0.3, -0.2, 1.5, 0.4, -2.0, 0.1], &mut bytes);
        let means = |ensemble: &Ensemble| {
            let (batch, prepared) = (Batch::new(&bytes), ensemble.prepare());
            let outputs = ensemble.outputs(&prepared, batch, &mut Workspace::default());
            assert_eq!(outputs.len(), 2 * 3);
            outputs
        };
        let priors =
            |weight| means(&without.clone().with_priors(streams(Purpose::RewardPrior), weight));
        let members = means(&without);
        for ((member, once), thrice) in members.iter().zip(priors(1.0)).zip(priors(3.0)) {
            assert!((once - member).abs() > 1e-3, "{once} with a prior, {member} without");
            assert!((thrice - member - 3.0 * (once - member)).abs() < 1e-5);
        }
    }

    #[test]
    fn the_proximity_is_clamped_and_the_standard_deviation_is_not() {
        for (outputs, mean, standard_deviation, proximity) in [
            (&[0.5, 1.5, 2.5][..], 1.5, 1.0, 1.0),
            (&[-3.0, -3.0], -3.0, 0.0, 0.0),
            (&[0.25], 0.25, 0.0, 0.25),
        ] {
            let score = RowScore::of(outputs.iter().copied());
            assert_eq!(score, RowScore { mean, standard_deviation });
            assert_eq!(Squashing::ClampedMean.proximity(mean), proximity);
        }
    }
}
