//! Names of records, which show what a run has recorded twice.

use std::path::Path;

use prost::Message as _;
use protocol::Error;

use super::read_error;
use super::scan::Message;
use super::topic::Topic;

/// The name of a record: topic, iteration, and two numbers within the iteration. Records with the same name are the
/// same thing, recorded twice.
pub(super) type Name = (Topic, u64, u64, u64);

/// Returns the name of a run's record.
///
/// # Errors
/// [`Error::LogRead`] if the name cannot be decoded, or the record is not one of a run.
pub(super) fn name_of(path: &Path, message: &Message) -> Result<Name, Error> {
    let bytes = message.bytes.as_ref();
    let topic = message.topic;
    let name = match topic {
        Topic::Scene | Topic::Picture => {
            let topic = topic.name();
            let message = format!("topic {topic}: expected the log of a run, found an evaluation");
            return Err(read_error(path, message));
        }
        Topic::Trajectory | Topic::EvaluationTrajectory => {
            TrajectoryName::decode(bytes).map(|name| (name.iteration, name.lane, name.episode))
        }
        Topic::Score => {
            ScoreName::decode(bytes).map(|name| (name.iteration, name.lane, name.episode))
        }
        Topic::RewardUpdate => {
            RewardUpdateName::decode(bytes).map(|name| (name.iteration, name.model_version, 0))
        }
        Topic::PolicyUpdate | Topic::Checkpoint => {
            IterationName::decode(bytes).map(|name| (name.iteration, 0, 0))
        }
    };
    let (iteration, second, third) = name.map_err(|cause| {
        let (name, schema) = (topic.name(), topic.schema());
        read_error(path, format!("topic {name}: undecodable {schema}: {cause}"))
    })?;
    Ok((topic, iteration, second, third))
}

/// The fields of a trajectory that name it. Decoding them skips the rest.
#[derive(Clone, PartialEq, prost::Message)]
struct TrajectoryName {
    #[prost(uint64, tag = "3")]
    iteration: u64,
    #[prost(uint64, tag = "4")]
    lane: u64,
    #[prost(uint64, tag = "5")]
    episode: u64,
}

/// The fields of a score that name it.
#[derive(Clone, PartialEq, prost::Message)]
struct ScoreName {
    #[prost(uint64, tag = "1")]
    iteration: u64,
    #[prost(uint64, tag = "2")]
    lane: u64,
    #[prost(uint64, tag = "3")]
    episode: u64,
}

/// The fields of an update of the reward model that name it. The offline training and the first online update have the
/// same iteration.
#[derive(Clone, PartialEq, prost::Message)]
struct RewardUpdateName {
    #[prost(uint64, tag = "1")]
    iteration: u64,
    #[prost(uint64, tag = "2")]
    model_version: u64,
}

/// The field that names a policy update or a checkpoint.
#[derive(Clone, PartialEq, prost::Message)]
struct IterationName {
    #[prost(uint64, tag = "1")]
    iteration: u64,
}
