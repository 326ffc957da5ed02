//! Goal proximity: an ensemble that regresses how close an observation is to the goal (Eqs. 1, 4, 5).

use networks::{Squashing, squared_error};
use protocol::seed::{self, Purpose};
use protocol::trajectory::Trajectory;
use rand::seq::SliceRandom;
use run::config::RewardConfig;

use super::input::Input;
use super::minibatch::{Losses, Minibatch, Positions};
use super::objective::{Objective, Sampler};

/// Regression on proximity labels.
#[derive(Clone, Debug, PartialEq)]
pub struct GoalProximity {
    /// Labels of the demonstrations' rows, in [0, 1].
    targets: Vec<f32>,
    /// Weight of the second term of Eq. 4.
    agent_weight: f32,
}

impl Objective for GoalProximity {
    const SQUASHING: Squashing = Squashing::ClampedMean;

    /// Labels every row (Eq. 1); the last row of a demonstration is at the goal.
    fn new(config: &RewardConfig, input: &Input, demonstrations: &[Trajectory]) -> Self {
        let label = |steps_to_goal| config.label(steps_to_goal) as f32;
        let labels = |trajectory: &Trajectory| {
            let rows = input.places(trajectory.steps as usize) as u32;
            (0..rows).rev().map(label).collect::<Vec<_>>()
        };
        GoalProximity {
            targets: demonstrations.iter().flat_map(labels).collect(),
            agent_weight: config.agent_weight as f32,
        }
    }

    fn offline(&self, sampler: &Sampler<'_>) -> Vec<Positions> {
        let mut order: Vec<usize> = (0..sampler.demonstrations).collect();
        let mut minibatches = Vec::new();
        for epoch in 0..sampler.config.pretraining_epochs {
            let purpose = Purpose::PretrainingBatches;
            order.shuffle(&mut seed::stream(sampler.run_seed, purpose, epoch, 0));
            let positions = order.chunks_exact(sampler.config.batch);
            minibatches.extend(
                positions.map(|own| Positions { demonstrations: own.to_vec(), agent: Vec::new() }),
            );
        }
        minibatches
    }

    /// Computes Eq. 4, or Eq. 1 without rows of the agent: the mean of `(f(s) - label)^2` over the demonstrated states,
    /// and `agent_weight` times the mean of `f(s)^2` over the agent's.
    fn losses(&self, minibatch: &Minibatch, outputs: &[f32], gradients: &mut [f32]) -> Losses {
        let Positions { demonstrations, agent } = &minibatch.positions;
        let targets: Vec<f32> = demonstrations.iter().map(|&at| self.targets[at]).collect();
        let (own, others) = outputs.split_at(demonstrations.len());
        let (own_gradients, other_gradients) = gradients.split_at_mut(demonstrations.len());
        let weight = |rows: &[f32]| 1.0 / rows.len().max(1) as f32;
        let agent_targets = vec![0.0; agent.len()];
        let agent_weight = self.agent_weight * weight(others);
        Losses {
            demonstrations: squared_error(own, &targets, weight(own), own_gradients),
            agent: squared_error(others, &agent_targets, agent_weight, other_gradients),
        }
    }
}
