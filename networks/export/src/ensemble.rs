//! The ensemble of a reward model as a graph: from raw rows to the combined outputs of the members.

use networks::{Ensemble, RunningNormalizer, Squashing};

use crate::graph::{Graph, Name, integer, integers};
use crate::message::Kind;
use crate::network::{inputs, layers};

/// Builds the graph of an ensemble. Its outputs are the `mean` of the members, their sample `standard_deviation`
/// (over one less than their number), and the `proximity` computed from the mean.
pub fn ensemble(ensemble: &Ensemble, normalizer: &RunningNormalizer) -> Graph {
    let mut graph = Graph::new("ensemble");
    let from = inputs(&mut graph, &ensemble.network, normalizer);
    let mut outputs = Vec::new();
    for (number, member) in ensemble.members.iter().enumerate() {
        let name = format!("member{number}");
        let mut output = layers(&mut graph, &ensemble.network, member, &name, &from, 1);
        if let Some(prior) = ensemble.priors.get(number) {
            let name = format!("prior{number}");
            let prior = layers(&mut graph, &ensemble.network, prior, &name, &from, 1);
            output = graph.node("Add", &[&output, &prior]);
        }
        let squashed = ensemble.squashing == Squashing::MeanOfSigmoids;
        outputs.push(if squashed { graph.node("Sigmoid", &[&output]) } else { output });
    }
    let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
    let together = graph.node_with("Concat", &outputs, vec![integer("axis", 1)]);
    let together = graph.cast(&together, Kind::F64);
    let mean = reduced(&mut graph, "ReduceMean", &together, 1);
    let distance = graph.node("Sub", &[&together, &mean]);
    let squares = reduced(&mut graph, "ReduceSumSquare", &distance, 0);
    let count = graph.double(ensemble.members.len().saturating_sub(1).max(1) as f64);
    let variance = graph.node("Div", &[&squares, &count]);
    let deviation = graph.node("Sqrt", &[&variance]);
    let mean = reduced(&mut graph, "ReduceMean", &mean, 0);
    let [mean, deviation] = [mean, deviation].map(|value| graph.cast(&value, Kind::F32));
    let proximity = proximity(&mut graph, &mean, ensemble.squashing);
    graph.output(&mean, "mean", Kind::F32, &[]);
    graph.output(&deviation, "standard_deviation", Kind::F32, &[]);
    graph.output(&proximity, "proximity", Kind::F32, &[]);
    graph
}

/// Reduces the members of each row to one value; `keepdims` keeps the reduced dimension.
fn reduced(graph: &mut Graph, operator: &str, value: &str, keepdims: i64) -> Name {
    let attributes = vec![integers("axes", &[1]), integer("keepdims", keepdims)];
    graph.node_with(operator, &[value], attributes)
}

fn proximity(graph: &mut Graph, mean: &Name, squashing: Squashing) -> Name {
    match squashing {
        Squashing::MeanOfSigmoids => mean.clone(),
        Squashing::SigmoidOfMean => graph.node("Sigmoid", &[mean]),
        Squashing::ClampedMean => {
            let [least, largest] = [0.0, 1.0].map(|number| graph.number(number));
            graph.node("Clip", &[mean, &least, &largest])
        }
    }
}
