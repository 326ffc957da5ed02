//! One episode: an environment, and the policy or expert that acts in it, give one trajectory.

use anyhow::{Context, Result};
use bytes::Bytes;
use environments::{Environment, EnvironmentError};
use protocol::ending::Ending;
use protocol::seed::{self, Stream};
use protocol::task::{ActionSpec, ObservationSpec, Spec};
use protocol::trajectory::{Source, Trajectory};

/// The identity of an episode. Together with the policy's weights it determines every byte of the trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeName {
    /// Who acts, and for what purpose.
    pub source: Source,
    /// Rollout it belongs to.
    pub iteration: u64,
    /// Environment stream.
    pub lane: u64,
    /// Number within the lane.
    pub episode: u64,
    /// Version of the policy that acts; 0 for an expert.
    pub policy_version: u64,
    /// Seed of the run.
    pub run_seed: u64,
}

impl EpisodeName {
    /// Returns the identity of a recorded episode.
    ///
    /// # Errors
    /// When nobody is known to act for its source.
    pub(crate) fn of(recorded: &Trajectory) -> Result<EpisodeName> {
        Ok(EpisodeName {
            source: Source::try_from(recorded.source)?,
            iteration: recorded.iteration,
            lane: recorded.lane,
            episode: recorded.episode,
            policy_version: recorded.policy_version,
            run_seed: recorded.run_seed,
        })
    }

    /// Returns the random streams that the episode's start and its actions are drawn from.
    pub(crate) fn streams(&self) -> [Stream; 2] {
        let (starts, actions) = self.source.purposes();
        let stream = |purpose| seed::stream(self.run_seed, purpose, self.lane, self.episode);
        [stream(starts), stream(actions)]
    }
}

/// An episode in progress. The episodes that follow reuse its buffers.
pub struct Episode {
    environment: Box<dyn Environment>,
    task: String,
    spec: Spec,
    name: EpisodeName,
    actions: Stream,
    observations: Vec<u8>,
    taken: Vec<u8>,
    log_probs: Vec<u8>,
    rewards: Vec<u8>,
    steps_to_goal: u32,
}

impl Episode {
    /// Begins the named episode of a task.
    ///
    /// # Errors
    /// When the environment cannot be reset; the error names the lane and the episode.
    pub fn begin(
        environment: Box<dyn Environment>,
        task: &str,
        name: EpisodeName,
    ) -> Result<Episode> {
        let spec = environment.spec();
        let [_, actions] = name.streams();
        let mut episode = Episode {
            environment,
            task: task.to_owned(),
            spec,
            name,
            actions,
            observations: Vec::new(),
            taken: Vec::new(),
            log_probs: Vec::new(),
            rewards: Vec::new(),
            steps_to_goal: 0,
        };
        episode.begin_again(name)?;
        Ok(episode)
    }

    /// Begins another episode in the same environment.
    ///
    /// # Errors
    /// When the environment cannot be reset; the error names the lane and the episode.
    pub fn begin_again(&mut self, name: EpisodeName) -> Result<()> {
        let [mut starts, actions] = name.streams();
        self.name = name;
        self.actions = actions;
        self.taken.clear();
        self.log_probs.clear();
        self.rewards.clear();
        self.steps_to_goal = 0;
        self.observations.clear();
        self.observations.resize(self.spec.observation.bytes(), 0);
        self.environment
            .reset(&mut starts, &mut self.observations)
            .with_context(|| format!("lane {} episode {}: reset", name.lane, name.episode))
    }

    /// Returns the observation to act on.
    pub fn observation(&self) -> &[u8] {
        &self.observations[self.observations.len() - self.spec.observation.bytes()..]
    }

    /// Returns the random stream that this episode's actions are drawn from.
    pub fn action_stream(&mut self) -> &mut Stream {
        &mut self.actions
    }

    /// Writes the action that the task's scripted expert takes in the current state; returns false if there is none.
    ///
    /// # Errors
    /// When the script fails; the error names the lane, the episode and the step.
    pub fn expert_action(&mut self, action: &mut [u8]) -> Result<bool> {
        let acted = self.environment.expert_action(action);
        acted.with_context(|| self.place())
    }

    /// Tells the environment which action [`Episode::step`] will take next.
    ///
    /// # Errors
    /// When the environment refuses the action; the error names the lane, the episode and the step.
    pub fn announce(&mut self, action: &[u8]) -> Result<()> {
        let announced = self.environment.announce(action);
        announced.with_context(|| self.place())
    }

    /// Returns the lane, the episode and the step, for error messages.
    fn place(&self) -> String {
        let EpisodeName { lane, episode, .. } = self.name;
        format!("lane {lane} episode {episode} step {}", self.steps())
    }

    /// Takes one step. Returns the trajectory if the episode has ended. A demonstration ends at the goal, even
    /// in a task whose episodes go on there, and has no log-probabilities.
    ///
    /// # Errors
    /// When the environment refuses the action, returns what its task does not allow, or does not end the
    /// episode by the horizon; the error names the lane, the episode and the step.
    pub fn step(&mut self, action: &[u8], log_prob: Option<f32>) -> Result<Option<Trajectory>> {
        let start = self.observations.len();
        self.observations.resize(start + self.spec.observation.bytes(), 0);
        let step = self.environment.step(action, &mut self.observations[start..]);
        let step = step.with_context(|| self.place())?;
        self.taken.extend(action);
        let demonstration = self.name.source == Source::Demonstration;
        let log_prob = log_prob.filter(|_| !demonstration);
        self.log_probs.extend(log_prob.into_iter().flat_map(f32::to_le_bytes));
        self.rewards.extend(step.reward.to_le_bytes());
        if step.success && self.steps_to_goal == 0 {
            self.steps_to_goal = self.steps() as u32;
        }
        let at_goal = (demonstration && step.success).then_some(Ending::GoalReached);
        let trajectory = step.ending.or(at_goal).map(|ending| self.trajectory(ending));
        self.check(trajectory.as_ref()).with_context(|| self.place())?;
        Ok(trajectory)
    }

    /// Refuses what the learner would not accept: the lease would be granted again and give the same episode
    /// every time.
    fn check(&self, trajectory: Option<&Trajectory>) -> Result<(), EnvironmentError> {
        let raised = |words: String| Err(EnvironmentError::Raised(words));
        let (steps, horizon) = (self.steps(), self.spec.horizon_steps);
        match trajectory {
            Some(trajectory) => {
                trajectory.check(&self.spec).or_else(|error| raised(error.to_string()))
            }
            None if steps < horizon as usize => Ok(()),
            None => {
                raised(format!("expected the end of the episode after {horizon} steps at most"))
            }
        }
    }

    /// Returns the number of steps taken.
    pub fn steps(&self) -> usize {
        self.rewards.len() / 4
    }

    fn trajectory(&self, ending: Ending) -> Trajectory {
        let copy_if = |wanted: bool, bytes: &[u8]| {
            if wanted { Bytes::copy_from_slice(bytes) } else { Bytes::new() }
        };
        let grid = matches!(self.spec.observation, ObservationSpec::Cells { .. });
        let discrete = matches!(self.spec.action, ActionSpec::Discrete { .. });
        Trajectory {
            task: self.task.clone(),
            source: self.name.source as i32,
            iteration: self.name.iteration,
            lane: self.name.lane,
            episode: self.name.episode,
            policy_version: self.name.policy_version,
            run_seed: self.name.run_seed,
            steps: self.steps() as u32,
            observation_shape: self.spec.observation.shape(),
            cells: copy_if(grid, &self.observations),
            values: copy_if(!grid, &self.observations),
            discrete_actions: copy_if(discrete, &self.taken),
            continuous_actions: copy_if(!discrete, &self.taken),
            log_probs: Bytes::copy_from_slice(&self.log_probs),
            environment_rewards: Bytes::copy_from_slice(&self.rewards),
            ending: ending as i32,
            success: self.steps_to_goal > 0,
            state_hash: self.environment.state_hash(),
            steps_to_goal: self.steps_to_goal,
            full_hash: 0,
        }
    }
}

/// Returns whether the episode would fail again in the same way. What an environment reports depends only on
/// seed and actions, except for [`EnvironmentError::Other`].
pub fn would_fail_again(error: &anyhow::Error) -> bool {
    error.is::<EnvironmentError>() && !is_of_no_episode(error)
}

/// Returns whether an environment has failed for a reason outside its episode, for example because its process
/// was killed.
pub(crate) fn is_of_no_episode(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(EnvironmentError::Other(_)))
}

#[cfg(test)]
mod tests {
    use environments::{Setting, Step};
    use protocol::task::write_floats;

    use super::*;

    /// An environment that observes `number` and, if `ends`, reaches the goal at its third step.
    struct Wrong {
        number: f32,
        ends: bool,
        /// Error that every step returns.
        failure: Option<EnvironmentError>,
        steps: u32,
    }

    /// An environment without a fault.
    const GOOD: Wrong = Wrong { number: 0.5, ends: true, failure: None, steps: 0 };

    impl Environment for Wrong {
        fn spec(&self) -> Spec {
            Spec {
                observation: ObservationSpec::Vector { len: 1 },
                action: ActionSpec::Discrete { count: 2 },
                horizon_steps: 5,
            }
        }

        fn setting(&self) -> Setting {
            Setting::default()
        }

        fn reset(&mut self, _: &mut Stream, _: &mut [u8]) -> Result<(), EnvironmentError> {
            self.steps = 0;
            Ok(())
        }

        fn step(&mut self, _: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError> {
            if let Some(failure) = &self.failure {
                return Err(failure.clone());
            }
            self.steps += 1;
            write_floats([self.number], observation);
            let success = self.ends && self.steps == 3;
            Ok(Step { reward: 0.0, ending: success.then_some(Ending::GoalReached), success })
        }

        fn state_hash(&self) -> u64 {
            0
        }
    }

    fn begin(environment: Wrong) -> Episode {
        let name = EpisodeName {
            source: Source::Training,
            iteration: 0,
            lane: 4,
            episode: 9,
            policy_version: 1,
            run_seed: 1,
        };
        Episode::begin(Box::new(environment), "wrong", name).unwrap()
    }

    #[test]
    fn what_its_task_cannot_have_ends_an_episode_with_words() {
        let last = |number, ends| {
            let mut episode = begin(Wrong { number, ends, ..GOOD });
            loop {
                if let Some(trajectory) = episode.step(&[0], Some(0.0)).transpose() {
                    return trajectory;
                }
            }
        };
        assert_eq!(last(0.5, true).unwrap().steps, 3);
        for (number, ends, place, words) in [
            (f32::NAN, true, "lane 4 episode 9 step 3", "finite numbers, found NaN"),
            (0.5, false, "lane 4 episode 9 step 5", "the end of the episode after 5 steps at most"),
        ] {
            let error = last(number, ends).unwrap_err();
            let said = format!("{error:#}");
            assert!(said.contains(place) && said.contains(words), "{said}");
            assert!(would_fail_again(&error), "{said}");
        }
    }

    #[test]
    fn an_episode_would_fail_again_unless_what_holds_its_environment_fails() {
        let state = EnvironmentError::StateNotFinite { part: "cube", found: f32::NAN, step: 1 };
        let action = EnvironmentError::ActionNotFinite { index: 0, found: f32::NAN };
        let gone = EnvironmentError::Other("Python ended without a word".to_owned());
        for (failure, again) in [(state, true), (action, true), (gone, false)] {
            let mut episode = begin(Wrong { failure: Some(failure), ..GOOD });
            let error = episode.step(&[0], Some(0.0)).unwrap_err();
            assert_eq!(would_fail_again(&error), again, "{error:#}");
        }
        assert!(!would_fail_again(&anyhow::anyhow!("no environment said so")));
    }
}
