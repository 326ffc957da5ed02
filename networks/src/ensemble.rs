//! The ensemble whose mean is the proximity and whose spread is the uncertainty (Section 3.3).

use protocol::seed::Stream;

use crate::batch::Batch;
use crate::loss::sigmoid;
use crate::network::{Network, Prepared, Workspace};

/// Independently drawn copies of one network with a single output.
#[derive(Clone, Debug)]
pub struct Ensemble {
    /// What every member is.
    pub network: Network,
    /// The parameters of each member.
    pub members: Vec<Vec<f32>>,
    /// How the members' outputs become a proximity.
    pub squashing: Squashing,
}

/// How outputs of the members of an ensemble become a proximity in [0, 1].
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
    /// The proximity that a [`Score::mean`] stands for.
    pub fn proximity(self, mean: f32) -> f32 {
        match self {
            Squashing::ClampedMean => mean.clamp(0.0, 1.0),
            Squashing::SigmoidOfMean => sigmoid(mean),
            Squashing::MeanOfSigmoids => mean,
        }
    }
}

/// What an ensemble says about one row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Mean of the members.
    pub mean: f32,
    /// Standard deviation of the members, over one less than their number.
    pub standard_deviation: f32,
}

impl Score {
    /// The score of one row, from each member's output. A single member is never uncertain.
    pub fn of(outputs: impl ExactSizeIterator<Item = f32> + Clone) -> Self {
        let count = outputs.len();
        let mean = outputs.clone().map(f64::from).sum::<f64>() / count as f64;
        let square = |output: f32| (f64::from(output) - mean) * (f64::from(output) - mean);
        let variance = outputs.map(square).sum::<f64>() / count.saturating_sub(1).max(1) as f64;
        Self { mean: mean as f32, standard_deviation: variance.sqrt() as f32 }
    }
}

impl Ensemble {
    /// Draws one member from each stream.
    ///
    /// # Panics
    /// If the network has not exactly one output.
    pub fn new(
        network: Network,
        streams: impl IntoIterator<Item = Stream>,
        squashing: Squashing,
    ) -> Self {
        assert_eq!(network.outputs(), 1, "outputs of a member of an ensemble");
        let streams = streams.into_iter();
        let members = streams.map(|mut stream| network.initial_parameters(&mut stream)).collect();
        Self { network, members, squashing }
    }

    /// Packs the parameters of every member for evaluation.
    pub fn prepare(&self) -> Vec<Prepared> {
        self.members.iter().map(|member| self.network.prepare(member)).collect()
    }

    /// Scores every row of a batch; `outputs` is reused memory, `members x rows` afterwards.
    ///
    /// # Panics
    /// As [`Network::forward`].
    pub fn score(
        &self,
        prepared: &[Prepared],
        batch: Batch<'_>,
        workspace: &mut Workspace,
        outputs: &mut Vec<f32>,
        scores: &mut Vec<Score>,
    ) {
        outputs.clear();
        for prepared in prepared {
            let own = self.network.forward(prepared, batch, workspace);
            outputs.extend_from_slice(own.as_slice());
        }
        if self.squashing == Squashing::MeanOfSigmoids {
            outputs.iter_mut().for_each(|output| *output = sigmoid(*output));
        }
        let rows = outputs.len() / prepared.len();
        let row = |row: usize| {
            let members = 0..prepared.len();
            Score::of(members.map(|member| outputs[member * rows + row]))
        };
        scores.clear();
        scores.extend((0..rows).map(row));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_proximity_is_clamped_and_the_standard_deviation_is_not() {
        for (outputs, mean, standard_deviation, proximity) in [
            (&[0.5, 1.5, 2.5][..], 1.5, 1.0, 1.0),
            (&[-3.0, -3.0], -3.0, 0.0, 0.0),
            (&[0.25], 0.25, 0.0, 0.25),
        ] {
            let score = Score::of(outputs.iter().copied());
            assert_eq!(score, Score { mean, standard_deviation });
            assert_eq!(Squashing::ClampedMean.proximity(mean), proximity);
        }
    }
}
