//! The topics of the log: their names, their schemas and the file they go to.
//!
//! The schemas are `schema/goalward.proto` and, for what viewers draw, `schema/scene.proto`, compiled
//! and committed, so that neither building nor reading the log needs a protobuf compiler.

use protocol::trajectory::{Source, Trajectory};

/// `schema/goalward.proto` as a serialized `FileDescriptorSet`, made by `tests/schema.rs`.
pub const SCHEMA: &[u8] = include_bytes!("../../schema/goalward.bin");

/// `schema/scene.proto` in the same form.
pub const SCENE_SCHEMA: &[u8] = include_bytes!("../../schema/scene.bin");

/// The topic of a recorded message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Topic {
    /// An episode to learn from: a policy's, or an expert's in a file of demonstrations.
    Trajectory,
    /// An episode on evaluation seeds.
    EvaluationTrajectory,
    /// The reward model's output for a trajectory.
    Score,
    /// A policy update.
    PolicyUpdate,
    /// An update of the reward model.
    RewardUpdate,
    /// A checkpoint of learner and proximity service.
    Checkpoint,
    /// A scene of an evaluation episode, for viewers.
    Scene,
    /// An image of an evaluation episode, rendered by the environment.
    Picture,
}

impl Topic {
    /// Every topic.
    pub const ALL: [Topic; 8] = [
        Topic::Trajectory,
        Topic::EvaluationTrajectory,
        Topic::Score,
        Topic::PolicyUpdate,
        Topic::RewardUpdate,
        Topic::Checkpoint,
        Topic::Scene,
        Topic::Picture,
    ];

    /// Returns the topic's name in MCAP.
    pub fn name(self) -> &'static str {
        match self {
            Topic::Trajectory => "/trajectory",
            Topic::EvaluationTrajectory => "/evaluation/trajectory",
            Topic::Score => "/proximity/score",
            Topic::PolicyUpdate => "/policy/update",
            Topic::RewardUpdate => "/proximity/update",
            Topic::Checkpoint => "/checkpoint",
            Topic::Scene => "/evaluation/scene",
            Topic::Picture => "/evaluation/image",
        }
    }

    /// Returns the full name of the topic's message in the schema.
    pub fn schema(self) -> &'static str {
        match self {
            Topic::Trajectory | Topic::EvaluationTrajectory => "goalward.v1.Trajectory",
            Topic::Score => "goalward.v1.Score",
            Topic::PolicyUpdate => "goalward.v1.PolicyUpdate",
            Topic::RewardUpdate => "goalward.v1.RewardUpdate",
            Topic::Checkpoint => "goalward.v1.Checkpoint",
            Topic::Scene => "foxglove.SceneUpdate",
            Topic::Picture => "foxglove.CompressedImage",
        }
    }

    /// Returns the compiled schema that declares the topic's message.
    pub fn schema_set(self) -> &'static [u8] {
        if matches!(self, Topic::Scene | Topic::Picture) { SCENE_SCHEMA } else { SCHEMA }
    }

    /// Returns the topic that a trajectory goes to.
    pub fn of(trajectory: &Trajectory) -> Topic {
        match Source::try_from(trajectory.source) {
            Ok(Source::Evaluation) => Topic::EvaluationTrajectory,
            _ => Topic::Trajectory,
        }
    }

    /// Returns whether the topic's messages are trajectories.
    pub(super) fn is_of_trajectories(self) -> bool {
        matches!(self, Topic::Trajectory | Topic::EvaluationTrajectory)
    }

    pub(super) fn named(name: &str) -> Option<Topic> {
        Topic::ALL.into_iter().find(|topic| topic.name() == name)
    }
}

/// What a file of a run holds. Reading one topic means decompressing its whole file, so the few bytes of updates are
/// kept apart from the many of trajectories.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Contents {
    /// Trajectories and their scores.
    Trajectories,
    /// Updates and checkpoints.
    Updates,
}

impl Contents {
    /// Both kinds.
    pub const ALL: [Contents; 2] = [Contents::Trajectories, Contents::Updates];

    /// Returns what the names of such files begin with.
    pub fn name(self) -> &'static str {
        match self {
            Contents::Trajectories => "trajectories",
            Contents::Updates => "updates",
        }
    }

    /// Returns the topics in such files.
    pub fn topics(self) -> &'static [Topic] {
        match self {
            Contents::Trajectories => &Topic::ALL[..3],
            Contents::Updates => &Topic::ALL[3..6],
        }
    }
}
