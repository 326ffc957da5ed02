//! How episodes end.

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub enum Ending {
    /// By the task: the goal was reached.
    GoalReached = 0,
    /// By the horizon.
    Truncated = 1,
    /// By the task, without reaching the goal. The final state is terminal, with a value of 0.
    Failed = 2,
}
