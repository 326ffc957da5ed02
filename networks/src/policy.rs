//! Actor and critic for a task (Appendix G.2), which policy learners train and actors act by.
//!
//! Over cells, actor and critic are two heads of one network unless `shared_trunk` is off; over vectors they are
//! two networks. A continuous policy has one additional parameter for each action component, the logarithm of its
//! standard deviation, which does not depend on the observation. In a squashed policy the actor outputs it instead.

use nalgebra::DMatrix;
use protocol::seed::Stream;
use protocol::task::{ActionSpec, ObservationSpec};

use crate::batch::{Batch, RowSize};
use crate::distribution::Distribution;
use crate::initialization::Initialization;
use crate::layer::reshape;
use crate::network::{Network, Prepared, Workspace};
use crate::shape::{Head, NetworkShape, PolicyArchitecture};

/// A policy and its value function; their parameters are one flat slice kept elsewhere.
#[derive(Clone, Debug)]
pub struct ActorCritic {
    /// One network with both heads, or the actor and then the critic.
    networks: Vec<Network>,
    distribution: Distribution,
    /// Number of outputs of the actor's head.
    actor_outputs: usize,
    /// Number of logarithms of standard deviations at the end of the parameters.
    log_standard_deviations: usize,
}

/// One version of an [`ActorCritic`]'s parameters, packed for evaluation and shared by threads.
#[derive(Clone, Debug, Default)]
pub struct PreparedPolicy {
    networks: Vec<Prepared>,
    log_standard_deviations: Vec<f32>,
}

/// Memory of one thread for evaluating an [`ActorCritic`], reused from batch to batch.
#[derive(Clone, Debug)]
pub struct PolicyWorkspace {
    networks: [Workspace; 2],
    parameters: DMatrix<f32>,
    values: DMatrix<f32>,
    gradients: DMatrix<f32>,
}

impl Default for PolicyWorkspace {
    fn default() -> Self {
        let [parameters, values, gradients] = [(); 3].map(|()| DMatrix::zeros(0, 0));
        Self { networks: Default::default(), parameters, values, gradients }
    }
}

/// Outputs of an [`ActorCritic`] for a batch.
#[derive(Clone, Copy, Debug)]
pub struct Evaluation<'w> {
    /// Parameters of the action distribution, `parameter_count x rows` (see [`Distribution`]).
    pub parameters: &'w DMatrix<f32>,
    /// Values of the observations, `1 x rows`.
    pub values: &'w DMatrix<f32>,
}

impl ActorCritic {
    /// Lays out the networks for a task's observations and actions.
    pub fn new(
        observation: ObservationSpec,
        action: ActionSpec,
        architecture: &PolicyArchitecture,
    ) -> Self {
        let distribution = Distribution::new(action, architecture.squashed);
        let outputs = distribution.parameter_count();
        let (actor_outputs, actor_gain, log_standard_deviations) = match distribution {
            Distribution::Categorical { .. } | Distribution::SquashedGaussian { .. } => {
                (outputs, 0.01, 0)
            }
            Distribution::Gaussian { len } => (len, 1.0, len),
        };
        let head = |outputs, gain| {
            let initialization = Initialization::Orthogonal(gain);
            Head { outputs, initialization }
        };
        let actor = head(actor_outputs, actor_gain);
        let critic = head(1, std::f64::consts::SQRT_2);
        let (shared, hidden) = match observation {
            ObservationSpec::Cells { .. } => (architecture.shared_trunk, Vec::new()),
            ObservationSpec::Vector { .. } => (false, architecture.hidden.clone()),
        };
        let network = |heads: Vec<Head>| {
            Network::new(NetworkShape {
                observation,
                frames: architecture.frames,
                extra_inputs: 0,
                cells: architecture.cells.clone(),
                hidden: hidden.clone(),
                activation: architecture.activation,
                hidden_initialization: Initialization::Orthogonal(std::f64::consts::SQRT_2),
                heads,
            })
        };
        let networks = if shared {
            vec![network(vec![actor, critic])]
        } else {
            vec![network(vec![actor]), network(vec![critic])]
        };
        Self { networks, distribution, actor_outputs, log_standard_deviations }
    }

    /// Returns the distribution that actions are drawn from.
    pub fn distribution(&self) -> Distribution {
        self.distribution
    }

    /// Returns the network that contains the actor, and the number of its outputs that belong to the actor. The
    /// actor's outputs come first, and so do this network's parameters.
    pub fn actor(&self) -> (&Network, usize) {
        (&self.networks[0], self.actor_outputs)
    }

    /// Returns the size of a row of the batches that the policy is evaluated on.
    pub fn row_size(&self) -> RowSize {
        self.networks[0].row_size()
    }

    /// Returns the length of the flat parameters: networks in order, then logarithms of standard deviations.
    pub fn parameter_count(&self) -> usize {
        let counts = self.networks.iter().map(Network::parameter_count);
        counts.sum::<usize>() + self.log_standard_deviations
    }

    /// Draws initial parameters; state-independent standard deviations start at one.
    pub fn initial_parameters(&self, stream: &mut Stream) -> Vec<f32> {
        let networks = self.networks.iter();
        let mut parameters: Vec<f32> =
            networks.flat_map(|network| network.initial_parameters(stream)).collect();
        parameters.resize(self.parameter_count(), 0.0);
        parameters
    }

    /// Scales the actor's outputs by a factor, by scaling the parameters of its output layer.
    ///
    /// # Panics
    /// If their number is not [`ActorCritic::parameter_count`].
    pub fn scale_actor(&self, parameters: &mut [f32], factor: f32) {
        assert_eq!(parameters.len(), self.parameter_count(), "parameters of this policy");
        let actor = &self.networks[0];
        let last = actor.parameter_ranges().last().expect("there is an output layer").clone();
        for row in parameters[last].chunks_exact_mut(actor.outputs()) {
            row[..self.actor_outputs].iter_mut().for_each(|number| *number *= factor);
        }
    }

    /// Packs a version of the parameters for evaluation.
    ///
    /// # Panics
    /// If their number is not [`ActorCritic::parameter_count`].
    pub fn prepare(&self, parameters: &[f32]) -> PreparedPolicy {
        let mut prepared = PreparedPolicy::default();
        self.prepare_into(parameters, &mut prepared);
        prepared
    }

    /// Packs a version of the parameters into the memory of an earlier one.
    ///
    /// # Panics
    /// If their number is not [`ActorCritic::parameter_count`].
    pub fn prepare_into(&self, parameters: &[f32], prepared: &mut PreparedPolicy) {
        assert_eq!(parameters.len(), self.parameter_count(), "parameters of this policy");
        prepared.networks.resize_with(self.networks.len(), Prepared::default);
        let mut rest = parameters;
        for (network, prepared) in self.networks.iter().zip(&mut prepared.networks) {
            let (own, further) = rest.split_at(network.parameter_count());
            network.prepare_into(own, prepared);
            rest = further;
        }
        prepared.log_standard_deviations.clear();
        prepared.log_standard_deviations.extend_from_slice(rest);
    }

    /// Computes only the action parameters, `parameter_count x rows`, which is enough for acting.
    ///
    /// # Panics
    /// As [`Network::forward`].
    pub fn act<'w>(
        &self,
        prepared: &PreparedPolicy,
        batch: Batch<'_>,
        workspace: &'w mut PolicyWorkspace,
    ) -> &'w DMatrix<f32> {
        let PolicyWorkspace { networks, parameters, .. } = workspace;
        let outputs = self.networks[0].forward(&prepared.networks[0], batch, &mut networks[0]);
        reshape(parameters, self.actor_outputs + self.log_standard_deviations, outputs.ncols());
        for (mut to, from) in parameters.column_iter_mut().zip(outputs.column_iter()) {
            to.iter_mut()
                .zip(from.iter().take(self.actor_outputs))
                .for_each(|(to, from)| *to = *from);
            let log_standard_deviations = to.iter_mut().skip(self.actor_outputs);
            log_standard_deviations
                .zip(&prepared.log_standard_deviations)
                .for_each(|(to, from)| *to = *from);
        }
        parameters
    }

    /// Computes the action parameters and values of a batch.
    ///
    /// # Panics
    /// As [`Network::forward`].
    pub fn forward<'w>(
        &self,
        prepared: &PreparedPolicy,
        batch: Batch<'_>,
        workspace: &'w mut PolicyWorkspace,
    ) -> Evaluation<'w> {
        self.act(prepared, batch, workspace);
        self.criticize(prepared, batch, workspace);
        let PolicyWorkspace { parameters, values, .. } = workspace;
        Evaluation { parameters, values }
    }

    /// Computes only the values, `1 x rows`.
    ///
    /// # Panics
    /// As [`Network::forward`].
    pub fn values<'w>(
        &self,
        prepared: &PreparedPolicy,
        batch: Batch<'_>,
        workspace: &'w mut PolicyWorkspace,
    ) -> &'w DMatrix<f32> {
        if let [shared] = &self.networks[..] {
            shared.forward(&prepared.networks[0], batch, &mut workspace.networks[0]);
        }
        self.criticize(prepared, batch, workspace);
        &workspace.values
    }

    /// Computes the values with the critic, or takes them from the outputs of the shared network.
    fn criticize(
        &self,
        prepared: &PreparedPolicy,
        batch: Batch<'_>,
        workspace: &mut PolicyWorkspace,
    ) {
        let PolicyWorkspace { networks: [first, second], values, .. } = workspace;
        let source = match (&self.networks[..], &prepared.networks[..]) {
            ([_, critic], [_, prepared]) => critic.forward(prepared, batch, second),
            _ => first.outputs(),
        };
        reshape(values, 1, source.ncols());
        let value_row = source.nrows() - 1;
        values.row_mut(0).copy_from(&source.row(value_row));
    }

    /// Adds the gradient of all parameters to `gradient`, given the gradients of the outputs of the last
    /// [`ActorCritic::forward`] in this workspace, which must have been on the same batch and parameters. Without
    /// `value_gradients`, a preceding [`ActorCritic::act`] is enough and the critic gets no gradient.
    ///
    /// # Panics
    /// If a shape differs from that of the forward pass.
    pub fn backward(
        &self,
        prepared: &PreparedPolicy,
        batch: Batch<'_>,
        workspace: &mut PolicyWorkspace,
        parameter_gradients: &DMatrix<f32>,
        value_gradients: Option<&DMatrix<f32>>,
        gradient: &mut [f32],
    ) {
        let PolicyWorkspace { networks: [first, second], gradients, .. } = workspace;
        assert_eq!(gradient.len(), self.parameter_count(), "parameters of this policy");
        let width = self.actor_outputs + self.log_standard_deviations;
        assert_eq!(parameter_gradients.nrows(), width, "parameters of the action distribution");
        let actor_gradients = parameter_gradients.rows(0, self.actor_outputs);
        let (own, rest) = gradient.split_at_mut(self.networks[0].parameter_count());
        reshape(gradients, self.networks[0].outputs(), parameter_gradients.ncols());
        gradients.rows_mut(0, self.actor_outputs).copy_from(&actor_gradients);
        let log_standard_deviations = match &self.networks[..] {
            [_, critic] => {
                let (critic_own, rest) = rest.split_at_mut(critic.parameter_count());
                if let Some(value_gradients) = value_gradients {
                    let prepared = &prepared.networks[1];
                    critic.backward(prepared, batch, second, value_gradients, critic_own);
                }
                rest
            }
            _ => {
                let mut row = gradients.row_mut(self.actor_outputs);
                match value_gradients {
                    Some(value_gradients) => row.copy_from(&value_gradients.row(0)),
                    None => row.fill(0.0),
                }
                rest
            }
        };
        self.networks[0].backward(&prepared.networks[0], batch, first, gradients, own);
        for row in parameter_gradients.column_iter() {
            let own = row.iter().skip(self.actor_outputs);
            log_standard_deviations
                .iter_mut()
                .zip(own)
                .for_each(|(sum, derivative)| *sum += derivative);
        }
    }
}
