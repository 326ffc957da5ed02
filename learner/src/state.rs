//! What the trainer carries from one iteration to the next, besides the policy learner's own state.
//!
//! Random streams are named, not carried (`protocol::seed`), so the two together are the complete state.

use std::collections::VecDeque;

use networks::RunningNormalizer;
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use protocol::weights::Weights;
use run::config::RolloutConfig;

use crate::ledger::LanePlan;

/// Number of training episodes that the success rate is taken over (`log_smooth_len` in the authors' code).
const SUCCESS_WINDOW: usize = 100;

/// An upper bound on counts, which no run reaches in a thousand years.
const MOST_COUNTED: u64 = 1 << 53;

/// What the trainer carries from one iteration to the next.
#[derive(Clone, Debug)]
pub struct State {
    /// Iterations finished.
    pub iteration: u64,
    /// Environment steps learned from.
    pub environment_steps: u64,
    /// Training episodes learned from.
    pub episodes: u64,
    /// Training wall time, seconds.
    pub wall_s: f64,
    /// Processor time of all processes in that time, seconds.
    pub processor_s: f64,
    /// The policy, with one update per iteration.
    pub policy: PolicyState,
    /// The policy one update older, if it still acts (with lag 1).
    pub previous_policy: Option<PolicyState>,
    /// The newest version that [`State::unpublished`] has returned.
    published: Option<u64>,
    lanes: Vec<LaneTotals>,
    successes: VecDeque<bool>,
}

/// Everything that a policy needs to act.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyState {
    /// Parameters of the networks.
    pub parameters: Vec<f32>,
    /// Normalizes observations before the networks see them; without numbers, observations are taken as they are.
    pub normalizer: RunningNormalizer,
}

impl PolicyState {
    /// Returns the policy as weights of a version that can act.
    pub fn weights(&self, version: u64) -> Weights {
        Weights::new(version, &self.parameters, &self.normalizer.to_numbers())
    }

    /// Returns whether all its parameters and moments are finite.
    pub fn is_finite(&self) -> bool {
        let moments = self.normalizer.to_numbers();
        self.parameters.iter().all(|number| number.is_finite())
            && moments.iter().all(|number| number.is_finite())
    }

    fn save(&self, name: &str, tensors: &mut Tensors) {
        tensors.put_f32(&format!("{name}.parameters"), self.parameters.iter().copied());
        tensors.put_f64(&format!("{name}.moments"), self.normalizer.to_numbers());
    }

    fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        let (parameters, moments) = (self.parameters.len(), self.normalizer.to_numbers().len());
        let read = |part: &str| format!("{name}.{part}");
        self.parameters = tensors.exactly(&read("parameters"), parameters, Tensors::f32)?;
        let numbers = tensors.exactly(&read("moments"), moments, Tensors::f64)?;
        self.normalizer = RunningNormalizer::from_numbers(&numbers);
        Ok(())
    }
}

/// Totals of a lane over its whole life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct LaneTotals {
    episodes: u64,
    steps: u64,
}

impl State {
    /// Creates the state before the first iteration.
    pub fn fresh(policy: PolicyState, rollout: &RolloutConfig) -> State {
        State {
            iteration: 0,
            environment_steps: 0,
            episodes: 0,
            wall_s: 0.0,
            processor_s: 0.0,
            previous_policy: (rollout.lag == 1).then(|| policy.clone()),
            policy,
            published: None,
            lanes: vec![LaneTotals::default(); rollout.lanes as usize],
            successes: VecDeque::with_capacity(SUCCESS_WINDOW),
        }
    }

    /// Returns the policies that may act and that no earlier call has returned, the newest last.
    pub fn unpublished(&mut self) -> Vec<Weights> {
        let newest = self.iteration;
        let previous = newest.checked_sub(1).zip(self.previous_policy.as_ref());
        let acting = previous.into_iter().chain([(newest, &self.policy)]);
        let published = self.published.replace(newest);
        let new = acting.filter(|(version, _)| Some(*version) > published);
        new.map(|(version, policy)| policy.weights(version)).collect()
    }

    /// Returns what each lane has to run: up to the first episode end at or past `lane_steps` steps per
    /// iteration, counted over the lane's whole life.
    pub fn plans(&self, iteration: u64, lane_steps: u64) -> Vec<LanePlan> {
        let plan = |lane: &LaneTotals| LanePlan {
            first_episode: lane.episodes,
            steps_owed: lane_steps.saturating_mul(iteration + 1).saturating_sub(lane.steps),
            episodes_owed: 0,
        };
        self.lanes.iter().map(plan).collect()
    }

    /// Adds the episodes of a batch to the totals of the run and of their lanes.
    pub fn count(&mut self, batch: &[Encoded]) {
        for encoded in batch {
            let trajectory = &encoded.trajectory;
            let steps = u64::from(trajectory.steps);
            let lane = &mut self.lanes[trajectory.lane as usize];
            lane.episodes += 1;
            lane.steps += steps;
            self.episodes += 1;
            self.environment_steps += steps;
            if self.successes.len() == SUCCESS_WINDOW {
                self.successes.pop_front();
            }
            self.successes.push_back(trajectory.success);
        }
    }

    /// Returns the share of the last 100 training episodes that reached the goal; 0 before the first episode. Episodes
    /// are in batch order, lane by lane, so of a batch with more than 100 episodes only those of the last lanes count.
    pub fn success_rate(&self) -> f64 {
        let reached = self.successes.iter().filter(|success| **success).count();
        reached as f64 / self.successes.len().max(1) as f64
    }

    /// Adds the state to `tensors`.
    pub fn save(&self, tensors: &mut Tensors) {
        let counts = [self.iteration, self.environment_steps, self.episodes];
        tensors.put_u64("counts", counts);
        tensors.put_f64("seconds", [self.wall_s, self.processor_s]);
        self.policy.save("policy", tensors);
        if let Some(previous) = &self.previous_policy {
            previous.save("previous_policy", tensors);
        }
        tensors.put_u64("lanes.episodes", self.lanes.iter().map(|lane| lane.episodes));
        tensors.put_u64("lanes.steps", self.lanes.iter().map(|lane| lane.steps));
        tensors.put_u8("successes", self.successes.iter().map(|success| u8::from(*success)));
    }

    /// Restores what [`State::save`] added. Without lag, a saved previous policy is ignored.
    ///
    /// # Errors
    /// When the arrays do not have these shapes, or hold impossible values.
    pub fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        let counts = countable("counts", tensors.exactly("counts", 3, Tensors::u64)?)?;
        [self.iteration, self.environment_steps, self.episodes] = [counts[0], counts[1], counts[2]];
        let seconds = tensors.exactly("seconds", 2, Tensors::f64)?;
        if let Some(found) = seconds.iter().find(|time| !(time.is_finite() && **time >= 0.0)) {
            return Err(format!("array `seconds`: expected times, found {found}"));
        }
        [self.wall_s, self.processor_s] = [seconds[0], seconds[1]];
        self.policy.restore("policy", tensors)?;
        if let Some(previous) = &mut self.previous_policy {
            previous.restore("previous_policy", tensors)?;
        }
        let lane_numbers =
            |name| countable(name, tensors.exactly(name, self.lanes.len(), Tensors::u64)?);
        let lanes = lane_numbers("lanes.episodes")?.into_iter().zip(lane_numbers("lanes.steps")?);
        self.lanes = lanes.map(|(episodes, steps)| LaneTotals { episodes, steps }).collect();
        let successes = tensors.u8("successes")?;
        if successes.len() > SUCCESS_WINDOW {
            let found = successes.len();
            return Err(format!(
                "array `successes`: expected at most {SUCCESS_WINDOW}, found {found}"
            ));
        }
        self.successes = successes.into_iter().map(|byte| byte == 1).collect();
        Ok(())
    }
}

/// Checks that a run can reach these counts, so that no sum of them overflows.
fn countable(name: &str, counts: Vec<u64>) -> Result<Vec<u64>, String> {
    match counts.iter().find(|count| **count > MOST_COUNTED) {
        Some(found) => Err(format!("array `{name}`: expected counts, found {found}")),
        None => Ok(counts),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::trajectory::Trajectory;

    fn fresh(lag: u64) -> State {
        let normalizer = RunningNormalizer::new(1);
        let policy = PolicyState { parameters: vec![0.0, 0.0], normalizer };
        State::fresh(policy, &RolloutConfig { lanes: 2, lane_steps: 10, lag })
    }

    fn episode(lane: u64, steps: u32, success: bool) -> Encoded {
        Encoded::encode(Trajectory { lane, steps, success, ..Trajectory::default() })
    }

    #[test]
    fn a_lane_owes_what_all_its_steps_lack() {
        let mut state = fresh(0);
        state.count(&[episode(0, 7, true), episode(0, 9, false), episode(1, 25, true)]);
        let owed = |iteration| {
            let plans = state.plans(iteration, 10);
            plans.iter().map(|plan| (plan.first_episode, plan.steps_owed)).collect::<Vec<_>>()
        };
        assert_eq!([owed(1), owed(2)], [[(2, 4), (1, 0)], [(2, 14), (1, 5)]]);
        assert_eq!((state.episodes, state.environment_steps), (3, 41));
    }

    #[test]
    fn success_is_that_of_the_last_hundred_episodes() {
        let mut state = fresh(0);
        assert_eq!(state.success_rate(), 0.0);
        state.count(&vec![episode(0, 1, true); 30]);
        assert_eq!(state.success_rate(), 1.0);
        state.count(&vec![episode(1, 1, false); 30]);
        assert_eq!(state.success_rate(), 0.5);
        state.count(&vec![episode(1, 1, false); 50]);
        assert_eq!(state.success_rate(), 0.2, "ten of the thirty are too long ago");
    }

    /// Returns what a run saves after some iterations, and the state that it continues with.
    fn saved(lag: u64) -> (Tensors, State) {
        let mut state = fresh(lag);
        state.iteration = 3;
        state.policy.parameters = vec![3.0, 4.0];
        if let Some(previous) = &mut state.previous_policy {
            previous.parameters = vec![1.0, 2.0];
        }
        let mut tensors = Tensors::default();
        state.save(&mut tensors);
        (tensors, state)
    }

    #[test]
    fn the_policy_before_is_saved_where_it_still_acts() {
        for lag in [0, 1] {
            let (tensors, state) = saved(lag);
            for part in ["parameters", "moments"] {
                assert_eq!(tensors.has(&format!("previous_policy.{part}")), lag == 1);
            }
            let mut restored = fresh(lag);
            restored.restore(&tensors).unwrap();
            assert_eq!(restored.policy, state.policy);
            assert_eq!(restored.previous_policy, state.previous_policy);
        }
    }

    #[test]
    fn each_policy_is_published_once_and_a_resumed_run_begins_with_those_that_act() {
        let published = |state: &mut State| -> Vec<u64> {
            state.unpublished().iter().map(|weights| weights.version).collect()
        };
        for (lag, acting) in [(0, &[3][..]), (1, &[2, 3][..])] {
            let mut state = fresh(lag);
            for iteration in 0..3 {
                state.iteration = iteration;
                assert_eq!(published(&mut state), [iteration]);
            }
            let mut resumed = fresh(lag);
            resumed.restore(&saved(lag).0).unwrap();
            assert_eq!(published(&mut resumed), acting);
            resumed.iteration += 1;
            assert_eq!(published(&mut resumed), [4]);
        }
    }

    #[test]
    fn a_policy_that_nobody_acts_by_is_left_alone_and_one_that_acts_is_needed() {
        let mut restored = fresh(0);
        restored.restore(&saved(1).0).unwrap();
        assert_eq!((restored.policy.parameters, restored.previous_policy), (vec![3.0, 4.0], None));
        let refused = fresh(1).restore(&saved(0).0).unwrap_err();
        assert!(refused.contains("`previous_policy.parameters`"), "{refused}");
    }
}
