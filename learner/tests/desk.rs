//! The desk and its log: nothing is learned from that is not recorded.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::time::Duration;

use bus::{Bus, BusAddress};
use learner::desk::{DeskHandle, Entry, Order, Setup};
use mcap_log::file::LONGEST_MESSAGE;
use mcap_log::{Kind, LogOptions, LogWriter, Metadata};
use protocol::messages::PolicyUpdate;
use protocol::task::{ActionSpec, ObservationSpec, Spec};
use run::folder::RunFolder;
use run::process::{Final, Stop};

#[test]
fn a_message_that_the_log_refuses_ends_the_run() {
    let directory = tempfile::tempdir().unwrap();
    let address = BusAddress::for_start(directory.path()).unwrap();
    let bus = Bus::open(&address, "test").unwrap();
    let metadata = Metadata::new(Kind::Run, "navigation", 1);
    let folder = RunFolder::new(directory.path());
    let log = LogWriter::create(&folder.log(), &metadata, LogOptions::default()).unwrap();
    let setup = Setup {
        address: address.clone(),
        spec: Spec {
            observation: ObservationSpec::Cells { height: 19, width: 19, classes: 4 },
            action: ActionSpec::Discrete { count: 4 },
            horizon_steps: 100,
        },
        run_seed: 1,
        weights_bytes: 1 << 10,
        lease_timeout: Duration::from_secs(1),
        log,
        place: folder.place().unwrap(),
        stop: Stop::default(),
    };
    let mut desk = DeskHandle::start(setup, &bus).unwrap();
    let long =
        PolicyUpdate { weights_sha256: "0".repeat(LONGEST_MESSAGE + 1), ..PolicyUpdate::default() };
    desk.order(Order::Record(Entry::PolicyUpdate(long))).unwrap();
    let error = desk.finish().unwrap_err();
    let said = format!("{error:#}");
    assert!(said.contains("expected messages up to") && said.contains("refused"), "{said}");
    assert!(error.chain().any(|cause| cause.is::<Final>()), "it would be refused again: {error:?}");
    drop(bus);
    address.remove().unwrap();
}
