//! A network as operators and weights.

use networks::{Activation, Network, RunningNormalizer};
use protocol::task::ObservationSpec;

use crate::graph::{Graph, Name, integer, integers};
use crate::message::Kind;

/// Names of the inputs for the first and second observation of a row.
const OBSERVATIONS: [&str; 2] = ["observation", "next_observation"];

/// Name of the input for the extra inputs of a row.
const EXTRA_INPUTS: &str = "action";

/// Inputs of a network, prepared for its first layer.
pub(crate) struct Inputs {
    /// One-hot grids `[row, class, y, x]`, or normalized vectors.
    observations: Name,
    extra: Option<Name>,
}

/// Adds the inputs of a network. Vectors are normalized in double precision, as in Goalward.
pub(crate) fn inputs(graph: &mut Graph, network: &Network, by: &RunningNormalizer) -> Inputs {
    let shape = network.shape();
    let frames = &OBSERVATIONS[..shape.frames];
    let observations: Vec<Name> = match shape.observation {
        ObservationSpec::Cells { height, width, classes } => {
            let inputs = frames.iter().map(|name| graph.input(name, Kind::U8, &[height, width]));
            let inputs: Vec<Name> = inputs.collect();
            inputs.iter().map(|name| one_hot(graph, name, classes)).collect()
        }
        ObservationSpec::Vector { len } => {
            let inputs = frames.iter().map(|name| graph.input(name, Kind::F32, &[len]));
            let inputs: Vec<Name> = inputs.collect();
            normalized(graph, inputs, by)
        }
    };
    let extra = (shape.extra_inputs > 0)
        .then(|| graph.input(EXTRA_INPUTS, Kind::F32, &[shape.extra_inputs]));
    Inputs { observations: concatenated(graph, observations), extra }
}

fn one_hot(graph: &mut Graph, cells: &str, classes: usize) -> Name {
    let indices = graph.cast(cells, Kind::I64);
    let depth = graph.integer(classes as i64);
    let values = graph.numbers(&[0.0, 1.0]);
    graph.node_with("OneHot", &[&indices, &depth, &values], vec![integer("axis", 1)])
}

fn normalized(graph: &mut Graph, inputs: Vec<Name>, by: &RunningNormalizer) -> Vec<Name> {
    if by.moments.is_empty() {
        return inputs;
    }
    let means: Vec<f64> = by.moments.iter().map(|moments| moments.mean).collect();
    let deviations: Vec<f64> =
        by.moments.iter().map(|moments| moments.standard_deviation()).collect();
    let mean = graph.double_weight("normalization.mean", &means);
    let deviation = graph.double_weight("normalization.standard_deviation", &deviations);
    let limit = RunningNormalizer::CLIP;
    let [least, largest] = [-limit, limit].map(|number| graph.double(number));
    let normalize = |input: Name| {
        let exact = graph.cast(&input, Kind::F64);
        let distance = graph.node("Sub", &[&exact, &mean]);
        let scaled = graph.node("Div", &[&distance, &deviation]);
        let clipped = graph.node("Clip", &[&scaled, &least, &largest]);
        graph.cast(&clipped, Kind::F32)
    };
    inputs.into_iter().map(normalize).collect()
}

fn concatenated(graph: &mut Graph, mut values: Vec<Name>) -> Name {
    if values.len() == 1 {
        return values.remove(0);
    }
    let values: Vec<&str> = values.iter().map(String::as_str).collect();
    graph.node_with("Concat", &values, vec![integer("axis", 1)])
}

/// Parameters of a network that are not yet exported, and the names of its weights.
struct Parameters<'a> {
    rest: &'a [f32],
    /// Prefix of the names of the weights.
    name: &'a str,
    layers: usize,
}

impl Parameters<'_> {
    /// Takes the next `count` numbers.
    fn take(&mut self, count: usize) -> &[f32] {
        let (taken, rest) = self.rest.split_at(count);
        self.rest = rest;
        taken
    }

    /// Returns the name of the next layer.
    fn layer(&mut self) -> String {
        self.layers += 1;
        format!("{}.{}", self.name, self.layers - 1)
    }

    /// Adds the weights of a dense layer, restricted to its first `kept` outputs.
    fn dense(&mut self, graph: &mut Graph, size: [usize; 2], kept: usize) -> [Name; 2] {
        let [inputs, outputs] = size;
        let layer = self.layer();
        let weights = transposed(self.take(inputs * outputs), outputs);
        let weight = &weights[..kept * inputs];
        let weight = graph.weight(&format!("{layer}.weight"), &[kept, inputs], weight);
        let bias = &self.take(outputs)[..kept];
        [weight, graph.weight(&format!("{layer}.bias"), &[kept], bias)]
    }

    /// Adds the weights of a convolution over `inputs` channels in each of `frames` frames.
    fn convolution(&mut self, graph: &mut Graph, size: Convolution) -> [Name; 2] {
        let Convolution { frames, kernel, inputs, outputs } = size;
        let layer = self.layer();
        let window = kernel * kernel;
        let numbers = self.take(frames * window * inputs * outputs);
        // Our layout is `[frame][row][column][input][output]`.
        let at = |output: usize, frame: usize, input: usize, cell: usize| {
            numbers[((frame * window + cell) * inputs + input) * outputs + output]
        };
        let mut weights = Vec::with_capacity(numbers.len());
        for output in 0..outputs {
            for frame in 0..frames {
                for input in 0..inputs {
                    weights.extend((0..window).map(|cell| at(output, frame, input, cell)));
                }
            }
        }
        let shape = [outputs, frames * inputs, kernel, kernel];
        let weight = graph.weight(&format!("{layer}.weight"), &shape, &weights);
        let bias = self.take(outputs);
        [weight, graph.weight(&format!("{layer}.bias"), &[outputs], bias)]
    }
}

/// Size of a convolution.
struct Convolution {
    frames: usize,
    kernel: usize,
    inputs: usize,
    outputs: usize,
}

/// Returns the columns of a row-major matrix, one after another.
fn transposed(numbers: &[f32], columns: usize) -> Vec<f32> {
    let column = |column: usize| numbers.iter().skip(column).step_by(columns).copied();
    (0..columns).flat_map(column).collect()
}

/// Adds a network's layers and returns its first `kept` outputs. Names of the weights begin with `name`.
pub(crate) fn layers(
    graph: &mut Graph,
    network: &Network,
    parameters: &[f32],
    name: &str,
    from: &Inputs,
    kept: usize,
) -> Name {
    let shape = network.shape();
    let mut parameters = Parameters { rest: parameters, name, layers: 0 };
    let (mut value, mut width) = match shape.observation {
        ObservationSpec::Vector { len } => (from.observations.clone(), shape.frames * len),
        ObservationSpec::Cells { .. } => encoder(graph, network, &mut parameters, from),
    };
    if let Some(extra) = &from.extra {
        value = concatenated(graph, vec![value, extra.clone()]);
        width += shape.extra_inputs;
    }
    for &hidden in &shape.hidden {
        value = dense(graph, &mut parameters, &value, [width, hidden], hidden);
        value = activated(graph, value, shape.activation);
        width = hidden;
    }
    dense(graph, &mut parameters, &value, [width, network.outputs()], kept)
}

/// Adds the encoder of grids and returns the features and their number.
fn encoder(
    graph: &mut Graph,
    network: &Network,
    parameters: &mut Parameters<'_>,
    from: &Inputs,
) -> (Name, usize) {
    let shape = network.shape();
    let ObservationSpec::Cells { height, width, classes } = shape.observation else {
        unreachable!("only grids have an encoder")
    };
    let (kernel, pool) = (shape.cells.kernel, shape.cells.pool);
    let (mut value, mut inputs, mut frames) = (from.observations.clone(), classes, shape.frames);
    for (index, &outputs) in shape.cells.channels.iter().enumerate() {
        let size = Convolution { frames, kernel, inputs, outputs };
        let [weight, bias] = parameters.convolution(graph, size);
        value = graph.node("Conv", &[&value, &weight, &bias]);
        value = activated(graph, value, Activation::Relu);
        if index == 0 {
            let sides = [pool as i64; 2];
            let attributes = vec![integers("kernel_shape", &sides), integers("strides", &sides)];
            value = graph.node_with("MaxPool", &[&value], attributes);
        }
        (inputs, frames) = (outputs, 1);
    }
    let images = shape.cells.images([height, width]).expect("the network was laid out");
    let [rows, columns] = *images.last().expect("an encoder has a convolution");
    // Our dense layer has the channels of a pixel next to each other.
    value = graph.node_with("Transpose", &[&value], vec![integers("perm", &[0, 2, 3, 1])]);
    value = graph.node("Flatten", &[&value]);
    let features = shape.cells.features;
    value = dense(graph, parameters, &value, [rows * columns * inputs, features], features);
    (activated(graph, value, Activation::Relu), features)
}

fn dense(
    graph: &mut Graph,
    parameters: &mut Parameters<'_>,
    value: &str,
    size: [usize; 2],
    kept: usize,
) -> Name {
    let [weight, bias] = parameters.dense(graph, size, kept);
    graph.node_with("Gemm", &[value, &weight, &bias], vec![integer("transB", 1)])
}

fn activated(graph: &mut Graph, value: Name, activation: Activation) -> Name {
    match activation {
        Activation::Identity => value,
        Activation::Relu => graph.node("Relu", &[&value]),
        Activation::Tanh => graph.node("Tanh", &[&value]),
    }
}
