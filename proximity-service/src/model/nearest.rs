//! The nearest demonstrated state: a step earns minus the distance of the state it reaches from the
//! nearest one of the demonstrations. Nothing is trained; what it rewards is to be where the expert
//! was, not to come closer to the goal.

use anyhow::Result;
use networks::RunningNormalizer;
use protocol::digest;
use protocol::messages::{Estimates, Score};
use protocol::task::{ObservationSpec, floats};
use protocol::trajectory::{Encoded, Trajectory};
use rayon::prelude::*;
use run::config::{RewardConfig, RunConfig};
use run::folder::RunFolder;

use super::RewardModel;
use super::learned::normalizer;
use super::registry::threads;

/// The states of the demonstrations.
pub struct NearestState {
    observation: ObservationSpec,
    normalizer: RunningNormalizer,
    /// One after another, normalized.
    demonstrated: Vec<u8>,
    threads: rayon::ThreadPool,
}

impl NearestState {
    pub(super) fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Box<dyn RewardModel>> {
        let demonstrations = run::demonstrations::load(folder, config)?;
        let observation = config.task.observation;
        Ok(Box::new(Self::new(observation, &config.reward, &demonstrations, threads(config)?)))
    }

    /// The model of some demonstrations.
    pub fn new(
        observation: ObservationSpec,
        config: &RewardConfig,
        demonstrations: &[Trajectory],
        threads: rayon::ThreadPool,
    ) -> NearestState {
        let states: Vec<&[u8]> =
            demonstrations.iter().map(Trajectory::observations_to_goal).collect();
        let mut demonstrated = states.concat();
        let normalizer = normalizer(observation, config, demonstrations);
        normalizer.normalize(&mut demonstrated);
        NearestState { observation, normalizer, demonstrated, threads }
    }

    /// Of each observation: the share of cells that differ, or the root of the mean square of the
    /// numbers' differences.
    fn distances(&self, observations: &[u8]) -> Vec<f32> {
        let mut observations = observations.to_vec();
        self.normalizer.normalize(&mut observations);
        let one = self.observation.bytes();
        let nearest = |state: &[u8]| {
            let distances =
                self.demonstrated.chunks_exact(one).map(|other| self.distance(state, other));
            distances.fold(f32::INFINITY, f32::min)
        };
        observations.chunks_exact(one).map(nearest).collect()
    }

    fn distance(&self, one: &[u8], other: &[u8]) -> f32 {
        match self.observation {
            ObservationSpec::Cells { height, width, .. } => {
                let differing = one.iter().zip(other).filter(|(one, other)| one != other).count();
                differing as f32 / (height * width) as f32
            }
            ObservationSpec::Vector { len } => {
                let differences = floats(one).zip(floats(other)).map(|(one, other)| one - other);
                let squares: f32 = differences.map(|difference| difference * difference).sum();
                (squares / len as f32).sqrt()
            }
        }
    }
}

/// 1 at a demonstrated state, falling with the distance.
fn proximity(distance: f32) -> f32 {
    1.0 / (1.0 + distance)
}

impl RewardModel for NearestState {
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score> {
        let score = |encoded: &Encoded| {
            let distances = self.distances(encoded.trajectory.observations());
            Score {
                iteration,
                lane: encoded.key.lane,
                episode: encoded.key.episode,
                model_version: 0,
                rewards: distances[1..].iter().map(|distance| -distance).collect(),
                proximity: distances.iter().copied().map(proximity).collect(),
                uncertainty: vec![0.0; distances.len()],
            }
        };
        self.threads.install(|| batch.par_iter().map(score).collect())
    }

    fn estimate(&self, observations: &[u8]) -> Result<Estimates> {
        let proximity: Vec<f32> = self.distances(observations).into_iter().map(proximity).collect();
        let uncertainty = vec![0.0; proximity.len()];
        Ok(Estimates { proximity, uncertainty, ..Estimates::default() })
    }

    fn sha256(&self) -> String {
        digest::sha256([&self.demonstrated])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{config, place, walk};
    use protocol::trajectory::Source;

    fn model(threads: usize) -> NearestState {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let shown = [walk(0.0, Source::Demonstration)];
        NearestState::new(ObservationSpec::Vector { len: 2 }, &config(), &shown, threads)
    }

    #[test]
    fn a_step_earns_minus_the_distance_from_the_nearest_demonstrated_state() {
        let batch = [0.0, 0.5].map(|row| Encoded::encode(walk(row, Source::Training)));
        let [near, far] = model(1).score(3, &batch).try_into().unwrap();
        assert_eq!(near.rewards, [0.0; 10]);
        assert!(near.proximity.iter().all(|&number| number == 1.0));
        // Half a row away in one of two numbers.
        let expected = -0.125_f32.sqrt();
        assert!(far.rewards.iter().all(|reward| (reward - expected).abs() < 1e-6), "{far:?}");
        assert_eq!((far.iteration, far.uncertainty.len()), (3, 11));
        assert_eq!(model(3).score(3, &batch), [near, far], "threads change no bit");
    }

    #[test]
    fn cells_differ_by_their_share() {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let observation = ObservationSpec::Cells { height: 2, width: 2, classes: 4 };
        let shown = Trajectory {
            steps: 1,
            cells: vec![0, 1, 2, 3, 0, 0, 0, 0].into(),
            ..Trajectory::default()
        };
        let model = NearestState::new(observation, &config(), &[shown], threads);
        assert_eq!(model.distances(&[0, 1, 2, 3, 0, 0, 3, 3, 3, 3, 3, 3]), [0.0, 0.5, 0.75]);
    }

    #[test]
    fn any_state_can_be_asked_for() {
        let estimates = model(1).estimate(&place(0.5, 0.0)).unwrap();
        assert_eq!((estimates.proximity, estimates.uncertainty), (vec![1.0], vec![0.0]));
    }
}
