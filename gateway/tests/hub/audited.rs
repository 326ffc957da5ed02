//! Episodes of hosts that are sampled for an audit: one that differs, and one that cannot be re-simulated.

use std::time::{Duration, Instant};

use bus::{Bus, BusAddress};
use bytes::Bytes;
use gateway::calls::gateway_client::GatewayClient;
use gateway::host::connect;
use gateway::messages::{Beat, Exchange, Goodbye, WeightsRequest};
use prost::Message;
use protocol::weights::Weights;
use tonic::transport::Channel;

use crate::granted;
use crate::stage::{PATIENCE, Stage, block_on, lease};

/// Reports a difference one second after it has started.
const SLOW_AUDITOR: &str = r#"#!/bin/sh
touch "$0.begun"
sleep 1
echo '"another observation"'
exec sleep 60
"#;

/// Ends without a verdict.
const DEAD_AUDITOR: &str = "#!/bin/sh\nexit 1\n";

/// Publishes weights of version 0, and waits until the hub has them.
async fn publish_weights(stage: &Stage, hub: &mut GatewayClient<Channel>) {
    let bus = Bus::open(&BusAddress::of_run(stage.directory.path()).unwrap(), "weights").unwrap();
    let weights = Weights::new(0, &[0.5], &[]).encode_to_vec();
    let publisher = bus.weights_publisher(weights.len()).unwrap();
    publisher.publish(&weights).unwrap();
    let wanted = WeightsRequest { session: 1, version: 0 };
    let start = Instant::now();
    while hub.weights(wanted.clone()).await.unwrap().into_inner().weights.is_none() {
        assert!(start.elapsed() < PATIENCE, "expected weights");
        publisher.refresh().unwrap();
    }
}

#[test]
fn a_host_that_hangs_up_and_leaves_before_the_verdict_is_expelled() {
    let stage = Stage::with_auditor(SLOW_AUDITOR);
    let begun = stage.directory.path().join("auditor.begun");
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        publish_weights(&stage, &mut hub).await;
        let trajectories = vec![stage.episode(3, stage.config.seed)];
        let exchange = Exchange { session: 1, trajectories, ..Exchange::default() };
        let mut asker = hub.clone();
        let asked = tokio::spawn(async move { asker.exchange(exchange).await });
        let start = Instant::now();
        while !begun.exists() {
            assert!(start.elapsed() < PATIENCE, "expected an audit");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        asked.abort();
        hub.goodbye(Goodbye { session: 1 }).await.unwrap();
        stage.await_hosts(|hosts| hosts.expelled.len() == 1).await;
        let back = hub.hello(stage.hello(1)).await.unwrap_err();
        assert_eq!(back.message(), "its episode differs when re-simulated: another observation");
    });
    assert_eq!(stage.published(), Vec::<Bytes>::new());
}

#[test]
fn an_episode_that_cannot_be_audited_is_not_published_and_its_host_stays() {
    let stage = Stage::with_auditor(DEAD_AUDITOR);
    block_on(async {
        let mut hub = connect(&stage.key).unwrap();
        hub.hello(stage.hello(1)).await.unwrap();
        publish_weights(&stage, &mut hub).await;
        assert_eq!(granted(&stage, &hub, 1).await.leases, [lease(3)]);
        let trajectories = vec![stage.episode(3, stage.config.seed)];
        let delivery = Exchange { session: 1, trajectories, ..Exchange::default() };
        hub.exchange(delivery).await.unwrap();
        hub.beat(Beat { session: 1, ..Beat::default() }).await.unwrap();
        stage.await_hosts(|hosts| hosts.unaudited.is_some()).await;
    });
    assert_eq!(stage.published(), Vec::<Bytes>::new());
}
