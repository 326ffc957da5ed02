//! What a hub accepts: nobody without the run's key, no host that acts differently, and nothing invalid from the hosts
//! that have joined. The test plays the learner of the run and every kind of host.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod audited;
mod expelled;
mod hostile;
mod stage;

use std::io::Write;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use bus::BusAddress;
use bytes::Bytes;
use gateway::calls::gateway_client::GatewayClient;
use gateway::host::{self, connect};
use gateway::key::{self, JoinKey};
use gateway::messages::{Beat, Exchange, Goodbye, Hello};
use prost::Message;
use protocol::build;
use protocol::messages::{ActorSeconds, LeaseReply, LeaseRequest};
use run::actors_wanted::ActorsWanted;
use run::folder::RunFolder;
use run::hosts::{Host, Hosts};
use tonic::Code;
use tonic::transport::Channel;

use stage::{PATIENCE, Stage, block_on, free_address, lease};

/// Number of connections of strangers.
const STRANGERS: usize = 100;

fn question(session: u64, number: u64) -> Exchange {
    question_after(session, number, None)
}

/// Returns a request for leases of an actor that has spent `seconds` since its last one.
fn question_after(session: u64, number: u64, seconds: Option<ActorSeconds>) -> Exchange {
    let actor = "actor-0-7".to_owned();
    let request = LeaseRequest { actor, capacity: 4, finished: Vec::new(), seconds };
    let request = Some(request.encode_to_vec().into());
    Exchange { session, number, request, ..Exchange::default() }
}

/// Waits until a request for leases has reached the learner, which does not reply.
async fn await_question(stage: &Stage) {
    let start = Instant::now();
    while stage.leases.receive().unwrap().is_none() {
        assert!(start.elapsed() < PATIENCE, "expected a question");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// Has an actor of the host node-7 ask the learner for leases, which grants lane 3.
async fn granted(stage: &Stage, hub: &GatewayClient<Channel>, session: u64) -> LeaseReply {
    let mut asker = hub.clone();
    let asked = tokio::spawn(async move { asker.exchange(question(session, 1)).await });
    while !asked.is_finished() {
        tokio::time::sleep(Duration::from_millis(5)).await;
        if let Some(question) = stage.leases.receive().unwrap() {
            let request = LeaseRequest::decode(question.bytes()).unwrap();
            assert_eq!(request.actor, "actor-0-7@node-7");
            let reply = LeaseReply { leases: vec![lease(3)], finished: false };
            question.reply(&reply.encode_to_vec()).unwrap();
        }
    }
    asked.await.unwrap().unwrap().into_inner().reply.unwrap()
}

#[test]
fn strangers_get_nothing_and_cost_nothing() {
    let stage = Stage::new();
    let idle = || TcpStream::connect(&stage.key.address).unwrap();
    let _idle: Vec<TcpStream> = (0..STRANGERS).map(|_| idle()).collect();
    for number in 0..STRANGERS {
        let mut stranger = TcpStream::connect(&stage.key.address).unwrap();
        // A hub that hangs up before it has read everything is fine, too.
        stranger.write_all(&vec![(number * 37) as u8; number * 50]).ok();
    }
    let other = tempfile::tempdir().unwrap();
    let other = RunFolder::new(other.path());
    key::of_run(&other, &stage.key.address).unwrap();
    let wrong = JoinKey::of_file(&other.join_file()).unwrap();
    let error = format!("{:#}", host::lay_out(&other, &wrong).unwrap_err());
    assert!(error.contains("certificate"), "{error}");
    assert!(!other.config_file().exists());
    host::lay_out(&other, &stage.key).unwrap();
    assert_eq!(other.config().unwrap(), stage.config);
    let mut nowhere = stage.key.clone();
    nowhere.address = free_address().to_string();
    let error = format!("{:#}", host::lay_out(&other, &nowhere).unwrap_err());
    assert!(error.contains(&nowhere.address) && error.contains("refused"), "{error}");
}

#[test]
fn hosts_that_would_act_otherwise_are_refused_in_words() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        let hello = stage.hello(1);
        for (hello, expected) in [
            (
                Hello { protocol: 99, ..hello.clone() },
                "expected a gateway of protocol 4, found one of 99",
            ),
            (Hello { build: "0.0.9".to_owned(), ..hello.clone() }, "found 0.0.9"),
            (Hello { golden: "another".to_owned(), ..hello.clone() }, "golden episodes of hash"),
            (Hello { host: "a\nb".to_owned(), ..hello.clone() }, "expected a name"),
            (Hello { host: "x".repeat(99), ..hello.clone() }, "expected a name"),
            (
                Hello { actors: 65, ..hello.clone() },
                "expected at most 64 actors of a run, found 0 and 65 of this host",
            ),
        ] {
            let refusal = hub.hello(hello).await.unwrap_err();
            assert_eq!(refusal.code(), Code::FailedPrecondition);
            assert!(refusal.message().contains(expected), "{refusal}");
        }
        let unknown = hub.beat(Beat { session: 1, ..Beat::default() }).await.unwrap_err();
        assert_eq!(unknown.code(), Code::Unauthenticated);
        let other_build = Hello { build: "0.0.9".to_owned(), other_build: true, ..hello };
        let welcome = hub.hello(other_build).await.unwrap().into_inner();
        let second = hub.hello(stage.hello(2)).await.unwrap().into_inner();
        assert_eq!([welcome.host, second.host], ["node-7", "node-7-2"]);
        let many = Hello { actors: 57, ..stage.hello(3) };
        let refusal = hub.hello(many).await.unwrap_err();
        let words = "found 8 and 57 of this host; there is room for 56";
        assert!(refusal.message().contains(words), "{refusal}");
        hub.hello(Hello { actors: 56, ..stage.hello(3) }).await.unwrap();
        let none = Hello { actors: 0, ..stage.hello(4) };
        let refusal = hub.hello(none).await.unwrap_err();
        assert!(refusal.message().contains("found 64 and 1 of this host"), "{refusal}");
        let beat =
            Beat { session: 2, actors: vec!["actor-0-1".to_owned()], distance_ms: Some(3.5) };
        hub.beat(beat).await.unwrap();
        let known = Host {
            name: "node-7-2".to_owned(),
            build: build::version().to_owned(),
            actors: 1,
            distance_ms: Some(3.5),
        };
        stage.await_hosts(|hosts| hosts.present.get(1) == Some(&known)).await;
    });
}

#[test]
fn only_episodes_of_granted_leases_reach_the_learner() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        let seed = stage.config.seed;
        assert_eq!(granted(&stage, &hub, 1).await.leases, [lease(3)]);
        // A lost reply is asked for again; the learner does not notice.
        let granted = stage.episode(3, seed);
        let trajectories = vec![stage.episode(4, seed), granted.clone()];
        let again = Exchange { trajectories, ..question(1, 1) };
        let again = hub.exchange(again).await.unwrap().into_inner();
        assert_eq!(again.reply.unwrap().leases, [lease(3)]);
        assert!(stage.leases.receive().unwrap().is_none());
        assert_eq!(stage.published(), std::slice::from_ref(&granted));

        hub.hello(stage.hello(2)).await.unwrap();
        let of_another_run = stage.episode(3, seed + 1);
        for (session, wrong) in [(2, of_another_run), (1, Bytes::from_static(b"no"))] {
            // The valid trajectory beside the invalid one is not published either.
            let trajectories = vec![granted.clone(), wrong];
            let wrong = Exchange { trajectories, ..question(session, 2) };
            let (mut first, mut second) = (hub.clone(), hub.clone());
            // Two calls expel the host at once; it is listed once.
            let both = tokio::join!(first.exchange(wrong.clone()), second.exchange(wrong));
            let [refusal, other] = [both.0.unwrap_err(), both.1.unwrap_err()];
            assert_eq!(refusal.code(), Code::PermissionDenied, "{refusal}");
            assert_eq!(other.message(), refusal.message());
            let expelled = hub.exchange(question(session, 3)).await.unwrap_err();
            assert_eq!(expelled.message(), refusal.message());
            let back = hub.hello(stage.hello(session)).await.unwrap_err();
            assert_eq!(back.code(), Code::PermissionDenied);
        }
        assert_eq!(stage.published(), Vec::<Bytes>::new());
        let back = hub.hello(stage.hello(3)).await.unwrap_err();
        assert!(back.message().contains("node-7 has been expelled"), "{back}");
        hub.hello(Hello { host: "node-8".to_owned(), ..stage.hello(3) }).await.unwrap();
        let Hosts { expelled, .. } = stage.await_hosts(|hosts| hosts.expelled.len() == 2).await;
        let names: Vec<String> = expelled.into_iter().map(|one| one.name).collect();
        assert_eq!(names, ["node-7-2", "node-7"], "in the order in which they were expelled");
    });
}

/// The learner receives a request and does not answer it, so the request is repeated.
#[test]
fn what_an_actor_has_spent_counts_once_however_long_it_waits() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        let spent = ActorSeconds { processor: 3.0, ..ActorSeconds::default() };
        let asked = question_after(1, 1, Some(spent));
        let mut asker = hub.clone();
        let asker = tokio::spawn(async move { asker.exchange(asked).await });
        let (start, mut told) = (Instant::now(), Vec::new());
        while told.len() < 2 && start.elapsed() < PATIENCE {
            let unanswered = stage.leases.receive().unwrap();
            told.extend(unanswered.map(|one| LeaseRequest::decode(one.bytes()).unwrap().seconds));
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert_eq!(told, [Some(spent), None]);
        asker.abort();
    });
}

#[test]
fn a_host_stays_when_an_actor_of_its_is_gone_that_had_asked() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        let mut asker = hub.clone();
        let asked = tokio::spawn(async move { asker.exchange(question(1, 1)).await });
        await_question(&stage).await;
        let nobody = || Beat { session: 1, ..Beat::default() };
        hub.beat(nobody()).await.unwrap();
        assert_eq!(asked.await.unwrap().unwrap().into_inner().reply, None);
        hub.beat(nobody()).await.unwrap();
    });
}

#[test]
fn a_host_has_no_more_actors_than_it_was_admitted_with_and_those_they_replaced() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(Hello { actors: 1, ..stage.hello(1) }).await.unwrap();
        let asked = |number: u64| {
            let (mut asker, actor) = (hub.clone(), format!("actor-0-{number}"));
            let request = LeaseRequest { actor, ..LeaseRequest::default() };
            let request = Some(request.encode_to_vec().into());
            let exchange = Exchange { request, ..question(1, number) };
            tokio::spawn(async move { asker.exchange(exchange).await })
        };
        // The second may have replaced the first.
        let waiting = [asked(1), asked(2)];
        await_question(&stage).await;
        await_question(&stage).await;
        let refused = asked(3).await.unwrap().unwrap_err();
        assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
        assert!(refused.message().contains("no more than 2 actors of node-7"), "{refused}");
        waiting.iter().for_each(|asked| asked.abort());
    });
}

#[test]
fn a_host_that_has_left_takes_no_place() {
    let stage = Stage::new();
    let folder = RunFolder::new(stage.directory.path());
    let is_alone = || Hosts::of_run(&folder).present.iter().map(|host| &host.name).eq(["node-7-2"]);
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        hub.hello(stage.hello(2)).await.unwrap();
        let beat = || Beat { session: 2, ..Beat::default() };
        let start = Instant::now();
        while !is_alone() {
            assert!(start.elapsed() < PATIENCE, "expected one of two hosts to be given up");
            hub.beat(beat()).await.unwrap();
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        // If the host that has left still took its places, there would be room for only 60.
        ActorsWanted::of_host(&folder, "node-7-2").want(62).unwrap();
        assert_eq!(hub.beat(beat()).await.unwrap().into_inner().actors, 62);
    });
}

#[test]
fn a_host_that_says_goodbye_can_come_back_at_once() {
    let stage = Stage::new();
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        let with_all = |session| Hello { actors: 64, ..stage.hello(session) };
        hub.hello(with_all(1)).await.unwrap();
        hub.hello(with_all(2)).await.unwrap_err();
        hub.goodbye(Goodbye { session: 1 }).await.unwrap();
        let welcome = hub.hello(with_all(2)).await.unwrap().into_inner();
        assert_eq!(welcome.host, "node-7");
    });
}

#[test]
fn a_host_that_is_gone_leaves_the_bus() {
    let stage = Stage::new();
    let address = BusAddress::of_run(stage.directory.path()).unwrap();
    let is_there = || address.members().unwrap().iter().any(|member| member.name.contains('@'));
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        let asked = tokio::spawn(async move { hub.exchange(question(1, 1)).await });
        tokio::time::sleep(Duration::from_millis(50)).await;
        let request = stage.grant(vec![lease(0)]);
        assert_eq!(request.actor, "actor-0-7@node-7");
        asked.await.unwrap().unwrap();
    });
    assert!(is_there());
    let start = Instant::now();
    while is_there() {
        assert!(start.elapsed() < PATIENCE, "expected the host to be given up");
        std::thread::sleep(Duration::from_millis(50));
    }
}
