//! From a network's outputs to actions and their log-probabilities, and back to gradients.
//!
//! A row of parameters is what the actor gives for one observation; an action is its bytes as
//! [`ActionSpec`] lays them out. Exponentials and logarithms come from the `libm` crate, so they are
//! the same bits everywhere.
mod categorical;
mod gaussian;
mod squashed;

use protocol::seed::Stream;
use protocol::task::ActionSpec;

/// Half the logarithm of two pi.
const HALF_LOG_TAU: f32 = 0.918_938_5;

/// How actions are drawn, given the parameters of one observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distribution {
    /// One of `count` actions; the parameters are as many unnormalized log-probabilities.
    Categorical {
        /// Number of actions.
        count: usize,
    },
    /// Independent normal numbers; the parameters are `len` means, then `len` logarithms of standard
    /// deviations.
    Gaussian {
        /// How many numbers.
        len: usize,
    },
    /// The hyperbolic tangents of independent normal numbers; the parameters are `len` means, then
    /// `len` numbers that the logarithms of standard deviations are made of.
    SquashedGaussian {
        /// How many numbers.
        len: usize,
    },
}

impl Distribution {
    /// Least and largest logarithm of a standard deviation of a squashed distribution. A first policy,
    /// which gives about 0, draws actions that are nearly uniform.
    pub const LOG_STANDARD_DEVIATIONS: (f32, f32) = (-20.0, 2.0);

    /// The distribution for a kind of action; only continuous ones can be squashed.
    pub fn new(action: ActionSpec, squashed: bool) -> Self {
        match action {
            ActionSpec::Discrete { count } => Distribution::Categorical { count },
            ActionSpec::Continuous { len } if squashed => Distribution::SquashedGaussian { len },
            ActionSpec::Continuous { len } => Distribution::Gaussian { len },
        }
    }

    /// Numbers in a row of parameters.
    pub fn parameter_count(self) -> usize {
        match self {
            Distribution::Categorical { count } => count,
            Distribution::Gaussian { len } | Distribution::SquashedGaussian { len } => 2 * len,
        }
    }

    /// Checks a row of parameters.
    fn check(self, parameters: &[f32]) {
        assert_eq!(parameters.len(), self.parameter_count(), "one row of {self:?}");
    }

    /// Draws an action and returns its log-probability.
    ///
    /// # Panics
    /// If the row or the action has another length than this distribution's.
    pub fn sample(self, parameters: &[f32], stream: &mut Stream, action: &mut [u8]) -> f32 {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::sample(parameters, stream, action),
            Distribution::Gaussian { .. } => gaussian::sample(parameters, stream, action),
            Distribution::SquashedGaussian { .. } => squashed::sample(parameters, stream, action),
        }
        self.log_probability(parameters, action)
    }

    /// Writes the most probable action; of equals, the first; of squashed numbers, the mean as squashed.
    ///
    /// # Panics
    /// If the row or the action has another length than this distribution's.
    pub fn mode(self, parameters: &[f32], action: &mut [u8]) {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::mode(parameters, action),
            Distribution::Gaussian { .. } => gaussian::mode(parameters, action),
            Distribution::SquashedGaussian { .. } => squashed::mode(parameters, action),
        }
    }

    /// The logarithm of an action's probability or density.
    ///
    /// # Panics
    /// If the row or the action has another length than this distribution's.
    pub fn log_probability(self, parameters: &[f32], action: &[u8]) -> f32 {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::log_probability(parameters, action),
            Distribution::Gaussian { .. } => gaussian::log_probability(parameters, action),
            Distribution::SquashedGaussian { .. } => squashed::log_probability(parameters, action),
        }
    }

    /// The entropy, in nats; of squashed numbers that before they are squashed.
    ///
    /// # Panics
    /// If the row has another length than this distribution's.
    pub fn entropy(self, parameters: &[f32]) -> f32 {
        self.check(parameters);
        match self {
            Distribution::Categorical { .. } => categorical::entropy(parameters),
            Distribution::Gaussian { .. } => gaussian::entropy(parameters),
            Distribution::SquashedGaussian { .. } => squashed::entropy(parameters),
        }
    }

    /// Writes the gradient of a loss with respect to the parameters, given its derivatives with
    /// respect to the log-probability of `action` and to the entropy.
    ///
    /// # Panics
    /// If a row or the action has another length than this distribution's.
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

    /// Draws an action of squashed numbers and keeps the normal numbers it was made of in `noise`, so
    /// that [`Distribution::pathwise_gradient`] can follow them. Returns its log-probability.
    ///
    /// # Panics
    /// If this is another distribution, or a length is not its own.
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

    /// Writes the gradient of a loss with respect to the parameters, through an action drawn by
    /// [`Distribution::draw`] from `noise`, given its derivatives with respect to the numbers of the
    /// action and to its log-probability.
    ///
    /// # Panics
    /// If a length is not this distribution's.
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
        squashed::pathwise_gradient(
            parameters,
            noise,
            action_gradients,
            log_probability_derivative,
            gradient,
        );
    }
}
