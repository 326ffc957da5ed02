//! How episodes end.

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub enum Ending {
    /// By the task: the goal was reached.
    GoalReached = 0,
    /// By the horizon.
    Truncated = 1,
    /// By the task, and the goal was not reached: nothing follows, and nothing was won.
    Failed = 2,
}
