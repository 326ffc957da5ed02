//! A row has the same bits in any batch, and a training step has the same bits on any number of threads.
use nalgebra::DMatrix;
use networks::{
    ActorCritic, Batch, Network, PolicyArchitecture, RewardArchitecture, Shard, ShardedTrainer,
    Workspace,
};
use protocol::encoder::CellsArchitecture;
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{ActionSpec, ObservationSpec};
use rand::RngExt;

const CELLS: ObservationSpec = ObservationSpec::Cells { height: 19, width: 19, classes: 4 };
const VECTOR: ObservationSpec = ObservationSpec::Vector { len: 13 };

fn random() -> Stream {
    stream(3, Purpose::RewardWeights, 0, 0)
}

fn observations(spec: ObservationSpec, rows: usize) -> Vec<u8> {
    let mut stream = random();
    match spec {
        ObservationSpec::Cells { height, width, classes } => {
            // Mostly empty cells; the second half of the rows repeats the first.
            let mut cell = || match stream.random_range(0..8) {
                0 => stream.random_range(0..classes as u8),
                _ => 0,
            };
            let half = rows.div_ceil(2) * height * width;
            let cells: Vec<u8> = (0..half).map(|_| cell()).collect();
            cells.iter().cycle().take(rows * height * width).copied().collect()
        }
        ObservationSpec::Vector { len } => {
            (0..rows * len).flat_map(|_| (stream.random::<f32>() - 0.5).to_le_bytes()).collect()
        }
    }
}

#[test]
fn a_rows_bits_do_not_depend_on_its_batch() {
    for spec in [CELLS, VECTOR] {
        let network = Network::new(RewardArchitecture::default().network_shape(spec, 1, 0));
        let prepared = network.prepare(&network.initial_parameters(&mut random()));
        let mut workspace = Workspace::default();
        let bytes = observations(spec, 40);
        let mut alone = Vec::new();
        for row in bytes.chunks(spec.bytes()) {
            alone.push(network.forward(&prepared, Batch::new(row), &mut workspace)[0].to_bits());
        }
        for size in 1..=40 {
            for first in [0, (40 - size) / 2, 40 - size] {
                let rows = &bytes[first * spec.bytes()..(first + size) * spec.bytes()];
                let found = network.forward(&prepared, Batch::new(rows), &mut workspace);
                let found: Vec<_> = found.iter().map(|output| output.to_bits()).collect();
                assert_eq!(found, alone[first..first + size], "{size} rows of {spec:?}");
            }
        }
    }
}

/// Takes two steps on 48 rows, in shards of eight, and returns the parameters and the norms of the gradients.
fn trained(policy: &ActorCritic, spec: ObservationSpec, threads: usize) -> (Vec<u32>, [u64; 2]) {
    let mut parameters = policy.initial_parameters(&mut random());
    let bytes = observations(spec, 48);
    let gradient_of = |shard: Shard<'_, ActorCritic>, gradient: &mut [f32]| {
        let Shard { network, prepared, batch, workspace, .. } = shard;
        let found = network.forward(prepared, batch, workspace);
        let (of_parameters, of_values): (DMatrix<f32>, DMatrix<f32>) =
            (found.parameters.map(|number| number - 0.3), found.values.map(|value| value - 1.0));
        network.backward(prepared, batch, workspace, &of_parameters, Some(&of_values), gradient);
        0.0
    };
    // With so large an epsilon, Adam's first steps depend on more than the signs of the gradient.
    let mut trainer = ShardedTrainer::new(parameters.len(), 1.0, f64::INFINITY);
    let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let threads = threads.expect("threads");
    let mut step = || {
        let batch = Batch::new(&bytes);
        let step = || trainer.step(policy, &mut parameters, batch, 8, 0.1, gradient_of);
        threads.install(step).gradient_norm.to_bits()
    };
    let norms = [step(), step()];
    (parameters.iter().map(|parameter| parameter.to_bits()).collect(), norms)
}

#[test]
fn a_training_steps_bits_do_not_depend_on_threads() {
    let architecture = PolicyArchitecture {
        cells: CellsArchitecture { channels: vec![7, 9, 20], ..CellsArchitecture::default() },
        ..PolicyArchitecture::default()
    };
    for (spec, action) in
        [(CELLS, ActionSpec::Discrete { count: 4 }), (VECTOR, ActionSpec::Continuous { len: 3 })]
    {
        let policy = ActorCritic::new(spec, action, &architecture);
        let alone = trained(&policy, spec, 1);
        for threads in [2, 3, 6] {
            assert!(trained(&policy, spec, threads) == alone, "{threads} threads");
        }
    }
}

#[test]
fn equal_rows_weigh_as_often_as_they_are_there() {
    let network = Network::new(RewardArchitecture::default().network_shape(CELLS, 1, 0));
    let prepared = network.prepare(&network.initial_parameters(&mut random()));
    let bytes = observations(CELLS, 12);
    let mut workspace = Workspace::default();
    let mut gradient = |rows: &[u8]| {
        let batch = Batch::new(rows);
        network.forward(&prepared, batch, &mut workspace);
        let ones = DMatrix::from_element(1, rows.len() / CELLS.bytes(), 1.0);
        let mut gradient = vec![0.0; network.parameter_count()];
        network.backward(&prepared, batch, &mut workspace, &ones, &mut gradient);
        gradient
    };
    let together = gradient(&bytes);
    let mut alone = vec![0.0; together.len()];
    for row in bytes.chunks(CELLS.bytes()) {
        alone.iter_mut().zip(gradient(row)).for_each(|(sum, derivative)| *sum += derivative);
    }
    let norm = |numbers: &mut dyn Iterator<Item = f32>| {
        numbers.map(|number| f64::from(number).powi(2)).sum::<f64>().sqrt()
    };
    let error = norm(&mut together.iter().zip(&alone).map(|(one, other)| one - other));
    assert!(error < 1e-5 * norm(&mut alone.iter().copied()), "the sums differ by {error:e}");
}
