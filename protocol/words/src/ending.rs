//! How episodes end.

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub enum Ending {
    /// By the task: the goal was reached.
    Terminated = 0,
    /// By the horizon.
    Truncated = 1,
}
