//! Which starts and goals may be drawn: the axis along which the paper makes its tasks harder
//! (Section 4.3 and Appendix C).

use serde::{Deserialize, Serialize};

/// The starts and goals that an environment draws from.
///
/// The default is what agents train and are evaluated on in Navigation. Demonstrations use part of
/// the coverage, and agents in the physics tasks more noise than their demonstrations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Setting {
    /// The fraction of starts and goals used, in (0, 1]. The paper has 0.25, 0.5, 0.75 and 1.
    pub coverage: f64,
    /// How far starts spread, in the task's own measure; `None` is the spread of its
    /// demonstrations. Navigation has no such measure and takes only `None`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
}

impl Default for Setting {
    fn default() -> Self {
        Setting { coverage: 1.0, noise: None }
    }
}
