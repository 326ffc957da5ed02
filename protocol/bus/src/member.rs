//! The members of a bus: the processes that opened it, and whether they are alive.

use iceoryx2::node::NodeView;
use iceoryx2::prelude::{CallbackProgression, Config, Node, NodeState};
use protocol::Error;

use super::{SharedMemory, failed};

/// A process on a bus. It is a member once for each name under which it opened the bus.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Member {
    /// Its name, such as `learner`. An actor's name ends with its process ID.
    pub name: String,
    /// Its process ID, if known.
    pub process: Option<u32>,
    /// Whether it is alive, as far as that can be known. What dead processes leave is cleaned up soon.
    pub lives: bool,
}

/// Returns all members of a bus, sorted by name.
pub(super) fn members(config: &Config) -> Result<Vec<Member>, Error> {
    let mut members = Vec::new();
    Node::<SharedMemory>::list(config, |state| {
        let (name, lives) = match &state {
            NodeState::Alive(view) => (name_of(view), true),
            NodeState::Dead(view) => (name_of(view), false),
            // Another user's process: not ours to judge, so it counts as alive.
            NodeState::Inaccessible(id) => (Some(format!("inaccessible node {id}")), true),
            NodeState::Undefined(_) => (None, false),
        };
        let process = state
            .node_id()
            .pid::<SharedMemory>()
            .ok()
            .and_then(|id| u32::try_from(id.value()).ok());
        members.extend(name.map(|name| Member { name, process, lives }));
        CallbackProgression::Continue
    })
    .map_err(failed("listing of the nodes", "bus"))?;
    members.sort();
    Ok(members)
}

fn name_of(view: &impl NodeView) -> Option<String> {
    view.details().as_ref().map(|details| details.name().to_string())
}
