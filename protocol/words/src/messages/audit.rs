//! What a gateway asks of the actor that acts episodes of other machines again.

use bytes::Bytes;
use prost::Message;

/// An episode that is to be acted again. The answer is a line of JSON: what differs, or null.
#[derive(Clone, PartialEq, Message)]
pub struct AuditRequest {
    /// The weights that acted, as the learner encoded them; without them those of the request before.
    #[prost(bytes = "bytes", optional, tag = "1")]
    pub weights: Option<Bytes>,
    /// The episode's trajectory, as it came.
    #[prost(bytes = "bytes", tag = "2")]
    pub trajectory: Bytes,
}
