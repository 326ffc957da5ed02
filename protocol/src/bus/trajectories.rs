//! Trajectories from actors to their readers: nothing is lost between connected ports.
//!
//! The encoded bytes are written into shared memory once and read there by every reader. A reader
//! that computes for seconds has room for [`TRAJECTORY_BUFFER`] trajectories of each actor; then the
//! actor waits for it, and while it waits it cleans away dead readers.

use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureAction, BackpressureInfo, LoanError};
use iceoryx2::prelude::{
    AllocationStrategy, BackpressureStrategy, Config, PortFactory as _, ZeroCopySend,
};
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use super::{Bus, MAX_NODES, Ringer, Role, Transport, clean_up, failed, opened, service_name};
use crate::Error;

const SERVICE: &str = "trajectories";

/// Trajectories of one actor that wait for one reader. With lag 1 an iteration of about 400 is
/// published, in the worst case by one actor, while a reader updates its networks.
pub const TRAJECTORY_BUFFER: usize = 512;

/// The learner, the proximity service and two tools.
const MAX_SUBSCRIBERS: usize = 4;

/// A reader copies a trajectory out and gives its place back before it takes the next.
const MAX_BORROWED: usize = 1;

/// First size of a place in shared memory; a longer trajectory makes the following places larger.
const FIRST_PLACE_BYTES: usize = 64 << 10;

/// How often a waiting actor cleans away dead readers.
const CLEAN_UP_EVERY: Duration = Duration::from_millis(200);

/// What a reader needs to know a trajectory it has already, without decoding it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("goalward::TrajectoryHeader")]
#[repr(C)]
pub struct TrajectoryHeader {
    /// Rollout it belongs to.
    pub iteration: u64,
    /// Environment stream it comes from.
    pub lane: u64,
    /// Number of the episode within its lane.
    pub episode: u64,
    /// xxh3 of the encoded trajectory.
    pub hash: u64,
}

type Loan<S> = SampleMutUninit<S, [std::mem::MaybeUninit<u8>], TrajectoryHeader>;

fn open_service<S: Transport>(
    bus: &Bus<S>,
) -> Result<PortFactory<S, [u8], TrajectoryHeader>, Error> {
    let name = service_name(SERVICE)?;
    opened("opening", SERVICE, || {
        bus.node
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .user_header::<TrajectoryHeader>()
            .enable_safe_overflow(false)
            .history_size(0)
            .max_publishers(MAX_NODES)
            .max_subscribers(MAX_SUBSCRIBERS)
            .max_nodes(MAX_NODES)
            .subscriber_max_buffer_size(TRAJECTORY_BUFFER)
            .subscriber_max_borrowed_samples(MAX_BORROWED)
            .open_or_create()
    })
}

/// An actor's end.
#[derive(Debug)]
pub struct TrajectoryPublisher<S: Transport> {
    publisher: Publisher<S, [u8], TrajectoryHeader>,
    service: PortFactory<S, [u8], TrajectoryHeader>,
    bells: [Rc<Ringer<S>>; 2],
    config: Config,
    patience: Duration,
}

impl<S: Transport> TrajectoryPublisher<S> {
    pub(super) fn new(bus: &Bus<S>, patience: Duration) -> Result<Self, Error> {
        let service = open_service(bus)?;
        let config = bus.node.config().clone();
        let publisher = opened("creation of a publisher", SERVICE, || {
            service
                .publisher_builder()
                .initial_max_slice_len(FIRST_PLACE_BYTES)
                .allocation_strategy(AllocationStrategy::PowerOfTwo)
                .max_loaned_samples(1)
                .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
                .set_backpressure_handler(wait_for_reader::<S>(config.clone(), patience))
                .create()
        })?;
        let bells = [bus.ringer(Role::Learner)?, bus.ringer(Role::ProximityService)?];
        Ok(TrajectoryPublisher { publisher, service, bells, config, patience })
    }

    /// How many readers there are, dead ones that nobody cleaned away included.
    pub fn reader_count(&self) -> usize {
        self.service.dynamic_config().number_of_subscribers()
    }

    /// Sends the encoded trajectory to every reader and rings the learner and the proximity service.
    /// Returns how many readers it was queued for; fewer than [`Self::reader_count`] when one has
    /// never received since this publisher exists and its queue is full. Waits while a reader's
    /// queue is full. What is queued for a reader that has never received is lost when this
    /// publisher ends first.
    ///
    /// # Errors
    /// When a reader's queue stayed full for the publisher's patience; the other readers have it.
    pub fn publish(&self, bytes: &[u8], header: TrajectoryHeader) -> Result<usize, Error> {
        let mut place = self.loan(bytes.len())?;
        *place.user_header_mut() = header;
        let sent = place.write_from_slice(bytes).send();
        for bell in &self.bells {
            bell.ring()?;
        }
        sent.map_err(failed("sending", SERVICE))
    }

    /// Every place can be taken when readers went away with full queues: the same as a full queue.
    fn loan(&self, length: usize) -> Result<Loan<S>, Error> {
        let start = Instant::now();
        loop {
            match self.publisher.loan_slice_uninit(length) {
                Err(LoanError::OutOfMemory) if start.elapsed() < self.patience => {
                    clean_up::<S>(&self.config)?;
                    std::thread::sleep(CLEAN_UP_EVERY);
                }
                other => return other.map_err(failed("loan of a place", SERVICE)),
            }
        }
    }
}

/// What a blocked publisher does: cleans away dead readers now and then, and gives up in the end.
fn wait_for_reader<S: Transport>(
    config: Config,
    patience: Duration,
) -> impl Fn(&BackpressureInfo) -> BackpressureAction + Send + 'static {
    let rounds = AtomicU64::new(0);
    move |info| {
        if info.elapsed_time >= patience {
            return BackpressureAction::DiscardDataAndFail;
        }
        let round = (info.elapsed_time.as_millis() / CLEAN_UP_EVERY.as_millis()) as u64;
        if rounds.swap(round, Ordering::Relaxed) < round
            && let Err(error) = clean_up::<S>(&config)
        {
            tracing::debug!("a blocked publisher could not clean up: {error}");
        }
        BackpressureAction::Retry
    }
}

/// A reader's end.
#[derive(Debug)]
pub struct TrajectorySubscriber<S: Transport> {
    subscriber: Subscriber<S, [u8], TrajectoryHeader>,
}

impl<S: Transport> TrajectorySubscriber<S> {
    pub(super) fn new(bus: &Bus<S>) -> Result<Self, Error> {
        let service = open_service(bus)?;
        let subscriber = opened("creation of a subscriber", SERVICE, || {
            service.subscriber_builder().buffer_size(TRAJECTORY_BUFFER).create()
        })?;
        Ok(TrajectorySubscriber { subscriber })
    }

    /// The next trajectory, copied out of shared memory; in order per publisher. Connects to new
    /// publishers too, so it is called before a new actor is answered and at least once a second.
    ///
    /// # Errors
    /// When the connection to a publisher fails.
    pub fn receive(&self) -> Result<Option<(TrajectoryHeader, Bytes)>, Error> {
        let sample = self.subscriber.receive().map_err(failed("receiving", SERVICE))?;
        Ok(sample.map(|sample| (*sample.user_header(), Bytes::copy_from_slice(sample.payload()))))
    }
}
