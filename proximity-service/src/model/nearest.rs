//! The nearest demonstrated state: a step earns minus the distance from the state it reaches to the nearest
//! demonstrated state. Nothing is trained. The reward is for being where the expert was, not for coming closer to
//! the goal. With segments (segment matching, arXiv 2506.06793), an episode and each demonstration are divided into
//! the same number of parts, each by its own length. The nearest state is searched for in the part with the same
//! number, so that being where the expert began costs the distance to its last states at the end.

use anyhow::Result;
use networks::RunningNormalizer;
use protocol::digest;
use protocol::messages::{Estimates, Score};
use protocol::task::{ObservationSpec, Spec, floats};
use protocol::trajectory::{Encoded, Trajectory};
use rayon::prelude::*;
use run::config::{RewardConfig, RunConfig};
use run::folder::RunFolder;

use super::RewardModel;
use super::threads::threads;

/// The states of the demonstrations.
pub struct NearestState {
    observation: ObservationSpec,
    config: RewardConfig,
    normalizer: RunningNormalizer,
    /// Normalized states of each segment, one after another.
    demonstrated: Vec<Vec<u8>>,
    threads: rayon::ThreadPool,
}

impl NearestState {
    pub(super) fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Box<dyn RewardModel>> {
        let demonstrations = run::origin::load_demonstrations(folder, config)?;
        let spec = config.task.spec();
        Ok(Box::new(Self::new(&spec, &config.reward, &demonstrations, threads(config)?)))
    }

    /// Creates the model from demonstrations.
    pub fn new(
        spec: &Spec,
        config: &RewardConfig,
        demonstrations: &[Trajectory],
        threads: rayon::ThreadPool,
    ) -> NearestState {
        let observation = spec.observation;
        let mut demonstrated = vec![Vec::new(); config.segments];
        for states in demonstrations.iter().map(Trajectory::observations) {
            let steps = states.len() / observation.bytes() - 1;
            for (step, state) in states.chunks_exact(observation.bytes()).enumerate() {
                demonstrated[config.segment(step, steps)].extend(state);
            }
        }
        let normalizer = RunningNormalizer::of_demonstrations(
            observation.normalized(config.normalize_observations),
            demonstrations.iter().map(Trajectory::observations),
        );
        for states in &mut demonstrated {
            normalizer.normalize(states);
        }
        let config = config.clone();
        NearestState { observation, config, normalizer, demonstrated, threads }
    }

    /// Returns the distance of each observation of an episode to the nearest state in its segment: the share of
    /// cells that differ, or the root mean square of the differences of the numbers.
    fn distances(&self, observations: &[u8]) -> Vec<f32> {
        let states = observations.chunks_exact(self.observation.bytes());
        let steps = states.len() - 1;
        let of_step = |step| &self.demonstrated[self.config.segment(step, steps)];
        states.enumerate().map(|(step, state)| self.nearest(state, of_step(step))).collect()
    }

    /// Returns the distance to the nearest of some states.
    fn nearest(&self, state: &[u8], others: &[u8]) -> f32 {
        let mut state = state.to_vec();
        self.normalizer.normalize(&mut state);
        let others = others.chunks_exact(self.observation.bytes());
        others.map(|other| self.distance(&state, other)).fold(f32::INFINITY, f32::min)
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

/// Converts a distance to a proximity, which is 1 at a demonstrated state and falls with the distance.
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

    /// Compares each state with those of all segments, since a single state belongs to no segment.
    fn estimate(&self, observations: &[u8]) -> Result<Estimates> {
        let states = observations.par_chunks_exact(self.observation.bytes());
        let nearest = |state: &[u8]| {
            let distances = self.demonstrated.iter().map(|others| self.nearest(state, others));
            proximity(distances.fold(f32::INFINITY, f32::min))
        };
        let proximity: Vec<f32> = self.threads.install(|| states.map(nearest).collect());
        let uncertainty = vec![0.0; proximity.len()];
        Ok(Estimates { proximity, uncertainty, ..Estimates::default() })
    }

    fn sha256(&self) -> String {
        digest::sha256(&self.demonstrated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{CORRIDOR, config, place, walk};
    use protocol::task::ActionSpec;
    use protocol::trajectory::Source;

    fn model(threads: usize) -> NearestState {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let shown = [walk(0.0, Source::Demonstration)];
        NearestState::new(&CORRIDOR, &config(), &shown, threads)
    }

    #[test]
    fn a_state_is_compared_to_its_segment_alone() {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let shown = [walk(0.0, Source::Demonstration)];
        let config = RewardConfig { segments: 11, ..config() };
        let model = NearestState::new(&CORRIDOR, &config, &shown, threads);
        let walked = walk(0.0, Source::Training);
        assert_eq!(model.distances(walked.observations()), [0.0; 11]);
        let stands = place(0.0, 0.0).repeat(11);
        let distances = model.distances(&stands);
        assert!(distances.is_sorted() && (distances[10] - 0.5_f32.sqrt()).abs() < 1e-6);
        assert_eq!(model.estimate(&stands).unwrap().proximity, [1.0; 11]);
        // The last of six states is in the tenth of eleven parts.
        let of_few = model.distances(&place(0.0, 0.0).repeat(6));
        assert!((of_few[5] - 0.9 * 0.5_f32.sqrt()).abs() < 1e-6, "{of_few:?}");
    }

    #[test]
    fn a_demonstration_that_does_not_say_when_it_reached_the_goal_is_whole() {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let shown = Trajectory { steps_to_goal: 0, ..walk(0.0, Source::Demonstration) };
        assert!(shown.success);
        let model = NearestState::new(&CORRIDOR, &config(), &[shown], threads);
        assert_eq!(model.distances(walk(0.0, Source::Training).observations()), [0.0; 11]);
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
        let action = ActionSpec::Discrete { count: 2 };
        let spec = Spec { observation, action, horizon_steps: 2 };
        let model = NearestState::new(&spec, &config(), &[shown], threads);
        assert_eq!(model.distances(&[0, 1, 2, 3, 0, 0, 3, 3, 3, 3, 3, 3]), [0.0, 0.5, 0.75]);
    }

    #[test]
    fn any_state_can_be_asked_for() {
        let estimates = model(1).estimate(&place(0.5, 0.0)).unwrap();
        assert_eq!((estimates.proximity, estimates.uncertainty), (vec![1.0], vec![0.0]));
    }
}
