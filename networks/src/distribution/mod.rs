//! Action distributions: from a network's outputs to actions and log-probabilities, and back to gradients.
//!
//! A row of parameters is the actor's output for one observation; an action is bytes in the layout of
//! [`ActionSpec`]. Exponentials and logarithms come from the `libm` crate, so they have the same bits everywhere.

mod categorical;
mod gaussian;
mod squashed;

use protocol::seed::Stream;
use protocol::task::ActionSpec;

/// Half the logarithm of two pi.
const HALF_LOG_TAU: f32 = 0.918_938_5;

/// Distribution of actions, given the parameters of one observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distribution {
    /// One of `count` actions; the parameters are `count` unnormalized log-probabilities.
    Categorical {
        /// Number of actions.
        count: usize,
    },
    /// Independent normal numbers; the parameters are `len` means, then `len` logarithms of standard deviations.
    Gaussian {
        /// Number of action components.
        len: usize,
    },
    /// Hyperbolic tangents of independent normal numbers; the parameters are `len` means, then `len` logarithms of
    /// standard deviations before clamping to [`Distribution::LOG_STANDARD_DEVIATIONS`].
    SquashedGaussian {
        /// Number of action components.
        len: usize,
    },
}

impl Distribution {
    /// Bounds of the logarithm of a standard deviation of a squashed distribution. An untrained policy, whose
    /// outputs are about 0, draws actions that are nearly uniform.
    pub const LOG_STANDARD_DEVIATIONS: (f32, f32) = (-20.0, 2.0);

    /// Returns the distribution for a kind of action. Only continuous actions can be squashed.
    pub fn new(action: ActionSpec, squashed: bool) -> Self {
        match action {
            ActionSpec::Discrete { count } => Distribution::Categorical { count },
            ActionSpec::Continuous { len } if squashed => Distribution::SquashedGaussian { len },
            ActionSpec::Continuous { len } => Distribution::Gaussian { len },
        }
    }

    /// Returns the number of parameters in a row.
    pub fn parameter_count(self) -> usize {
        match self {
            Distribution::Categorical { count } => count,
            Distribution::Gaussian { len } | Distribution::SquashedGaussian { len } => 2 * len,
        }
    }

    /// Checks the length of a row of parameters.
    fn check(self, parameters: &[f32]) {
        assert_eq!(parameters.len(), self.parameter_count(), "one row of {self:?}");
    }

    /// Draws an action and returns its log-probability.
    ///
    /// # Panics
    /// If the row or the action has the wrong length. Surplus bytes of a squashed Gaussian's action are not
    /// detected.
    pub fn sample(self, parameters: &[f32], stream: &mut Stream, action: &mut [u8]) -> f32 {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::sample(parameters, stream, action),
            Distribution::Gaussian { .. } => gaussian::sample(parameters, stream, action),
            Distribution::SquashedGaussian { .. } => squashed::sample(parameters, stream, action),
        }
        self.log_probability(parameters, action)
    }

    /// Writes the most probable action: the first of several equal ones, or the squashed mean of a squashed
    /// Gaussian.
    ///
    /// # Panics
    /// If the row or the action has the wrong length. Surplus bytes of a continuous action are not detected.
    pub fn mode(self, parameters: &[f32], action: &mut [u8]) {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::mode(parameters, action),
            Distribution::Gaussian { .. } => gaussian::mode(parameters, action),
            Distribution::SquashedGaussian { .. } => squashed::mode(parameters, action),
        }
    }

    /// Returns the logarithm of an action's probability or density.
    ///
    /// # Panics
    /// If the row or the action has the wrong length. A squashed Gaussian does not check the action's length.
    pub fn log_probability(self, parameters: &[f32], action: &[u8]) -> f32 {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::log_probability(parameters, action),
            Distribution::Gaussian { .. } => gaussian::log_probability(parameters, action),
            Distribution::SquashedGaussian { .. } => squashed::log_probability(parameters, action),
        }
    }

    /// Returns the entropy in nats; for a squashed Gaussian, the entropy before squashing.
    ///
    /// # Panics
    /// If the row has the wrong length.
    pub fn entropy(self, parameters: &[f32]) -> f32 {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::entropy(parameters),
            Distribution::Gaussian { .. } => gaussian::entropy(parameters),
            Distribution::SquashedGaussian { .. } => squashed::entropy(parameters),
        }
    }

    /// Writes the gradient of a loss with respect to the parameters, given its derivatives with respect to the
    /// log-probability of `action` and to the entropy.
    ///
    /// # Panics
    /// If a row or the action has the wrong length. A squashed Gaussian does not check the action's length.
    pub fn gradient(
        self,
        parameters: &[f32],
        action: &[u8],
        log_probability_derivative: f32,
        entropy_derivative: f32,
        gradient: &mut [f32],
    ) {
        self.check(parameters);
        self.check(gradient);
        let of = match self {
            Distribution::Categorical { .. } => categorical::gradient,
            Distribution::Gaussian { .. } => gaussian::gradient,
            Distribution::SquashedGaussian { .. } => squashed::gradient,
        };
        of(parameters, action, log_probability_derivative, entropy_derivative, gradient);
    }

    /// Draws an action of a squashed Gaussian and returns its log-probability. Stores the underlying standard
    /// normal numbers in `noise` for [`Distribution::pathwise_gradient`].
    ///
    /// # Panics
    /// If this is another distribution, or the row has the wrong length.
    pub fn draw(
        self,
        parameters: &[f32],
        stream: &mut Stream,
        noise: &mut [f32],
        action: &mut [f32],
    ) -> f32 {
        self.check(parameters);
        let Distribution::SquashedGaussian { .. } = self else {
            panic!("{self:?} has no pathwise draw")
        };
        squashed::draw(parameters, stream, noise, action)
    }

    /// Writes the gradient of a loss with respect to the parameters, through an action that [`Distribution::draw`]
    /// made from `noise`, given the derivatives of the loss with respect to the action's components and to its
    /// log-probability.
    ///
    /// # Panics
    /// If a row has the wrong length, or the distribution has no such draw.
    pub fn pathwise_gradient(
        self,
        parameters: &[f32],
        noise: &[f32],
        action_gradients: &[f32],
        log_probability_derivative: f32,
        gradient: &mut [f32],
    ) {
        self.check(parameters);
        self.check(gradient);
        let Distribution::SquashedGaussian { .. } = self else {
            panic!("{self:?} has no pathwise draw")
        };
        squashed::pathwise_gradient(
            parameters,
            noise,
            action_gradients,
            log_probability_derivative,
            gradient,
        );
    }
}
