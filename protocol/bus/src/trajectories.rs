//! Trajectories from actors to their readers.
//!
//! The encoded bytes are written into shared memory once and read there by every reader. While a reader computes for
//! seconds, its queue has room for [`TRAJECTORY_BUFFER`] trajectories of each actor. What happens when the queue is
//! full depends on the publisher's rule, see [`Bus::rollout_publisher`] and [`Bus::trajectory_publisher`]. While a
//! publisher waits, it cleans up dead readers.

use std::collections::BTreeSet;
use std::rc::Rc;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{BackpressureAction, BackpressureInfo, LoanError};
use iceoryx2::prelude::{
    AllocationStrategy, BackpressureStrategy, CallbackProgression, PayloadHeader as _,
    PortFactory as _, PortName, ZeroCopySend,
};
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use protocol::Error;
use protocol::trajectory::Encoded;

use super::{
    Bus, BusAddress, MAX_NODES, Ringer, Role, SharedMemory, address::CREATION_TIMEOUT, clean_up,
    failed, opened, service_name,
};

const SERVICE: &str = "trajectories";

/// Number of one actor's trajectories that can wait for one reader. With lag 1, an iteration of about 400 is
/// published, in the worst case by one actor, while a reader updates its networks.
pub const TRAJECTORY_BUFFER: usize = 512;

/// Maximum number of readers: the learner, the proximity service and two tools.
const MAX_SUBSCRIBERS: usize = 4;

/// Samples that a reader borrows at a time: it copies a trajectory out and releases the slot before it takes the next.
const MAX_BORROWED: usize = 1;

/// Initial size of a slot in shared memory, in bytes. A longer trajectory enlarges the following slots.
const FIRST_PLACE_BYTES: usize = 64 << 10;

/// How often a waiting publisher cleans up dead readers.
const CLEAN_UP_EVERY: Duration = Duration::from_millis(200);

/// Name of the ports of readers that learn from what they read.
const LEARNS: &str = "learns";

/// Identifies a trajectory, so that a reader can name it before it decodes it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("goalward::TrajectoryHeader")]
#[repr(C)]
pub struct TrajectoryHeader {
    /// Iteration of the rollout it belongs to.
    pub iteration: u64,
    /// Environment stream it comes from.
    pub lane: u64,
    /// Number of the episode within its lane.
    pub episode: u64,
    /// xxh3 of the encoded trajectory.
    pub hash: u64,
}

impl From<&Encoded> for TrajectoryHeader {
    fn from(encoded: &Encoded) -> TrajectoryHeader {
        TrajectoryHeader {
            iteration: encoded.trajectory.iteration,
            lane: encoded.key.lane,
            episode: encoded.key.episode,
            hash: encoded.key.hash,
        }
    }
}

type Loan = SampleMutUninit<SharedMemory, [std::mem::MaybeUninit<u8>], TrajectoryHeader>;

fn open_service(bus: &Bus) -> Result<PortFactory<SharedMemory, [u8], TrajectoryHeader>, Error> {
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

/// Which full queues a publisher waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rule {
    /// Those of all readers. Once the patience is over, sending fails.
    Everybody,
    /// Those of readers that learn, which ask for what they miss. Once the patience is over, a reader is skipped until
    /// it has read again.
    Learning,
}

/// The publisher's end of the service.
#[derive(Debug)]
pub struct TrajectoryPublisher {
    publisher: Publisher<SharedMemory, [u8], TrajectoryHeader>,
    service: PortFactory<SharedMemory, [u8], TrajectoryHeader>,
    bells: [Rc<Ringer>; 2],
    address: BusAddress,
    patience: Duration,
    queues: Arc<Mutex<Queues>>,
}

impl TrajectoryPublisher {
    pub(super) fn new(bus: &Bus, rule: Rule, patience: Duration) -> Result<Self, Error> {
        let service = open_service(bus)?;
        let address = bus.address.clone();
        let queues = Arc::new(Mutex::new(Queues::default()));
        let publisher = opened("creation of a publisher", SERVICE, || {
            service
                .publisher_builder()
                .initial_max_slice_len(FIRST_PLACE_BYTES)
                .allocation_strategy(AllocationStrategy::PowerOfTwo)
                .max_loaned_samples(1)
                .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
                .set_backpressure_handler(wait_for_reader(
                    address.clone(),
                    rule,
                    patience,
                    Arc::clone(&queues),
                ))
                .create()
        })?;
        let bells = [bus.ringer(Role::Learner)?, bus.ringer(Role::ProximityService)?];
        Ok(TrajectoryPublisher { publisher, service, bells, address, patience, queues })
    }

    /// Returns the number of readers, including dead ones that have not been cleaned up.
    pub fn reader_count(&self) -> usize {
        self.service.dynamic_config().number_of_subscribers()
    }

    /// Sends the encoded trajectory to every reader and rings the learner and the proximity service.
    ///
    /// # Errors
    /// As [`Self::send`] and [`Self::ring`].
    pub fn publish(&self, bytes: &[u8], header: TrajectoryHeader) -> Result<usize, Error> {
        let sent = self.send(bytes, header);
        self.ring()?;
        sent
    }

    /// Sends the encoded trajectory to every reader. Returns how many readers it was queued for. This is fewer than
    /// [`Self::reader_count`] if a reader was skipped, or if its queue is full and it has received nothing since this
    /// publisher was created. What is queued for a reader that has never received is lost if this publisher ends
    /// first.
    ///
    /// # Errors
    /// If all readers are waited for: when a reader's queue stayed full for the publisher's patience. The other
    /// readers have the trajectory.
    pub fn send(&self, bytes: &[u8], header: TrajectoryHeader) -> Result<usize, Error> {
        let mut place = self.loan(bytes.len())?;
        *place.user_header_mut() = header;
        queues(&self.queues).learning = self.learning();
        let sent = place.write_from_slice(bytes).send();
        let mut queues = queues(&self.queues);
        queues.left_out = std::mem::take(&mut queues.still_full);
        drop(queues);
        sent.map_err(failed("sending", SERVICE))
    }

    /// Rings the learner and the proximity service.
    ///
    /// # Errors
    /// When a bell is broken.
    pub fn ring(&self) -> Result<(), Error> {
        self.bells.iter().try_for_each(|bell| bell.ring())
    }

    /// Returns the IDs of the readers that learn.
    fn learning(&self) -> BTreeSet<u128> {
        let mut learning = BTreeSet::new();
        self.service.dynamic_config().list_subscribers(|reader| {
            if reader.subscriber_name.as_str() == LEARNS {
                learning.insert(reader.subscriber_id.value());
            }
            CallbackProgression::Continue
        });
        learning
    }

    /// Loans a slot. All slots may be taken if readers went away with full queues, so it waits as for a full queue.
    fn loan(&self, length: usize) -> Result<Loan, Error> {
        let start = Instant::now();
        loop {
            match self.publisher.loan_slice_uninit(length) {
                Err(LoanError::OutOfMemory) if start.elapsed() < self.patience => {
                    clean_up(&self.address, CREATION_TIMEOUT)?;
                    std::thread::sleep(CLEAN_UP_EVERY);
                }
                other => return other.map_err(failed("loan of a place", SERVICE)),
            }
        }
    }
}

/// What a publisher knows of its readers' queues.
#[derive(Debug, Default)]
struct Queues {
    /// Readers that learn.
    learning: BTreeSet<u128>,
    /// Readers that were waited for in vain and have not read since.
    left_out: BTreeSet<u128>,
    /// Readers that the current sending has skipped. They become `left_out` afterwards.
    still_full: BTreeSet<u128>,
}

fn queues(shared: &Mutex<Queues>) -> MutexGuard<'_, Queues> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the handler for full queues, which waits for a reader or skips it, and regularly cleans up dead readers.
fn wait_for_reader(
    address: BusAddress,
    rule: Rule,
    patience: Duration,
    shared: Arc<Mutex<Queues>>,
) -> impl Fn(&BackpressureInfo) -> BackpressureAction + Send + 'static {
    let cleaned = Mutex::new(0);
    move |info| {
        let (reader, waited) = (info.receiver_port_id, info.elapsed_time);
        if rule == Rule::Learning {
            let mut queues = queues(&shared);
            if !queues.learning.contains(&reader) {
                return BackpressureAction::DiscardData;
            }
            if waited >= patience || queues.left_out.contains(&reader) {
                if queues.still_full.insert(reader) && waited >= patience {
                    tracing::warn!(
                        "a reader's queue has been full for {patience:?}: going on without it"
                    );
                }
                return BackpressureAction::DiscardData;
            }
        } else if waited >= patience {
            return BackpressureAction::DiscardDataAndFail;
        }
        let round = waited.as_millis() / CLEAN_UP_EVERY.as_millis();
        let mut cleaned = cleaned.lock().unwrap_or_else(PoisonError::into_inner);
        if std::mem::replace(&mut *cleaned, round) < round
            && let Err(error) = clean_up(&address, CREATION_TIMEOUT)
        {
            tracing::debug!("a blocked publisher could not clean up: {error}");
        }
        BackpressureAction::Retry
    }
}

/// A received trajectory. Nothing in it is trusted.
#[derive(Clone, Debug)]
pub struct Published {
    /// The header, as the sender states it.
    pub header: TrajectoryHeader,
    /// The encoded trajectory.
    pub bytes: Bytes,
    /// ID of the process that sent it; 0 if unknown.
    pub process: u32,
}

/// A reader's end of the service.
#[derive(Debug)]
pub struct TrajectorySubscriber {
    subscriber: Subscriber<SharedMemory, [u8], TrajectoryHeader>,
}

impl TrajectorySubscriber {
    pub(super) fn new(bus: &Bus, learns: bool) -> Result<Self, Error> {
        let service = open_service(bus)?;
        let name = PortName::new(if learns { LEARNS } else { "" });
        let name = name.map_err(failed("naming of a subscriber", SERVICE))?;
        let subscriber = opened("creation of a subscriber", SERVICE, || {
            service.subscriber_builder().name(&name).buffer_size(TRAJECTORY_BUFFER).create()
        })?;
        Ok(TrajectorySubscriber { subscriber })
    }

    /// Returns the next trajectory, copied out of shared memory, in order per publisher. Also connects to new
    /// publishers, so it must be called before a new actor is answered and at least once a second.
    ///
    /// # Errors
    /// When the connection to a publisher fails.
    pub fn receive(&self) -> Result<Option<Published>, Error> {
        let sample = self.subscriber.receive().map_err(failed("receiving", SERVICE))?;
        Ok(sample.map(|sample| Published {
            header: *sample.user_header(),
            bytes: Bytes::copy_from_slice(sample.payload()),
            process: sample
                .header()
                .node_id()
                .pid::<SharedMemory>()
                .map_or(0, |id| id.value() as u32),
        }))
    }
}
