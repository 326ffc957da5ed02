//! Checks networks, losses, gradients, clipping and Adam against PyTorch.
//!
//! `pytorch_vectors.safetensors` was made by `pytorch_vectors.py` with PyTorch 2.5.1. For each case it has
//! parameters, a batch, PyTorch's results for them, and the parameters after five steps.
use nalgebra::DMatrix;
use networks::{
    ActorCritic, Adam, Batch, Network, PolicyArchitecture, PolicyWorkspace, RewardArchitecture,
    Workspace, clip_global_norm, squared_error,
};
use protocol::encoder::CellsArchitecture;
use protocol::task::{ActionSpec, ObservationSpec, floats};
use safetensors::SafeTensors;

const CELLS: ObservationSpec = ObservationSpec::Cells { height: 9, width: 9, classes: 4 };
const VECTOR: ObservationSpec = ObservationSpec::Vector { len: 7 };
const HIDDEN: [usize; 2] = [20, 18];

fn cells() -> CellsArchitecture {
    CellsArchitecture { channels: vec![5, 18, 20], kernel: 2, pool: 2, features: 17 }
}

/// One case of the file.
struct Case {
    name: &'static str,
    tensors: SafeTensors<'static>,
}

impl Case {
    fn open(name: &'static str) -> Self {
        let bytes = include_bytes!("pytorch_vectors.safetensors");
        Self { name, tensors: SafeTensors::deserialize(bytes).expect("the file is whole") }
    }

    fn bytes(&self, key: &str) -> &'static [u8] {
        let key = format!("{}.{key}", self.name);
        self.tensors.tensor(&key).unwrap_or_else(|error| panic!("{key}: {error}")).data()
    }

    fn numbers(&self, key: &str) -> Vec<f32> {
        floats(self.bytes(key)).collect()
    }

    fn assert_close(&self, key: &str, found: &[f32], tolerance: f32) {
        let expected = self.numbers(key);
        assert_eq!(found.len(), expected.len(), "{}.{key}", self.name);
        let largest = expected.iter().fold(0.0_f32, |largest, number| largest.max(number.abs()));
        for (index, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let error = (found - expected).abs();
            let what = format!("{}.{key}[{index}]", self.name);
            assert!(error <= tolerance * largest, "{what} is {found}, PyTorch has {expected}");
        }
    }

    /// Takes five clipped steps of Adam; `gradient` writes the gradient and returns the loss.
    fn train(&self, mut gradient: impl FnMut(&[f32], &mut [f32]) -> f32) {
        let mut parameters = self.numbers("parameters");
        let mut adam = Adam::new(parameters.len(), 1e-5);
        for step in 0..5 {
            let mut gradients = vec![0.0; parameters.len()];
            let loss = gradient(&parameters, &mut gradients);
            if step == 0 {
                self.assert_close("loss", &[loss], 1e-5);
                self.assert_close("gradient", &gradients, 1e-5);
            }
            let norm = clip_global_norm(&mut gradients, 0.5);
            if step == 0 {
                self.assert_close("norm", &[norm as f32], 1e-5);
            }
            adam.update(&mut parameters, &gradients, 1e-3);
        }
        self.assert_close("trained", &parameters, 1e-5);
    }
}

fn check_policy(case: &Case, policy: &ActorCritic) {
    let batch = Batch::new(case.bytes("observations"));
    let (advantages, returns) = (case.numbers("advantages"), case.numbers("returns"));
    let (rows, distribution) = (advantages.len(), policy.distribution());
    let actions = case.bytes("actions");
    let mut workspace = PolicyWorkspace::default();
    case.train(|parameters, gradient| {
        let prepared = policy.prepare(parameters);
        let found = policy.forward(&prepared, batch, &mut workspace);
        let mut gradients = found.parameters.clone();
        let mut value_gradients = found.values.clone();
        let (mut log_probabilities, mut entropies) = (Vec::new(), Vec::new());
        let weight = 1.0 / rows as f32;
        let mut loss = squared_error(
            found.values.as_slice(),
            &returns,
            0.5 * weight,
            value_gradients.as_mut_slice(),
        );
        for (row, action) in actions.chunks_exact(actions.len() / rows).enumerate() {
            let (column, advantage) = (found.parameters.column(row), advantages[row]);
            log_probabilities.push(distribution.log_probability(column.as_slice(), action));
            entropies.push(distribution.entropy(column.as_slice()));
            let own = log_probabilities[row] * advantage + 0.01 * entropies[row];
            loss -= f64::from(weight * own);
            let mut derivative = vec![0.0; distribution.parameter_count()];
            let (along, entropy) = (-weight * advantage, -0.01 * weight);
            distribution.gradient(column.as_slice(), action, along, entropy, &mut derivative);
            gradients.column_mut(row).copy_from_slice(&derivative);
        }
        if parameters == case.numbers("parameters") {
            case.assert_close("log_probabilities", &log_probabilities, 1e-5);
            case.assert_close("entropies", &entropies, 1e-5);
            case.assert_close("values", found.values.as_slice(), 1e-5);
        }
        policy.backward(
            &prepared,
            batch,
            &mut workspace,
            &gradients,
            Some(&value_gradients),
            gradient,
        );
        loss as f32
    });
}

#[test]
fn cells_policy() {
    let architecture = PolicyArchitecture { cells: cells(), ..PolicyArchitecture::default() };
    let policy = ActorCritic::new(CELLS, ActionSpec::Discrete { count: 4 }, &architecture);
    check_policy(&Case::open("cells_policy"), &policy);
}

#[test]
fn vector_policy() {
    let hidden = HIDDEN.to_vec();
    let architecture = PolicyArchitecture { hidden, ..PolicyArchitecture::default() };
    let policy = ActorCritic::new(VECTOR, ActionSpec::Continuous { len: 3 }, &architecture);
    check_policy(&Case::open("vector_policy"), &policy);
}

#[test]
fn cells_proximity() {
    let case = Case::open("cells_proximity");
    let architecture = RewardArchitecture {
        cells: cells(),
        hidden: HIDDEN.to_vec(),
        ..RewardArchitecture::default()
    };
    let network = Network::new(architecture.network_shape(CELLS, 1, 0));
    let batch = Batch::new(case.bytes("observations"));
    let targets = case.numbers("targets");
    let mut workspace = Workspace::default();
    case.train(|parameters, gradient| {
        let prepared = network.prepare(parameters);
        let outputs = network.forward(&prepared, batch, &mut workspace).clone();
        if parameters == case.numbers("parameters") {
            case.assert_close("outputs", outputs.as_slice(), 1e-5);
        }
        let mut gradients = DMatrix::zeros(1, targets.len());
        let weight = 1.0 / targets.len() as f32;
        let loss = squared_error(outputs.as_slice(), &targets, weight, gradients.as_mut_slice());
        network.backward(&prepared, batch, &mut workspace, &gradients, gradient);
        loss as f32
    });
}
