//! What the bus guarantees to its members, tested with threads. Tests with real processes, which are killed, are in
//! `processes`.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod address;
mod processes;

use std::sync::Barrier;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use bus::{
    Bus, BusAddress, Published, Role, TRAJECTORY_BUFFER, TrajectoryHeader, TrajectorySubscriber,
    check_shared_memory_room,
};
use protocol::Error;

const WATCHDOG: Duration = Duration::from_secs(60);
const LONG: Duration = Duration::from_secs(20);
const SHORT: Duration = Duration::from_millis(100);

/// Runs `body` on an address of its own and removes what is left; fails if it takes too long.
fn watched(body: fn(&BusAddress)) {
    let (sender, receiver) = sync_channel(1);
    let test = move || {
        let address = BusAddress::unique_for_test();
        body(&address);
        address.remove().unwrap();
        sender.send(()).unwrap();
    };
    let thread = thread::Builder::new().name("test".to_owned()).spawn(test).unwrap();
    match receiver.recv_timeout(WATCHDOG) {
        Ok(()) | Err(RecvTimeoutError::Disconnected) => thread.join().unwrap(),
        Err(RecvTimeoutError::Timeout) => panic!("still running after {WATCHDOG:?}"),
    }
}

fn open(address: &BusAddress, name: &str) -> Bus {
    Bus::open(address, name).unwrap()
}

/// Returns a `keep_waiting` like the learner's, which cleans up dead processes and fails after `longest`.
fn patience(bus: &Bus, longest: Duration) -> impl FnMut() -> Result<(), Error> {
    let start = Instant::now();
    move || {
        bus.clean_up();
        if start.elapsed() < longest { Ok(()) } else { Err(given_up()) }
    }
}

fn given_up() -> Error {
    let message = "not any more".to_owned();
    Error::Bus { operation: "waiting", service: "leases".to_owned(), message }
}

/// Polls until `look` finds something; otherwise the watchdog ends the test.
fn until<T>(mut look: impl FnMut() -> Option<T>) -> T {
    loop {
        if let Some(found) = look() {
            return found;
        }
        thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn late_reader_gets_the_newest_weights() {
    watched(|address| {
        let learner = open(address, "learner");
        let publisher = learner.weights_publisher(1 << 20).unwrap();
        for version in 1..=5_u8 {
            publisher.publish(&vec![version; 600_000]).unwrap();
        }
        let actor = open(address, "actor-0");
        let subscriber = actor.weights_subscriber().unwrap();
        assert!(subscriber.receive().unwrap().is_none(), "nothing before the learner refreshes");
        publisher.refresh().unwrap();
        for version in [4, 5] {
            let weights = subscriber.receive().unwrap().expect("history of two");
            assert_eq!(weights, vec![version; 600_000]);
        }
        assert!(subscriber.receive().unwrap().is_none());
        let error = publisher.publish(&vec![0; (1 << 20) + 1]).unwrap_err().to_string();
        assert!(error.contains("weights") && error.contains("ExceedsMaxLoanSize"), "{error}");
    });
}

const ACTORS: u64 = 8;
const TRAJECTORIES: u64 = 300;

fn trajectory(lane: u64, episode: u64) -> (TrajectoryHeader, Vec<u8>) {
    let bytes = vec![(lane * 31 + episode) as u8; 2_000 + (episode as usize * 977) % 38_000];
    let hash = lane << 32 | episode;
    (TrajectoryHeader { iteration: 7, lane, episode, hash }, bytes)
}

#[test]
fn eight_actors_lose_nothing() {
    watched(|address| {
        // The publishers live until both readers have everything, as actors live until they are told that the run is
        // over.
        let done = Barrier::new(ACTORS as usize + 2);
        let ready = Barrier::new(ACTORS as usize + 2);
        thread::scope(|scope| {
            for name in ["learner", "proximity-service"] {
                let (ready, done) = (&ready, &done);
                scope.spawn(move || {
                    let bus = open(address, name);
                    let subscriber = bus.trajectory_subscriber().unwrap();
                    ready.wait();
                    let mut next = [0; ACTORS as usize];
                    while next.iter().sum::<u64>() < ACTORS * TRAJECTORIES {
                        let Published { header, bytes, process } =
                            until(|| subscriber.receive().unwrap());
                        assert_eq!(process, std::process::id());
                        let expected = trajectory(header.lane, next[header.lane as usize]);
                        assert_eq!((header, bytes.to_vec()), expected);
                        next[header.lane as usize] += 1;
                    }
                    done.wait();
                });
            }
            for lane in 0..ACTORS {
                let (ready, done) = (&ready, &done);
                scope.spawn(move || {
                    let bus = open(address, &format!("actor-{lane}"));
                    let publisher = bus.trajectory_publisher(LONG).unwrap();
                    ready.wait();
                    for episode in 0..TRAJECTORIES {
                        let (header, bytes) = trajectory(lane, episode);
                        assert_eq!(publisher.publish(&bytes, header).unwrap(), 2);
                    }
                    done.wait();
                });
            }
        });
    });
}

#[test]
fn unconnected_reader_is_not_counted() {
    watched(|address| {
        let learner = open(address, "learner");
        let actor = open(address, "actor-0");
        let header = TrajectoryHeader::default();
        let early = actor.trajectory_publisher(LONG).unwrap();
        assert_eq!((early.publish(b"nobody", header).unwrap(), early.reader_count()), (0, 0));

        let subscriber = learner.trajectory_subscriber().unwrap();
        let publisher = actor.trajectory_publisher(LONG).unwrap();
        for _ in 0..TRAJECTORY_BUFFER {
            assert_eq!(publisher.publish(b"queued", header).unwrap(), 1);
        }
        // The reader has received nothing since this publisher was created, so the publisher does not wait.
        assert_eq!((publisher.publish(b"lost", header).unwrap(), publisher.reader_count()), (0, 1));
        for _ in 0..TRAJECTORY_BUFFER {
            assert_eq!(subscriber.receive().unwrap().unwrap().bytes, b"queued"[..]);
        }
        assert!(subscriber.receive().unwrap().is_none());
        assert_eq!(publisher.publish(b"connected", header).unwrap(), 1);
        assert_eq!(subscriber.receive().unwrap().unwrap().bytes, b"connected"[..]);
    });
}

fn drain(subscriber: &TrajectorySubscriber) -> usize {
    std::iter::from_fn(|| subscriber.receive().unwrap()).count()
}

#[test]
fn stuck_reader_makes_publishing_fail() {
    watched(|address| {
        let bus = open(address, "all");
        let publisher = bus.trajectory_publisher(Duration::from_millis(500)).unwrap();
        let (stuck, lively) =
            (bus.trajectory_subscriber().unwrap(), bus.trajectory_subscriber().unwrap());
        for _ in 0..TRAJECTORY_BUFFER {
            assert_eq!(publisher.publish(b"queued", TrajectoryHeader::default()).unwrap(), 2);
        }
        assert_eq!(drain(&lively), TRAJECTORY_BUFFER);
        let start = Instant::now();
        let error =
            publisher.publish(b"late", TrajectoryHeader::default()).unwrap_err().to_string();
        assert!(error.contains("trajectories") && error.contains("UnableToDeliver"), "{error}");
        assert!((400..5_000).contains(&start.elapsed().as_millis()), "{:?}", start.elapsed());
        assert_eq!(drain(&lively), 1, "the other reader has it");
        assert_eq!(drain(&stuck), TRAJECTORY_BUFFER);
        assert_eq!(publisher.publish(b"again", TrajectoryHeader::default()).unwrap(), 2);
    });
}

#[test]
fn question_of_four_megabytes() {
    watched(|address| {
        thread::scope(|scope| {
            scope.spawn(|| {
                let bus = open(address, "proximity-service");
                let server = bus.score_server().unwrap();
                let doorbell = bus.doorbell(Role::ProximityService).unwrap();
                for _ in 0..5 {
                    let request = until(|| {
                        doorbell.wait(SHORT).unwrap();
                        server.receive().unwrap()
                    });
                    let answer: Vec<u8> =
                        request.bytes().iter().step_by(4).map(|byte| !byte).collect();
                    request.reply(&answer).unwrap();
                }
                // If the server ended at once, its last answer would be lost.
                thread::sleep(Duration::from_millis(200));
            });
            let bus = open(address, "learner");
            let doorbell = bus.doorbell(Role::Learner).unwrap();
            let client = bus.score_client(&doorbell).unwrap();
            for round in 0..5_usize {
                let question: Vec<u8> =
                    (0..4 << 20).map(|index| (index * 7 + round) as u8).collect();
                let answer = client.ask(&question, &doorbell, Some, patience(&bus, LONG)).unwrap();
                let expected: Vec<u8> = question.iter().step_by(4).map(|byte| !byte).collect();
                assert!(answer == expected, "answer of round {round}");
            }
        });
    });
}

#[test]
fn nobody_to_ask_is_an_error() {
    watched(|address| {
        let bus = open(address, "actor-0");
        let doorbell = bus.doorbell(Role::Actors).unwrap();
        let client = bus.lease_client(&doorbell).unwrap();
        let error = client.send(b"leases?").unwrap_err().to_string();
        assert!(
            error.contains("leases") && error.contains("expected a process that answers"),
            "{error}"
        );
        let mut looks = 0;
        let keep_waiting = || {
            looks += 1;
            if looks < 3 { Ok(()) } else { Err(given_up()) }
        };
        let error = client.ask(b"leases?", &doorbell, Some, keep_waiting).unwrap_err().to_string();
        assert!(error.contains("not any more") && looks == 3, "{error} after {looks} looks");
    });
}

#[test]
fn server_that_goes_is_noticed() {
    watched(|address| {
        let actor = open(address, "actor-0");
        let client = actor.lease_client(&actor.doorbell(Role::Actors).unwrap()).unwrap();
        let learner = open(address, "learner");
        let server = learner.lease_server().unwrap();

        let dropped = client.send(b"dropped").unwrap();
        drop(until(|| server.receive().unwrap()));
        assert!(until(|| dropped.poll().transpose()).is_err());

        let answered = client.send(b"answered").unwrap();
        until(|| server.receive().unwrap()).reply(b"yes").unwrap();
        let unanswered = client.send(b"unanswered").unwrap();
        let kept = until(|| server.receive().unwrap());
        assert!(unanswered.poll().unwrap().is_none() && kept.is_awaited());
        drop((kept, server));
        assert_eq!(answered.poll().unwrap().unwrap(), b"yes"[..], "an answer outlives its server");
        let error = until(|| unanswered.poll().transpose()).unwrap_err().to_string();
        assert!(error.contains("gone"), "{error}");
        assert!(client.send(b"gone").is_err());
    });
}

#[test]
fn asking_waits_for_a_server() {
    watched(|address| {
        thread::scope(|scope| {
            scope.spawn(|| {
                thread::sleep(Duration::from_millis(300));
                let bus = open(address, "learner");
                let server = bus.lease_server().unwrap();
                until(|| server.receive().unwrap()).reply(b"here").unwrap();
                thread::sleep(Duration::from_millis(200));
            });
            let bus = open(address, "actor-0");
            let doorbell = bus.doorbell(Role::Actors).unwrap();
            let client = bus.lease_client(&doorbell).unwrap();
            let answer = client.ask(b"?", &doorbell, Some, patience(&bus, LONG)).unwrap();
            assert_eq!(answer, b"here"[..]);
        });
    });
}

#[test]
fn questions_are_answered_in_any_order() {
    watched(|address| {
        let learner = open(address, "learner");
        let server = learner.lease_server().unwrap();
        let actors: Vec<_> =
            (0..8).map(|number| open(address, &format!("actor-{number}"))).collect();
        let bells: Vec<_> =
            actors.iter().map(|actor| actor.doorbell(Role::Actors).unwrap()).collect();
        let clients = actors.iter().zip(&bells);
        let clients: Vec<_> =
            clients.map(|(actor, bell)| actor.lease_client(bell).unwrap()).collect();
        for round in 0..20_u8 {
            let mut pending: Vec<_> =
                clients.iter().map(|client| client.send(&[round]).unwrap()).collect();
            let mut requests: Vec<_> = pending.iter().map(|_| server.receive().unwrap()).collect();
            // The first asker gives up; its question must not disturb the others.
            pending.remove(0);
            requests.reverse();
            let awaited = requests.iter().flatten().filter(|request| request.is_awaited()).count();
            assert_eq!(awaited, 7);
            for request in requests.into_iter().flatten() {
                let question = request.bytes().to_vec();
                request.reply(&question).unwrap();
            }
            for (pending, bell) in pending.iter().zip(&bells[1..]) {
                assert!(bell.wait(SHORT).unwrap(), "an answer rings");
                assert_eq!(pending.poll().unwrap().unwrap(), [round][..]);
            }
        }
    });
}

#[test]
fn progress_never_waits() {
    watched(|address| {
        let learner = open(address, "learner");
        let supervisor = open(address, "supervisor");
        let publisher = learner.progress_publisher(64).unwrap();
        let subscriber = supervisor.progress_subscriber().unwrap();
        let start = Instant::now();
        for step in 0..10_000_u32 {
            publisher.publish(&step.to_le_bytes()).unwrap();
        }
        assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
        assert_eq!(subscriber.receive().unwrap().unwrap(), 9_999_u32.to_le_bytes()[..]);
        assert!(subscriber.receive().unwrap().is_none());
    });
}

#[test]
fn doorbell_wakes_and_never_spins() {
    watched(|address| {
        let (woken, wake_ups) = sync_channel(1);
        let rung = Barrier::new(2);
        thread::scope(|scope| {
            let rung = &rung;
            scope.spawn(move || {
                let bus = open(address, "learner");
                let doorbell = bus.doorbell(Role::Learner).unwrap();
                woken.send(Instant::now()).unwrap();
                for _ in 0..10 {
                    while !doorbell.wait(LONG).unwrap() {}
                    woken.send(Instant::now()).unwrap();
                }
                rung.wait();
                assert!(doorbell.wait(SHORT).unwrap(), "rung while nobody slept");
                // All rings were consumed at once, so every further wait, except perhaps one, takes its full time.
                let start = Instant::now();
                for _ in 0..10 {
                    assert!(!doorbell.wait(SHORT).unwrap());
                }
                assert!(start.elapsed() >= SHORT * 8, "{:?}", start.elapsed());
                assert!(!doorbell.wait(Duration::ZERO).unwrap(), "no wait is no endless one");
            });
            let bus = open(address, "actor-0");
            let ringer = bus.ringer(Role::Learner).unwrap();
            wake_ups.recv_timeout(LONG).unwrap();
            let mut delays = Vec::new();
            for _ in 0..10 {
                thread::sleep(Duration::from_millis(20));
                let start = Instant::now();
                ringer.ring().unwrap();
                delays.push(wake_ups.recv_timeout(LONG).unwrap().saturating_duration_since(start));
            }
            delays.sort();
            assert!(delays[5] < Duration::from_millis(50), "{delays:?}");
            for _ in 0..1_000 {
                ringer.ring().unwrap();
            }
            rung.wait();
        });
    });
}

#[test]
fn two_buses_never_meet() {
    watched(|address| {
        let other_address = BusAddress::unique_for_test();
        let here = open(address, "here");
        let there = open(&other_address, "there");
        let (server, subscriber) =
            (there.lease_server().unwrap(), there.trajectory_subscriber().unwrap());
        let bell = there.doorbell(Role::Learner).unwrap();
        let doorbell = here.doorbell(Role::Actors).unwrap();
        assert!(here.lease_client(&doorbell).unwrap().send(b"?").is_err());
        let publisher = here.trajectory_publisher(LONG).unwrap();
        assert_eq!(publisher.publish(b"!", TrajectoryHeader::default()).unwrap(), 0);
        assert!(!bell.wait(SHORT).unwrap());
        assert!(server.receive().unwrap().is_none() && subscriber.receive().unwrap().is_none());
        assert_eq!(here.alive().unwrap(), ["here"]);
        assert_eq!(there.alive().unwrap(), ["there"]);
        drop((server, subscriber, bell, there));
        other_address.remove().unwrap();
        assert_eq!(here.alive().unwrap(), ["here"]);
    });
}

#[test]
fn room_in_shared_memory_is_checked() {
    check_shared_memory_room(1 << 20).unwrap();
    let error = check_shared_memory_room(u64::MAX / 2).unwrap_err().to_string();
    assert!(error.contains("/dev/shm") && error.contains("MiB needed"), "{error}");
}
