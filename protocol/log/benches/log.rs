//! Speed and size of the log with episodes like NAVIGATION's: 100 steps, 36 kB of cells.
//!
//! Numbers that come from learning (log-probabilities, rewards, proximity, uncertainty) are drawn at random here, so
//! that they compress no better than in a run.
#![expect(clippy::print_stdout, reason = "a bench reports to the terminal")]

use std::hint::black_box;
use std::path::Path;

use bytes::Bytes;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mcap_log::{Contents, FileReader, FileWriter, Kind, Metadata, Topic};
use prost::Message;
use protocol::messages::Score;
use protocol::trajectory::Trajectory;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const EPISODES: u64 = 256;
const STEPS: usize = 100;
const SIDE: usize = 19;

/// Returns a grid of the four rooms: walls around and across, goal, agent.
fn grid(agent: usize, goal: usize) -> [u8; SIDE * SIDE] {
    let mut cells = [0; SIDE * SIDE];
    for (place, cell) in cells.iter_mut().enumerate() {
        let [row, column] = [place / SIDE, place % SIDE];
        let wall = [row, column].iter().any(|&line| line % 9 == 0) && row % 9 != 4;
        *cell = u8::from(wall);
    }
    cells[goal] = 3;
    cells[agent] = 2;
    cells
}

fn numbers(noise: &mut ChaCha8Rng, count: usize) -> Vec<f32> {
    (0..count).map(|_| noise.next_u32() as f32 / 4e9).collect()
}

fn episode(episode: u64) -> (Vec<u8>, Vec<u8>) {
    let mut noise = ChaCha8Rng::seed_from_u64(episode);
    let mut draw = |below: usize| noise.next_u32() as usize % below;
    let (mut agent, goal) = (SIDE + draw(17 * SIDE), SIDE + draw(17 * SIDE));
    let (mut cells, mut actions) = (grid(agent, goal).to_vec(), Vec::new());
    for _ in 0..STEPS {
        let action = draw(4);
        let moved = [agent + 1, agent - 1, agent + SIDE, agent - SIDE][action];
        agent = if (SIDE..18 * SIDE).contains(&moved) { moved } else { agent };
        actions.push(action as u8);
        cells.extend(grid(agent, goal));
    }
    let log_probs = numbers(&mut noise, STEPS);
    let trajectory = Trajectory {
        task: "navigation".to_owned(),
        episode,
        steps: STEPS as u32,
        observation_shape: vec![SIDE as u32, SIDE as u32],
        cells: cells.into(),
        discrete_actions: actions.into(),
        log_probs: log_probs.iter().flat_map(|number| number.to_le_bytes()).collect(),
        environment_rewards: Bytes::from(vec![0; 4 * STEPS]),
        state_hash: noise.next_u64(),
        ..Trajectory::default()
    };
    let score = Score {
        episode,
        rewards: numbers(&mut noise, STEPS),
        proximity: numbers(&mut noise, STEPS + 1),
        uncertainty: numbers(&mut noise, STEPS + 1),
        ..Score::default()
    };
    (trajectory.encode_to_vec(), score.encode_to_vec())
}

fn write(path: &Path, episodes: &[(Vec<u8>, Vec<u8>)]) -> FileWriter {
    let metadata = Metadata::new(Kind::Run, "navigation", 1);
    let topics = Contents::Trajectories.topics();
    let mut writer = FileWriter::create(path, &metadata, topics).expect("there is room");
    for (time, (trajectory, score)) in (0..).zip(episodes) {
        writer.message(Topic::Trajectory, time, trajectory).expect("there is room");
        writer.message(Topic::Score, time, score).expect("there is room");
    }
    writer.flush().expect("there is room");
    writer
}

fn log(criterion: &mut Criterion) {
    let episodes: Vec<_> = (0..EPISODES).map(episode).collect();
    let bytes: usize = episodes.iter().map(|(episode, score)| episode.len() + score.len()).sum();
    let folder = tempfile::tempdir().expect("there is room");
    let path = folder.path().join("read.mcap");
    write(&path, &episodes).seal().expect("there is room");
    let size = path.metadata().expect("it was just written").len() as f64;
    let per_step = size / (EPISODES as f64 * STEPS as f64);
    println!("log: {per_step:.1} bytes a step; {:.0} MB for 3 M steps", 3.0 * per_step);

    let mut group = criterion.benchmark_group("log");
    group.throughput(Throughput::Bytes(bytes as u64)).sample_size(20);
    let mut number = 0;
    group.bench_function("write", |bencher| {
        bencher.iter(|| {
            number += 1;
            let path = folder.path().join(format!("{number}.mcap"));
            drop(write(&path, &episodes));
            std::fs::remove_file(path.with_extension("mcap.active")).expect("it was written");
        });
    });
    group.bench_function("read", |bencher| {
        bencher.iter(|| {
            let reader = FileReader::open(&path).expect("it was written");
            black_box(reader.map(|entry| entry.is_ok()).filter(|&intact| intact).count())
        });
    });
    group.finish();
}

criterion_group!(benches, log);
criterion_main!(benches);
