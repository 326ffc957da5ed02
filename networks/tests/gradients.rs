//! Checks back-propagation, distributions and losses against finite differences.
//!
//! Networks compute in single precision, and so do the differences. Their noise is a relative error of one percent
//! of a layer's gradient, while a wrong term in a derivative causes an error of tens of percent.
use nalgebra::DMatrix;
use networks::{
    Activation, ActorCritic, Batch, Distribution, Head, Initialization, Network, NetworkShape,
    Observations, PolicyArchitecture, PolicyWorkspace, Workspace, binary_cross_entropy, ranking,
    sigmoid, softplus, squared_error,
};
use protocol::encoder::CellsArchitecture;
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{ActionSpec, ObservationSpec, floats};
use rand::RngExt;

const ROWS: usize = 7;

fn random() -> Stream {
    stream(7, Purpose::PolicyWeights, 0, 0)
}

fn normal(stream: &mut Stream) -> f32 {
    (0..12).map(|_| stream.random::<f32>()).sum::<f32>() - 6.0
}

fn observations(spec: ObservationSpec, frames: usize, stream: &mut Stream) -> Vec<u8> {
    match spec {
        ObservationSpec::Cells { height, width, classes } => {
            cells(ROWS * frames * height * width, classes, stream)
        }
        ObservationSpec::Vector { len } => {
            (0..ROWS * frames * len).flat_map(|_| normal(stream).to_le_bytes()).collect()
        }
    }
}

/// Draws cells that are mostly empty, so that many windows are equal.
fn cells(count: usize, classes: usize, stream: &mut Stream) -> Vec<u8> {
    let mut cell = || match stream.random_range(0..4) {
        0 => stream.random_range(0..classes as u8),
        _ => 0,
    };
    (0..count).map(|_| cell()).collect()
}

/// Computes the one-sided derivatives of `loss` with respect to each of `numbers`, from above and from below.
fn differences(numbers: &[f32], step: f32, mut loss: impl FnMut(&[f32]) -> f64) -> Vec<[f64; 2]> {
    let mut moved = numbers.to_vec();
    let here = loss(numbers);
    (0..numbers.len())
        .map(|index| {
            [step, -step].map(|step| {
                moved[index] = numbers[index] + step;
                let derivative = (loss(&moved) - here) / f64::from(moved[index] - numbers[index]);
                moved[index] = numbers[index];
                derivative
            })
        })
        .collect()
}

/// Compares a gradient with differences. Where a rectifier or a maximum switches within the step, the two one-sided
/// derivatives differ and are skipped; that must be rare.
fn assert_close(what: &str, found: &[f32], differences: &[[f64; 2]], tolerance: f64) {
    let center = |[above, below]: [f64; 2]| 0.5 * (above + below);
    let norm = differences.iter().map(|pair| center(*pair) * center(*pair)).sum::<f64>().sqrt();
    assert!(norm > 1e-3, "{what}: the gradient is too small to say anything: {norm:e}");
    let scale = norm / (differences.len() as f64).sqrt();
    let (mut error, mut compared) = (0.0, 0);
    for (found, pair) in found.iter().zip(differences) {
        if (pair[0] - pair[1]).abs() < 0.04 * scale.max(center(*pair).abs()) {
            error += (f64::from(*found) - center(*pair)).powi(2);
            compared += 1;
        }
    }
    let error = error.sqrt();
    assert!(error < tolerance * norm, "{what}: error {error:e} of {norm:e}");
    assert!(10 * compared > 7 * found.len(), "{what}: {compared} of {} compared", found.len());
}

fn shape(observation: ObservationSpec) -> NetworkShape {
    NetworkShape {
        observation,
        frames: 1,
        extra_inputs: 0,
        cells: CellsArchitecture { channels: vec![6, 5, 17], kernel: 2, pool: 2, features: 11 },
        hidden: vec![19, 7],
        activation: Activation::Tanh,
        hidden_initialization: Initialization::FanIn,
        heads: vec![Head { outputs: 3, initialization: Initialization::FanIn }],
    }
}

/// Checks the gradient of a random linear function of the outputs, layer by layer.
fn check_network(shape: NetworkShape) {
    let mut stream = random();
    let (frames, extra_count) = (shape.frames, shape.extra_inputs);
    let observations = observations(shape.observation, frames, &mut stream);
    let extra_inputs: Vec<f32> = (0..ROWS * extra_count).map(|_| normal(&mut stream)).collect();
    let batch =
        Batch { observations: Observations::Bytes(&observations), extra_inputs: &extra_inputs };
    let network = Network::new(shape);
    let count = network.parameter_count();
    let parameters: Vec<f32> = (0..count).map(|_| 0.4 * normal(&mut stream)).collect();
    let gradients = DMatrix::from_fn(network.outputs(), ROWS, |_, _| normal(&mut stream));
    let mut workspace = Workspace::default();
    let mut loss = |parameters: &[f32]| {
        let outputs = network.forward(&network.prepare(parameters), batch, &mut workspace);
        let each = outputs.iter().zip(&gradients);
        each.map(|(output, derivative)| f64::from(*output) * f64::from(*derivative)).sum::<f64>()
    };
    let expected = differences(&parameters, 5e-4, &mut loss);
    loss(&parameters);
    let mut gradient = vec![1.0; network.parameter_count()];
    let prepared = network.prepare(&parameters);
    network.backward(&prepared, batch, &mut workspace, &gradients, &mut gradient);
    gradient.iter_mut().for_each(|derivative| *derivative -= 1.0);
    for (layer, range) in network.parameter_ranges().iter().cloned().enumerate() {
        let what = format!("layer {layer}");
        assert_close(&what, &gradient[range.clone()], &expected[range], 0.01);
    }
}

#[test]
fn vector_networks() {
    check_network(shape(ObservationSpec::Vector { len: 5 }));
    check_network(NetworkShape {
        frames: 2,
        extra_inputs: 3,
        activation: Activation::Relu,
        ..shape(ObservationSpec::Vector { len: 4 })
    });
}

#[test]
fn cells_networks() {
    let observation = ObservationSpec::Cells { height: 10, width: 11, classes: 3 };
    check_network(shape(observation));
    check_network(NetworkShape { frames: 2, extra_inputs: 2, ..shape(observation) });
    check_network(NetworkShape { hidden: Vec::new(), extra_inputs: 4, ..shape(observation) });
    let cells = CellsArchitecture { channels: vec![18, 3], kernel: 3, pool: 1, features: 5 };
    check_network(NetworkShape { cells, ..shape(observation) });
}

/// Checks the gradient of a random linear function of the outputs with respect to the inputs of the rows, and that
/// computing it leaves the gradient of the parameters unchanged.
fn check_inputs(shape: NetworkShape) {
    let mut stream = random();
    let vector = matches!(shape.observation, ObservationSpec::Vector { .. });
    let observations = observations(shape.observation, shape.frames, &mut stream);
    let extra_inputs: Vec<f32> =
        (0..ROWS * shape.extra_inputs).map(|_| normal(&mut stream)).collect();
    let own = if vector { observations.len() / (4 * ROWS) } else { 0 };
    let width = own + shape.extra_inputs;
    let network = Network::new(shape);
    let parameters: Vec<f32> =
        (0..network.parameter_count()).map(|_| 0.4 * normal(&mut stream)).collect();
    let prepared = network.prepare(&parameters);
    let gradients = DMatrix::from_fn(network.outputs(), ROWS, |_, _| normal(&mut stream));
    let mut workspace = Workspace::default();
    let seen: Vec<f32> = if vector { floats(&observations).collect() } else { Vec::new() };
    let mut numbers = Vec::new();
    for row in 0..ROWS {
        numbers.extend(&seen[row * own..(row + 1) * own]);
        numbers.extend(&extra_inputs[row * (width - own)..(row + 1) * (width - own)]);
    }
    let expected = differences(&numbers, 5e-4, |numbers| {
        let rows = numbers.chunks_exact(width);
        let moved: Vec<u8> = rows
            .clone()
            .flat_map(|row| row[..own].iter().flat_map(|one| one.to_le_bytes()))
            .collect();
        let extra_inputs: Vec<f32> = rows.flat_map(|row| row[own..].iter().copied()).collect();
        let observations = if vector { &moved } else { &observations };
        let batch =
            Batch { observations: Observations::Bytes(observations), extra_inputs: &extra_inputs };
        let outputs = network.forward(&prepared, batch, &mut workspace);
        let each = outputs.iter().zip(&gradients);
        each.map(|(output, derivative)| f64::from(*output) * f64::from(*derivative)).sum::<f64>()
    });
    let batch =
        Batch { observations: Observations::Bytes(&observations), extra_inputs: &extra_inputs };
    let [alone, after] = [false, true].map(|between| {
        network.forward(&prepared, batch, &mut workspace);
        if between {
            let found = network.input_gradient(&prepared, &mut workspace, &gradients);
            assert_eq!(found.shape(), (width, ROWS));
            assert_close("inputs", found.as_slice(), &expected, 0.01);
        }
        let mut gradient = vec![0.0; parameters.len()];
        network.backward(&prepared, batch, &mut workspace, &gradients, &mut gradient);
        gradient
    });
    assert_eq!(alone, after);
}

#[test]
fn inputs() {
    check_inputs(shape(ObservationSpec::Vector { len: 5 }));
    let vector = shape(ObservationSpec::Vector { len: 4 });
    check_inputs(NetworkShape {
        frames: 2,
        extra_inputs: 3,
        activation: Activation::Relu,
        ..vector
    });
    let observation = ObservationSpec::Cells { height: 10, width: 11, classes: 3 };
    check_inputs(NetworkShape { frames: 2, extra_inputs: 2, ..shape(observation) });
    check_inputs(NetworkShape { hidden: Vec::new(), extra_inputs: 4, ..shape(observation) });
}

fn check_policy(observation: ObservationSpec, action: ActionSpec, shared_trunk: bool) {
    let mut stream = random();
    let architecture = PolicyArchitecture {
        cells: CellsArchitecture { channels: vec![4, 6], kernel: 2, pool: 2, features: 8 },
        hidden: vec![9, 8],
        shared_trunk,
        ..PolicyArchitecture::default()
    };
    let policy = ActorCritic::new(observation, action, &architecture);
    let observations = observations(observation, 1, &mut stream);
    let batch = Batch::new(&observations);
    let count = policy.parameter_count();
    let parameters: Vec<f32> = (0..count).map(|_| 0.4 * normal(&mut stream)).collect();
    let width = policy.distribution().parameter_count();
    let gradients = DMatrix::from_fn(width, ROWS, |_, _| normal(&mut stream));
    let value_gradients = DMatrix::from_fn(1, ROWS, |_, _| normal(&mut stream));
    let mut workspace = PolicyWorkspace::default();
    let mut loss = |parameters: &[f32]| {
        let found = policy.forward(&policy.prepare(parameters), batch, &mut workspace);
        let each = found
            .parameters
            .iter()
            .zip(&gradients)
            .chain(found.values.iter().zip(&value_gradients));
        each.map(|(output, derivative)| f64::from(*output) * f64::from(*derivative)).sum::<f64>()
    };
    let expected = differences(&parameters, 5e-4, &mut loss);
    loss(&parameters);
    let mut gradient = vec![0.0; count];
    let prepared = policy.prepare(&parameters);
    policy.backward(
        &prepared,
        batch,
        &mut workspace,
        &gradients,
        Some(&value_gradients),
        &mut gradient,
    );
    assert_close("policy", &gradient, &expected, 0.01);
    let tail = count.saturating_sub(3);
    assert_close("last parameters", &gradient[tail..], &expected[tail..], 0.01);
}

#[test]
fn policies() {
    let cells = ObservationSpec::Cells { height: 8, width: 8, classes: 4 };
    let vector = ObservationSpec::Vector { len: 6 };
    for action in [ActionSpec::Discrete { count: 4 }, ActionSpec::Continuous { len: 3 }] {
        check_policy(cells, action, true);
        check_policy(cells, action, false);
        check_policy(vector, action, true);
    }
}

#[test]
fn distributions() {
    let mut stream = random();
    let continuous = ActionSpec::Continuous { len: 3 };
    for (action, squashed) in
        [(ActionSpec::Discrete { count: 5 }, false), (continuous, false), (continuous, true)]
    {
        let distribution = Distribution::new(action, squashed);
        let count = distribution.parameter_count();
        let parameters: Vec<f32> = (0..count).map(|_| 0.5 * normal(&mut stream)).collect();
        let mut bytes = vec![0; action.bytes()];
        for _ in 0..20 {
            let sampled = distribution.sample(&parameters, &mut stream, &mut bytes);
            assert_eq!(sampled, distribution.log_probability(&parameters, &bytes));
            // The clamped logarithm of the standard deviation has a kink.
            let step = if squashed { 1e-3 } else { 5e-3 };
            let expected = differences(&parameters, step, |parameters| {
                let log_probability = distribution.log_probability(parameters, &bytes);
                1.5 * f64::from(log_probability) - 0.7 * f64::from(distribution.entropy(parameters))
            });
            let mut gradient = vec![0.0; count];
            distribution.gradient(&parameters, &bytes, 1.5, -0.7, &mut gradient);
            assert_close(&format!("{distribution:?}"), &gradient, &expected, 0.01);
        }
    }
}

#[test]
fn samples_follow_the_distribution() {
    let mut stream = random();
    let draws = 40_000;
    let categorical = Distribution::Categorical { count: 3 };
    let logits = [0.2_f32.ln(), 0.5_f32.ln() + 0.0, 0.3_f32.ln()];
    let mut counts = [0; 3];
    for _ in 0..draws {
        let mut action = [0];
        categorical.sample(&logits, &mut stream, &mut action);
        counts[usize::from(action[0])] += 1;
    }
    for (count, probability) in counts.into_iter().zip([0.2, 0.5, 0.3]) {
        assert!((f64::from(count) / f64::from(draws) - probability).abs() < 0.01, "{counts:?}");
    }
    let gaussian = Distribution::Gaussian { len: 1 };
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..draws {
        let mut action = [0; 4];
        gaussian.sample(&[2.0, 0.5_f32.ln()], &mut stream, &mut action);
        let number = f64::from(f32::from_le_bytes(action));
        (sum, squares) = (sum + number, squares + (number - 2.0) * (number - 2.0));
    }
    assert!((sum / f64::from(draws) - 2.0).abs() < 0.02);
    assert!((squares / f64::from(draws) - 0.25).abs() < 0.01);
    let mut action = [0];
    categorical.mode(&[1.0, 3.0, 3.0], &mut action);
    assert_eq!(action, [1]);
}

#[test]
fn losses() {
    let targets = [0.5, -1.0, 2.0];
    let predictions = [0.1, 0.3, 2.5];
    let mut gradient = [0.0; 3];
    let expected = differences(&predictions, 1e-3, |predictions| {
        squared_error(predictions, &targets, 0.25, &mut [0.0; 3])
    });
    squared_error(&predictions, &targets, 0.25, &mut gradient);
    assert_close("squared error", &gradient, &expected, 1e-3);
    for label in [0.0, 1.0] {
        let expected = differences(&predictions, 1e-3, |predictions| {
            binary_cross_entropy(predictions, label, 0.25, &mut [0.0; 3])
        });
        binary_cross_entropy(&predictions, label, 0.25, &mut gradient);
        assert_close("cross entropy", &gradient, &expected, 1e-3);
    }
    let pairs = [0.1, 2.5, 0.3, -1.0];
    let mut gradient = [0.0; 4];
    let loss = |pairs: &[f32], gradient: &mut [f32; 4]| {
        let (above, below) = gradient.split_at_mut(2);
        ranking(&pairs[..2], &pairs[2..], 0.5, [above, below])
    };
    let expected = differences(&pairs, 1e-3, |pairs| loss(pairs, &mut [0.0; 4]));
    loss(&pairs, &mut gradient);
    assert_close("ranking", &gradient, &expected, 1e-3);
}

#[test]
fn losses_have_the_values_of_the_definition() {
    let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-6, "{found}");
    let (two, three) = (2.0_f64, 3.0_f64);
    let expert = -(1.0 / (1.0 + (-two).exp())).ln() - (1.0 / (1.0 + three.exp())).ln();
    close(binary_cross_entropy(&[2.0, -3.0], 1.0, 1.0, &mut [0.0; 2]), expert);
    let agent = -(1.0 - 1.0 / (1.0 + (-two).exp())).ln();
    close(binary_cross_entropy(&[2.0], 0.0, 1.0, &mut [0.0]), agent);
    let above = -(1.0 / (1.0 + (-two).exp())).ln();
    close(ranking(&[1.5], &[-0.5], 1.0, [&mut [0.0], &mut [0.0]]), above);
    assert_eq!((sigmoid(200.0), sigmoid(-200.0), sigmoid(0.0)), (1.0, 0.0, 0.5));
    assert_eq!((softplus(200.0), softplus(-200.0)), (200.0, 0.0));
}
