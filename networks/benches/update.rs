//! Cost of one evaluation and one update of the paper's networks on one core.
//!
//! Run with `cargo bench -p networks -- --quick`. Budgets: 30 us a row for the forward pass over cells, 100 us with
//! the backward pass. A kernel outside the vector registers takes five times as long.
use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::DMatrix;
use networks::{
    ActorCritic, Adam, Batch, Ensemble, Network, PolicyArchitecture, PolicyWorkspace,
    RewardArchitecture, Squashing, Workspace, clip_global_norm,
};
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{ActionSpec, ObservationSpec};
use rand::RngExt;

const CELLS: ObservationSpec = ObservationSpec::Cells { height: 19, width: 19, classes: 4 };
const VECTOR: ObservationSpec = ObservationSpec::Vector { len: 16 };

fn observations(spec: ObservationSpec, rows: usize) -> Vec<u8> {
    let mut stream = stream(1, Purpose::TrainingEpisode, 0, 0);
    match spec {
        ObservationSpec::Cells { height, width, .. } => {
            (0..rows).flat_map(|_| four_rooms(height, width, &mut stream)).collect()
        }
        ObservationSpec::Vector { len } => {
            (0..rows * len).flat_map(|_| stream.random::<f32>().to_le_bytes()).collect()
        }
    }
}

/// Draws a grid like those of NAVIGATION: the cost of a layer depends on how repetitive the grid is.
fn four_rooms(height: usize, width: usize, stream: &mut Stream) -> Vec<u8> {
    let (empty, wall, goal, agent) = (0, 1, 2, 3);
    let is_wall = |at: usize, size: usize| at.is_multiple_of(size / 2);
    let cell =
        |y: usize, x: usize| if is_wall(y, height) || is_wall(x, width) { wall } else { empty };
    let mut grid: Vec<u8> =
        (0..height * width).map(|index| cell(index / width, index % width)).collect();
    for (rows, columns) in [(1..9, 9..10), (10..18, 9..10), (9..10, 1..9), (9..10, 10..18)] {
        grid[stream.random_range(rows) * width + stream.random_range(columns)] = empty;
    }
    for class in [goal, agent] {
        let free: Vec<usize> = (0..grid.len()).filter(|&index| grid[index] == empty).collect();
        grid[free[stream.random_range(0..free.len())]] = class;
    }
    grid
}

/// Benchmarks acting, forward and backward pass on `rows`, and separately preparation, clipping and Adam.
fn policy(
    criterion: &mut Criterion,
    name: &str,
    spec: ObservationSpec,
    action: ActionSpec,
    rows: usize,
) {
    let policy = ActorCritic::new(spec, action, &PolicyArchitecture::default());
    let mut parameters = policy.initial_parameters(&mut stream(1, Purpose::PolicyWeights, 0, 0));
    let bytes = observations(spec, rows);
    let batch = Batch::new(&bytes);
    let mut workspace = PolicyWorkspace::default();
    let mut prepared = policy.prepare(&parameters);
    let mut gradient = vec![0.0; parameters.len()];
    let mut adam = Adam::new(parameters.len(), 1e-5);
    let gradients = DMatrix::from_element(policy.distribution().parameter_count(), rows, 1e-3);
    let value_gradients = DMatrix::from_element(1, rows, 1e-3);
    let mut group = criterion.benchmark_group(name);
    group.throughput(Throughput::Elements(rows as u64));
    group.bench_function("act", |bencher| {
        bencher.iter(|| black_box(policy.act(&prepared, batch, &mut workspace)[0]));
    });
    group.bench_function("forward and backward", |bencher| {
        bencher.iter(|| {
            policy.forward(&prepared, batch, &mut workspace);
            policy.backward(
                &prepared,
                batch,
                &mut workspace,
                &gradients,
                Some(&value_gradients),
                &mut gradient,
            );
        });
    });
    group.bench_function("prepare, clip and Adam", |bencher| {
        bencher.iter(|| {
            clip_global_norm(&mut gradient, 0.5);
            adam.update(&mut parameters, &gradient, 1e-4);
            policy.prepare_into(&parameters, &mut prepared);
        });
    });
    group.finish();
}

fn policies(criterion: &mut Criterion) {
    let discrete = ActionSpec::Discrete { count: 4 };
    policy(criterion, "cells policy, 32 rows", CELLS, discrete, 32);
    policy(criterion, "cells policy, 64 rows", CELLS, discrete, 64);
    policy(criterion, "vector policy, 128 rows", VECTOR, ActionSpec::Continuous { len: 4 }, 128);
}

fn ensembles(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("proximity ensemble of five");
    for (name, spec, rows) in [("cells", CELLS, 64), ("vector", VECTOR, 128)] {
        let network = Network::new(RewardArchitecture::default().network_shape(spec, 1, 0));
        let streams = (0..5).map(|member| stream(1, Purpose::RewardWeights, member, 0));
        let ensemble = Ensemble::new(network, streams, Squashing::ClampedMean);
        let prepared = ensemble.prepare();
        let bytes = observations(spec, rows);
        let batch = Batch::new(&bytes);
        let mut workspace = Workspace::default();
        group.throughput(Throughput::Elements(rows as u64));
        group.bench_function(format!("{name}: score"), |bencher| {
            bencher.iter(|| ensemble.score(&prepared, batch, &mut workspace));
        });
        let gradients = DMatrix::from_element(1, rows, 1e-3);
        let mut gradient = vec![0.0; ensemble.network.parameter_count()];
        group.bench_function(format!("{name}: one member, forward and backward"), |bencher| {
            bencher.iter(|| {
                let (network, member) = (&ensemble.network, &prepared.members[0]);
                network.forward(member, batch, &mut workspace);
                network.backward(member, batch, &mut workspace, &gradients, &mut gradient);
            });
        });
    }
    group.finish();
}

criterion_group!(benches, policies, ensembles);
criterion_main!(benches);
