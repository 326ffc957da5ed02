//! The cost of the bus: a trajectory from publisher to reader, and a question with its answer between two threads that
//! doorbells wake.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bus::{Bus, BusAddress, Role, TrajectoryHeader};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use protocol::Error;

const PATIENCE: Duration = Duration::from_secs(5);

fn open(address: &BusAddress, name: &str) -> Bus {
    Bus::open(address, name).expect("shared memory has room")
}

/// Measures one reader, including the copies into and out of shared memory, and the two bells.
fn trajectories(criterion: &mut Criterion) {
    let address = BusAddress::unique_for_test();
    let mut group = criterion.benchmark_group("trajectory");
    {
        let bus = open(&address, "both");
        let subscriber = bus.trajectory_subscriber().expect("opens");
        let publisher = bus.trajectory_publisher(PATIENCE).expect("opens");
        for (name, length) in [("4 KB", 4 << 10), ("36 KB", 36 << 10)] {
            let bytes = vec![7; length];
            group.throughput(Throughput::Bytes(length as u64));
            group.bench_function(name, |bencher| {
                bencher.iter(|| {
                    publisher.publish(&bytes, TrajectoryHeader::default()).expect("is delivered");
                    subscriber.receive().expect("is received")
                });
            });
        }
    }
    group.finish();
    address.remove().expect("nobody is alive");
}

/// Measures a question with its answer. Server and client each sleep on their own bell.
fn questions(criterion: &mut Criterion) {
    let address = BusAddress::unique_for_test();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let bus = open(&address, "proximity-service");
            let server = bus.score_server().expect("opens");
            let doorbell = bus.doorbell(Role::ProximityService).expect("opens");
            while !stop.load(Ordering::Relaxed) {
                while let Some(request) = server.receive().expect("is received") {
                    let answer = vec![1; request.bytes().len() / 4];
                    request.reply(&answer).expect("is answered");
                }
                doorbell.wait(Duration::from_millis(100)).expect("the bell is whole");
            }
        });
        let bus = open(&address, "learner");
        let doorbell = bus.doorbell(Role::Learner).expect("opens");
        let client = bus.score_client(&doorbell).expect("opens");
        let mut group = criterion.benchmark_group("question");
        for (name, length) in [("64 B", 64), ("1 MB", 1 << 20)] {
            let question = vec![7; length];
            group.throughput(Throughput::Bytes(length as u64));
            group.bench_function(name, |bencher| {
                bencher.iter(|| {
                    client
                        .ask(&question, &doorbell, Some, || Ok::<_, Error>(()))
                        .expect("is answered")
                });
            });
        }
        group.finish();
        stop.store(true, Ordering::Relaxed);
    });
    address.remove().expect("nobody is alive");
}

criterion_group! {
    name = bus;
    config = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2));
    targets = trajectories, questions
}
criterion_main!(bus);
