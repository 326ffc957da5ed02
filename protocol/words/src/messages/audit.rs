//! The request of a gateway to the actor that audits episodes of other machines by acting them again.

use bytes::Bytes;
use prost::Message;

/// An episode to act again. The answer is one line of JSON: the first difference, or null.
#[derive(Clone, PartialEq, Message)]
pub struct AuditRequest {
    /// Weights of the policy that acted, as the learner encoded them. If absent, those of the previous request apply.
    #[prost(bytes = "bytes", optional, tag = "1")]
    pub weights: Option<Bytes>,
    /// The episode's trajectory, as received.
    #[prost(bytes = "bytes", tag = "2")]
    pub trajectory: Bytes,
}
