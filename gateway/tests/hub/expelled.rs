//! Hosts that are expelled: those that send too much at once or what is not of the run, and those that come back.

use bytes::Bytes;
use gateway::host::connect;
use gateway::messages::{ACTORS, Beat, Exchange, FINISHED, Hello, REQUEST_BYTES, TOGETHER};
use prost::Message;
use protocol::trajectory::Trajectory;
use run::hosts::{Expelled, Hosts};
use tonic::{Code, Status};

use crate::stage::{Stage, block_on};

/// Number of empty leases: each takes two bytes of a message, and many more in memory.
const LEASES: usize = 4 << 20;

/// Returns an encoded lease request that hands back `count` empty leases.
fn handing_back(count: usize) -> Option<Bytes> {
    Some([0x1a_u8, 0].repeat(count).into())
}

/// Returns the hello of a host with a name of its own.
fn hello(stage: &Stage, session: u64) -> Hello {
    Hello { host: format!("host-{session}"), ..stage.hello(session) }
}

fn assert_expelled(refusal: &Status, expected: &str) {
    assert_eq!(refusal.code(), Code::PermissionDenied, "{refusal}");
    assert!(refusal.message().contains(expected), "{refusal}");
}

#[test]
fn a_host_that_sends_too_much_at_once_is_expelled() {
    let stage = Stage::new();
    let of_bytes = format!("at most {REQUEST_BYTES} bytes, found {}", 2 * LEASES);
    let (few, many) = (REQUEST_BYTES / 2, TOGETHER + 1);
    let greedy = [
        (handing_back(LEASES), 0, of_bytes),
        (handing_back(few), 0, format!("at most {FINISHED} finished leases, found {few}")),
        (None, many, format!("at most {TOGETHER} trajectories, found {many}")),
    ];
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        for (session, (request, count, expected)) in (1..).zip(greedy) {
            hub.hello(hello(&stage, session)).await.unwrap();
            let trajectories = vec![Bytes::new(); count];
            let exchange = Exchange { session, trajectories, number: 1, request };
            assert_expelled(&hub.exchange(exchange).await.unwrap_err(), &expected);
        }
        hub.hello(hello(&stage, 9)).await.unwrap();
        let actors = vec![String::new(); ACTORS + 1];
        let beat = Beat { session: 9, actors, distance_ms: None };
        let expected = format!("at most {ACTORS} actors of a host, found {}", ACTORS + 1);
        assert_expelled(&hub.beat(beat).await.unwrap_err(), &expected);
        stage.await_hosts(|hosts| hosts.expelled.len() == 4).await;
    });
    assert!(stage.leases.receive().unwrap().is_none());
}

#[test]
fn a_trajectory_is_nothing_but_an_episode_of_the_runs_task() {
    let stage = Stage::new();
    let honest = stage.episode(3, stage.config.seed);
    let episode = Trajectory::decode(honest.clone()).unwrap();
    let otherwise = Trajectory { task: "fetch-push".to_owned(), ..episode };
    // A field of number 100, which decoding passes over.
    let padded = [&honest[..], &[0xa0, 0x06, 1]].concat();
    let length = honest.len();
    let wrong = [
        (otherwise.encode_to_vec(), "expected task navigation, found fetch-push".to_owned()),
        (padded, format!("expected the {length} bytes of its content, found {}", length + 3)),
    ];
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        for (session, (bytes, expected)) in (1..).zip(wrong) {
            hub.hello(hello(&stage, session)).await.unwrap();
            let trajectories = vec![Bytes::from(bytes)];
            let exchange = Exchange { session, trajectories, ..Exchange::default() };
            assert_expelled(&hub.exchange(exchange).await.unwrap_err(), &expected);
        }
    });
}

/// The run's gateway is killed and restarted, and the host begins a new session.
#[test]
fn a_host_stays_expelled_under_its_name() {
    let offence = Expelled { name: "host-1".to_owned(), why: "its episode differs".to_owned() };
    let earlier = Hosts { expelled: vec![offence], ..Hosts::default() };
    let stage = Stage::after(&earlier);
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        let refusal = hub.hello(hello(&stage, 1)).await.unwrap_err();
        assert_expelled(&refusal, "host-1 has been expelled and stays so until the run is");
        assert_expelled(&refusal, "another --name (its episode differs)");
        hub.hello(hello(&stage, 2)).await.unwrap();
        let hosts = stage.await_hosts(|hosts| hosts.present.len() == 1).await;
        assert_eq!(hosts.expelled, earlier.expelled);
    });
}
