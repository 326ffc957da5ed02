//! Values of which only the newest count: weights and progress. The writer never waits, a slow reader misses old
//! values, and a late reader gets the newest ones once the writer refreshes.

use std::rc::Rc;

use bytes::Bytes;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::{AllocationStrategy, BackpressureStrategy};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use protocol::Error;

use super::{
    Bus, MAX_INCARNATIONS, MAX_NODES, Ringer, Role, SharedMemory, failed, opened, service_name,
};

/// The parameters of such a service.
#[derive(Debug)]
pub(super) struct Newest {
    service: &'static str,
    /// Number of values a reader gets, the newest last.
    depth: usize,
    reader: Role,
}

/// Number of policy versions that this service and its readers keep: with lag 1, the version before the newest still
/// acts.
pub const POLICY_VERSIONS: usize = 2;

/// The policy's weights.
pub(super) const WEIGHTS: Newest =
    Newest { service: "weights", depth: POLICY_VERSIONS, reader: Role::Actors };

/// The run's progress. Each report replaces the previous one.
pub(super) const PROGRESS: Newest =
    Newest { service: "progress", depth: 1, reader: Role::Supervisor };

/// Samples that a reader borrows at a time: it copies a value out and releases the slot before it takes the next.
const MAX_BORROWED: usize = 1;

fn open_service(bus: &Bus, newest: &Newest) -> Result<PortFactory<SharedMemory, [u8], ()>, Error> {
    let name = service_name(newest.service)?;
    opened("opening", newest.service, || {
        bus.node
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .enable_safe_overflow(true)
            .history_size(newest.depth)
            .max_publishers(MAX_INCARNATIONS)
            .max_subscribers(MAX_NODES)
            .max_nodes(MAX_NODES)
            .subscriber_max_buffer_size(newest.depth)
            .subscriber_max_borrowed_samples(MAX_BORROWED)
            .open_or_create()
    })
}

/// The writer's end of the service.
#[derive(Debug)]
pub struct NewestPublisher {
    publisher: Publisher<SharedMemory, [u8], ()>,
    bell: Rc<Ringer>,
    service: &'static str,
}

impl NewestPublisher {
    pub(super) fn new(bus: &Bus, newest: &Newest, max_bytes: usize) -> Result<Self, Error> {
        let service = open_service(bus, newest)?;
        let depth = newest.depth;
        let publisher = opened("creation of a publisher", newest.service, || {
            service
                .publisher_builder()
                .initial_max_slice_len(max_bytes)
                // A value must stay readable after its writer's death; growing memory would not.
                .allocation_strategy(AllocationStrategy::Static)
                .max_loaned_samples(1)
                // All queues hold the same newest values, so far fewer slots than in iceoryx2's worst
                // case are ever in use: these values, one borrowed by each reader, one being sent.
                .override_sample_preallocation(move |_| depth + MAX_NODES * MAX_BORROWED + 2)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
        })?;
        Ok(NewestPublisher { publisher, bell: bus.ringer(newest.reader)?, service: newest.service })
    }

    /// Sends a value and rings the readers. Never waits.
    ///
    /// # Errors
    /// When the value is longer than this publisher was created for.
    pub fn publish(&self, bytes: &[u8]) -> Result<(), Error> {
        let place = self
            .publisher
            .loan_slice_uninit(bytes.len())
            .map_err(failed("loan of a place", self.service))?;
        place.write_from_slice(bytes).send().map_err(failed("sending", self.service))?;
        self.bell.ring()
    }

    /// Delivers the newest values to readers that have joined since. Until then they have none.
    ///
    /// # Errors
    /// When the connection to a reader fails.
    pub fn refresh(&self) -> Result<(), Error> {
        self.publisher.update_connections().map_err(failed("refreshing", self.service))
    }
}

/// A reader's end of the service.
#[derive(Debug)]
pub struct NewestSubscriber {
    subscriber: Subscriber<SharedMemory, [u8], ()>,
    service: &'static str,
}

impl NewestSubscriber {
    pub(super) fn new(bus: &Bus, newest: &Newest) -> Result<Self, Error> {
        let service = open_service(bus, newest)?;
        let subscriber = opened("creation of a subscriber", newest.service, || {
            service
                .subscriber_builder()
                .buffer_size(newest.depth)
                .history_request(newest.depth)
                .create()
        })?;
        Ok(NewestSubscriber { subscriber, service: newest.service })
    }

    /// Returns the next value, copied out of shared memory, older ones first.
    ///
    /// # Errors
    /// When the connection to a writer fails.
    pub fn receive(&self) -> Result<Option<Bytes>, Error> {
        let sample = self.subscriber.receive().map_err(failed("receiving", self.service))?;
        Ok(sample.map(|sample| Bytes::copy_from_slice(sample.payload())))
    }
}
