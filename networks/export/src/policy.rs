//! The policy as a graph: from raw observations to actions.

use networks::{ActorCritic, Distribution, RunningNormalizer};

use crate::graph::{Graph, Name, integer};
use crate::message::Kind;
use crate::network::{inputs, layers};

/// Builds the graph of a policy's actor. Its output `action` is the mode of the distribution: the index of a
/// discrete action, or the numbers of a continuous one, multiplied by `scale` unless that is empty, and clipped to
/// [-1, 1]. The other outputs are the parameters of the distribution: `logits`, or `mean` and
/// `log_standard_deviation` before squashing, scaling and clipping.
///
/// # Panics
/// If the number of parameters is not that of the policy.
pub fn policy(
    policy: &ActorCritic,
    parameters: &[f32],
    normalizer: &RunningNormalizer,
    scale: &[f32],
) -> Graph {
    assert_eq!(parameters.len(), policy.parameter_count(), "parameters of this policy");
    let mut graph = Graph::new("policy");
    let (actor, outputs) = policy.actor();
    let from = inputs(&mut graph, actor, normalizer);
    let own = &parameters[..actor.parameter_count()];
    let value = layers(&mut graph, actor, own, "actor", &from, outputs);
    match policy.distribution() {
        Distribution::Categorical { count } => {
            let attributes = vec![integer("axis", 1), integer("keepdims", 0)];
            let action = graph.node_with("ArgMax", &[&value], attributes);
            graph.output(&action, "action", Kind::I64, &[]);
            graph.output(&value, "logits", Kind::F32, &[count]);
        }
        Distribution::Gaussian { len } => {
            let last = &parameters[parameters.len() - len..];
            let logs = graph.weight("log_standard_deviation.weight", &[len], last);
            // Broadcasts the same logarithms to every row.
            let zero = graph.number(0.0);
            let nothing = graph.node("Mul", &[&value, &zero]);
            let logs = graph.node("Add", &[&nothing, &logs]);
            numbers(&mut graph, &value, &value, &logs, len, scale);
        }
        Distribution::SquashedGaussian { len } => {
            let [mean, logs] = graph.halves(&value);
            let (least, largest) = Distribution::LOG_STANDARD_DEVIATIONS;
            let [least, largest] = [least, largest].map(|number| graph.number(number));
            let logs = graph.node("Clip", &[&logs, &least, &largest]);
            let squashed = graph.node("Tanh", &[&mean]);
            numbers(&mut graph, &squashed, &mean, &logs, len, scale);
        }
    }
    graph
}

/// Adds the outputs of a continuous policy.
fn numbers(graph: &mut Graph, chosen: &Name, mean: &Name, logs: &Name, len: usize, scale: &[f32]) {
    let scaled = if scale.is_empty() {
        chosen.clone()
    } else {
        let scale = graph.weight("action_scale", &[len], scale);
        graph.node("Mul", &[chosen, &scale])
    };
    let [least, largest] = [-1.0, 1.0].map(|number| graph.number(number));
    let action = graph.node("Clip", &[&scaled, &least, &largest]);
    graph.output(&action, "action", Kind::F32, &[len]);
    graph.output(mean, "mean", Kind::F32, &[len]);
    graph.output(logs, "log_standard_deviation", Kind::F32, &[len]);
}
