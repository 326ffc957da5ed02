//! Measures steps per second of every task under random actions. As in an actor, every step writes the observation,
//! and every episode starts with a reset from a fresh stream.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use environments::{BUILT_IN, Setting};
use protocol::seed::{Purpose, stream};
use protocol::task::{ActionSpec, write_floats};
use rand::RngExt;
use std::hint::black_box;

/// Number of actions drawn before timing starts; they are used in turn.
const ACTIONS: usize = 4096;

fn random_steps(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("random_steps");
    group.throughput(Throughput::Elements(1));
    for task in BUILT_IN {
        let mut environment = (task.make)(&Setting::default()).expect("the default setting");
        let spec = environment.spec();
        let mut observation = vec![0; spec.observation.bytes()];
        let actions = random_actions(spec.action);
        let mut actions = actions.chunks_exact(spec.action.bytes()).cycle();
        let mut starts = (0..).map(|episode| stream(1, Purpose::TrainingEpisode, 0, episode));
        let mut next_start = move || starts.next().expect("endless");
        environment.reset(&mut next_start(), &mut observation).expect("reset");
        group.bench_function(task.name, |bencher| {
            bencher.iter(|| {
                let action = actions.next().expect("endless");
                let step = environment.step(action, &mut observation).expect("a valid action");
                black_box(&observation);
                if step.ending.is_some() {
                    environment.reset(&mut next_start(), &mut observation).expect("reset");
                }
                step
            });
        });
    }
    group.finish();
}

fn random_actions(spec: ActionSpec) -> Vec<u8> {
    let mut draws = stream(1, Purpose::TrainingActions, 0, 0);
    match spec {
        ActionSpec::Discrete { count } => {
            (0..ACTIONS).map(|_| draws.random_range(0..count as u32) as u8).collect()
        }
        ActionSpec::Continuous { len } => {
            let mut actions = vec![0; 4 * len * ACTIONS];
            write_floats(
                (0..len * ACTIONS).map(|_| draws.random_range(-1.0f32..1.0)),
                &mut actions,
            );
            actions
        }
    }
}

criterion_group!(benches, random_steps);
criterion_main!(benches);
