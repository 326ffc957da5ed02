//! Discriminators: logistic regression on whether a state (GAIfO-s), a transition (GAIfO) or a state and action
//! (GAIL) is the expert's (Section 4.1, baselines).
//!
//! As in all our ensembles, each member is trained on its own, on shared minibatches unless bootstrapped. The
//! authors train the mean of five logits with one loss.

use networks::{RowScore, Squashing, binary_cross_entropy};
use protocol::trajectory::Trajectory;
use run::config::{RewardConfig, RewardInput};

use super::input::Input;
use super::minibatch::{Losses, Minibatch, Positions};
use super::objective::{EpisodeView, Objective, Sampler};
use crate::reward::step_rewards;

/// Logistic regression with label 1 for the expert's rows and 0 for the agent's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Discriminator;

impl Objective for Discriminator {
    /// The proximity is the probability that a row is the expert's.
    const SQUASHING: Squashing = Squashing::SigmoidOfMean;

    fn new(_config: &RewardConfig, _input: &Input, _demonstrations: &[Trajectory]) -> Self {
        Discriminator
    }

    /// Appends one row per step. A demonstration's last state, which is at the goal, is thus among the states that
    /// steps reach and not among those in which they act.
    fn append_training_rows(&self, input: &Input, seen: EpisodeView<'_>, rows: &mut Vec<u8>) {
        input.append_steps(seen.observations, seen.actions, rows);
    }

    /// Appends one row per step, or one per observation if a row is a single state. All observations are shown with
    /// their scores, although the steps act in all but the last and reach all but the first.
    fn append_scored_rows(&self, input: &Input, seen: EpisodeView<'_>, rows: &mut Vec<u8>) {
        if input.sees().is_single_state() {
            rows.extend(seen.observations);
        } else {
            input.append_steps(seen.observations, seen.actions, rows);
        }
    }

    /// Returns nothing: without an agent there is nothing to discriminate.
    fn offline(&self, _sampler: &Sampler<'_>) -> Vec<Positions> {
        Vec::new()
    }

    /// Computes the mean loss over the expert's rows and over the agent's; their sum is twice the mean over both.
    fn losses(&self, minibatch: &Minibatch, outputs: &[f32], gradients: &mut [f32]) -> Losses {
        let count = minibatch.positions.demonstrations.len();
        let (own, agent) = outputs.split_at(count);
        let (own_gradients, agent_gradients) = gradients.split_at_mut(count);
        let weight = |rows: &[f32]| 1.0 / rows.len().max(1) as f32;
        Losses {
            demonstrations: binary_cross_entropy(own, 1.0, weight(own), own_gradients),
            agent: binary_cross_entropy(agent, 0.0, weight(agent), agent_gradients),
        }
    }

    /// Rewards each step for the state in which it acts, for the one it reaches, or for its own row.
    fn rewards(&self, rows: &[RowScore], steps: usize, config: &RewardConfig) -> Vec<f32> {
        let first = usize::from(config.input == RewardInput::NextState);
        step_rewards(&rows[first..first + steps], config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Learned, RewardModel};
    use crate::tests::{assert_reproducible, config, learned, place, pretrained, walk, walk_back};
    use protocol::trajectory::{Encoded, Source};
    use run::config::RewardForm;

    const INPUTS: [RewardInput; 4] = [
        RewardInput::State,
        RewardInput::NextState,
        RewardInput::Transition,
        RewardInput::StateAction,
    ];

    /// Returns the configuration of a single discriminator.
    fn of(input: RewardInput) -> RewardConfig {
        RewardConfig {
            input,
            form: RewardForm::Airl,
            uncertainty: 0.0,
            ensemble: 1,
            learning_rate: 0.01,
            batch: 2,
            samples: 40,
            ..config()
        }
    }

    /// Trains on the agent's episode in a hundred updates, then scores it and the expert's walk. Returns the mean
    /// rewards of both, and the model.
    fn rewards_of(config: &RewardConfig, agents: Trajectory) -> ([f32; 2], Learned<Discriminator>) {
        let batch = [agents, walk(0.0, Source::Training)].map(Encoded::encode);
        let mut model: Learned<Discriminator> = learned(config, 2);
        assert_eq!(pretrained(&mut model).gradient_steps, 0);
        for iteration in 0..100 {
            let update = model.improve(iteration, &batch[..1]).unwrap();
            assert_eq!(update.gradient_steps, 5);
        }
        let scores = model.score(100, &batch);
        let mean = |at: usize| scores[at].rewards.iter().sum::<f32>() / 10.0;
        ([mean(0), mean(1)], model)
    }

    #[test]
    fn states_of_the_expert_earn_more() {
        let (rewards, model) = rewards_of(&of(RewardInput::State), walk(1.0, Source::Training));
        assert!(rewards[1] > 1.0 && rewards[0] < -1.0, "{rewards:?}");
        let [expert, agent] = [0.0, 1.0].map(|row| model.estimate(&place(0.5, row)).unwrap());
        assert!(expert.proximity[0] > 0.7 && agent.proximity[0] < 0.3, "{expert:?} {agent:?}");
        let score = &model.score(0, &[Encoded::encode(walk(1.0, Source::Training))])[0];
        assert_eq!((score.rewards.len(), score.proximity.len()), (10, 11));
    }

    #[test]
    fn a_step_is_rewarded_for_the_state_in_which_it_acts_or_for_the_one_it_reaches() {
        for (input, first) in [(RewardInput::State, 0), (RewardInput::NextState, 1)] {
            let (rewards, model) = rewards_of(&of(input), walk(1.0, Source::Training));
            assert!(rewards[1] > 1.0 && rewards[0] < -1.0, "{input}: {rewards:?}");
            let score = &model.score(0, &[Encoded::encode(walk(0.0, Source::Training))])[0];
            assert_eq!((score.rewards.len(), score.proximity.len()), (10, 11));
            for (reward, proximity) in score.rewards.iter().zip(&score.proximity[first..]) {
                let logit = libm::logf(proximity / (1.0 - proximity));
                assert!((reward - logit).abs() < 1e-4, "{input}: {reward} and {logit}");
            }
        }
    }

    #[test]
    fn transitions_tell_which_way_the_agent_walks_where_states_do_not() {
        let back = walk_back(0.0, Source::Training);
        let (blind, _) = rewards_of(&of(RewardInput::State), back.clone());
        let (seeing, model) = rewards_of(&of(RewardInput::Transition), back);
        assert!((blind[1] - blind[0]).abs() < 0.3, "{blind:?}");
        assert!(seeing[1] > seeing[0] + 1.0, "{seeing:?}");
        let message = model.estimate(&place(0.5, 0.0)).unwrap_err().to_string();
        assert!(message.contains("single states") && message.contains("transitions"), "{message}");
    }

    #[test]
    fn actions_tell_the_agent_where_states_and_transitions_do_not() {
        let mut agents = walk(0.0, Source::Training);
        agents.discrete_actions = vec![1; 10].into();
        let (blind, _) = rewards_of(&of(RewardInput::Transition), agents.clone());
        let (seeing, _) = rewards_of(&of(RewardInput::StateAction), agents);
        assert_eq!(blind[0], blind[1]);
        assert!(seeing[1] > seeing[0] + 1.0, "{seeing:?}");
    }

    #[test]
    fn threads_change_no_bit_and_a_restored_model_goes_on_alike() {
        for input in INPUTS {
            let penalty = RewardConfig { gradient_penalty: 1.0, ensemble: 3, ..of(input) };
            assert_reproducible::<Discriminator>(&penalty);
        }
    }

    #[test]
    fn the_penalty_pulls_the_norm_of_the_gradient_towards_one() {
        let norm = |gradient_penalty: f64| {
            let config = RewardConfig { gradient_penalty, ..of(RewardInput::State) };
            let (_, model) = rewards_of(&config, walk(1.0, Source::Training));
            let logit = |at: f32, row: f32| {
                let proximity = model.estimate(&place(at, row)).unwrap().proximity[0];
                libm::logf(proximity / (1.0 - proximity))
            };
            let along = (logit(0.55, 0.5) - logit(0.45, 0.5)) / 0.1;
            libm::hypotf(along, (logit(0.5, 0.55) - logit(0.5, 0.45)) / 0.1)
        };
        let (free, penalized) = (norm(0.0), norm(10.0));
        assert!(free > 3.0 && (penalized - 1.0).abs() < 0.2, "{free} without, {penalized} with");
    }

    #[test]
    fn an_uncertain_row_earns_less() {
        let config = RewardConfig { uncertainty: 0.5, ensemble: 4, ..of(RewardInput::State) };
        let (_, model) = rewards_of(&config, walk(1.0, Source::Training));
        let score = &model.score(0, &[Encoded::encode(walk(0.0, Source::Training))])[0];
        for ((reward, proximity), uncertainty) in
            score.rewards.iter().zip(&score.proximity).zip(&score.uncertainty)
        {
            let logit = libm::logf(proximity / (1.0 - proximity));
            assert!(*uncertainty > 0.0 && (reward - (logit - 0.5 * uncertainty)).abs() < 1e-4);
        }
    }
}
