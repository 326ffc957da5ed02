//! Questions and answers (request and response): leases and scores. A question that nobody can answer is an error, a
//! lost one is noticed by its deadline, and an answer wakes the asker.

use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use iceoryx2::active_request::ActiveRequest;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::prelude::{AllocationStrategy, BackpressureStrategy, ZeroCopySend};
use iceoryx2::service::port_factory::request_response::PortFactory;
use protocol::Error;

use super::{
    Bus, Doorbell, MAX_INCARNATIONS, MAX_NODES, Ringer, Role, SharedMemory, Sleeper, failed,
    opened, service_name,
};

/// The parameters of such a service.
#[derive(Debug)]
pub(super) struct Question {
    service: &'static str,
    server: Role,
    max_clients: usize,
    /// Initial size of a slot for a question or an answer, in bytes.
    first_place_bytes: usize,
    /// Whether a longer message enlarges the following slots or is an error.
    growth: AllocationStrategy,
}

/// Leases. Their lists are short and the clients many, so slots of fixed size save memory.
pub(super) const LEASES: Question = Question {
    service: "leases",
    server: Role::Learner,
    max_clients: MAX_NODES,
    first_place_bytes: 32 << 10,
    growth: AllocationStrategy::Static,
};

/// Scores: whole batches of trajectories in, their scores out. The learner and a few tools ask.
pub(super) const SCORES: Question = Question {
    service: "scores",
    server: Role::ProximityService,
    max_clients: 8,
    first_place_bytes: 64 << 10,
    growth: AllocationStrategy::PowerOfTwo,
};

/// Maximum number of open questions of one client. Usually there is one; the others have been given up but are still
/// held by a busy server.
const MAX_OPEN: usize = 4;

/// How long an asker sleeps before it looks for a server again.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// The process that the answer wakes.
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("goalward::Asker")]
#[repr(C)]
struct Asker {
    node: u128,
    role: u32,
}

type Service = PortFactory<SharedMemory, [u8], Asker, [u8], ()>;

fn open_service(bus: &Bus, question: &Question) -> Result<Service, Error> {
    let name = service_name(question.service)?;
    opened("opening", question.service, || {
        bus.node
            .service_builder(&name)
            .request_response::<[u8], [u8]>()
            .request_user_header::<Asker>()
            .enable_safe_overflow_for_requests(false)
            .enable_safe_overflow_for_responses(false)
            .enable_fire_and_forget_requests(false)
            .max_active_requests_per_client(MAX_OPEN)
            .max_loaned_requests(1)
            .max_response_buffer_size(1)
            .max_borrowed_responses_per_pending_response(1)
            .max_servers(MAX_INCARNATIONS)
            .max_clients(question.max_clients)
            .max_nodes(MAX_NODES)
            .open_or_create()
    })
}

/// The asker's end of the service.
#[derive(Debug)]
pub struct Client {
    client: iceoryx2::port::client::Client<SharedMemory, [u8], Asker, [u8], ()>,
    bell: Rc<Ringer>,
    asker: Asker,
    service: &'static str,
}

impl Client {
    pub(super) fn new(bus: &Bus, question: &Question, doorbell: &Doorbell) -> Result<Self, Error> {
        let Sleeper { role, node } = doorbell.sleeper();
        let service = open_service(bus, question)?;
        let client = opened("creation of a client", question.service, || {
            service
                .client_builder()
                .initial_max_slice_len(question.first_place_bytes)
                .allocation_strategy(question.growth)
                // A stuck server must not block its askers: they have deadlines.
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
        })?;
        Ok(Client {
            client,
            bell: bus.ringer(question.server)?,
            asker: Asker { node, role: role as u32 },
            service: question.service,
        })
    }

    /// Sends a question and rings the server.
    ///
    /// # Errors
    /// When there is no server, or none has room for the question.
    pub fn send(&self, bytes: &[u8]) -> Result<Pending, Error> {
        let mut place = self
            .client
            .loan_slice_uninit(bytes.len())
            .map_err(failed("loan of a place", self.service))?;
        *place.user_header_mut() = self.asker;
        let pending =
            place.write_from_slice(bytes).send().map_err(failed("asking", self.service))?;
        if pending.number_of_server_connections() == 0 {
            return Err(self.error("asking", "expected a process that answers, found none"));
        }
        self.bell.ring()?;
        Ok(Pending { pending, service: self.service })
    }

    /// Asks until `read` accepts an answer. Waits for a server to appear, and asks again when it is gone; a dead
    /// server is gone once it has been cleaned up ([`Bus::clean_up`]). Every server gets the question, and answers for
    /// which `read` returns `None` are dropped. Sleeps on the asker's own `doorbell` and consumes its rings, so the
    /// asker must check all its ports afterwards.
    ///
    /// # Errors
    /// Those of `keep_waiting`, which is called after every look for an answer, and of a broken bell.
    pub fn ask<T, E: From<Error>>(
        &self,
        bytes: &[u8],
        doorbell: &Doorbell,
        read: impl Fn(Bytes) -> Option<T>,
        mut keep_waiting: impl FnMut() -> Result<(), E>,
    ) -> Result<T, E> {
        let mut sent = self.send(bytes);
        loop {
            // `None` if the question is lost.
            let polled = sent.as_ref().ok().and_then(|pending| pending.poll().ok());
            let is_lost = polled.is_none();
            let answered = polled.flatten();
            // After an answer that `read` does not accept, another one may already be waiting.
            let looks_at_once = answered.is_some();
            if let Some(answer) = answered.and_then(&read) {
                return Ok(answer);
            }
            if !looks_at_once {
                doorbell.wait(LOOK_AGAIN)?;
            }
            keep_waiting()?;
            if is_lost {
                sent = self.send(bytes);
            }
        }
    }

    fn error(&self, operation: &'static str, message: &str) -> Error {
        Error::Bus { operation, service: self.service.to_owned(), message: message.to_owned() }
    }
}

/// An open question. Dropping it gives up the answer.
#[derive(Debug)]
pub struct Pending {
    pending: PendingResponse<SharedMemory, [u8], Asker, [u8], ()>,
    service: &'static str,
}

impl Pending {
    /// Returns the answer once it has arrived, and only once.
    ///
    /// # Errors
    /// When the server dropped the question or is gone. A dead server is gone once it has been cleaned up
    /// ([`Bus::clean_up`]).
    pub fn poll(&self) -> Result<Option<Bytes>, Error> {
        let connected = self.pending.is_connected();
        // The answer is read after the connection state, so that one that came just before the end is not missed.
        let answer = self.pending.receive().map_err(failed("receiving", self.service))?;
        match answer {
            Some(answer) => Ok(Some(Bytes::copy_from_slice(answer.payload()))),
            None if connected => Ok(None),
            None => Err(Error::Bus {
                operation: "waiting for an answer",
                service: self.service.to_owned(),
                message: "the server is gone or dropped the question".to_owned(),
            }),
        }
    }
}

/// The server's end of the service.
#[derive(Debug)]
pub struct Server {
    server: iceoryx2::port::server::Server<SharedMemory, [u8], Asker, [u8], ()>,
    bells: Rc<[Rc<Ringer>]>,
    service: &'static str,
}

impl Server {
    pub(super) fn new(bus: &Bus, question: &Question) -> Result<Self, Error> {
        let service = open_service(bus, question)?;
        let server = opened("creation of a server", question.service, || {
            service
                .server_builder()
                .initial_max_slice_len(question.first_place_bytes)
                .allocation_strategy(question.growth)
                .max_loaned_responses_per_request(1)
                // A stuck asker must not block its server.
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
        })?;
        let bells = Role::ALL.into_iter().map(|role| bus.ringer(role)).collect::<Result<_, _>>()?;
        Ok(Server { server, bells, service: question.service })
    }

    /// Returns the next question. It may be kept and answered after later ones.
    ///
    /// # Errors
    /// When the connection to a client fails, or too many given-up questions of a client are kept.
    pub fn receive(&self) -> Result<Option<Request>, Error> {
        let request = self.server.receive().map_err(failed("receiving", self.service))?;
        Ok(request.map(|request| Request {
            request,
            bells: Rc::clone(&self.bells),
            service: self.service,
        }))
    }
}

/// A received question. Dropping it unanswered tells the asker that there will be no answer.
#[derive(Debug)]
pub struct Request {
    request: ActiveRequest<SharedMemory, [u8], Asker, [u8], ()>,
    bells: Rc<[Rc<Ringer>]>,
    service: &'static str,
}

impl Request {
    /// Returns the question's bytes, in shared memory.
    pub fn bytes(&self) -> &[u8] {
        self.request.payload()
    }

    /// Returns the role that the asker claims to have, if it is one.
    pub fn asker(&self) -> Option<Role> {
        Role::ALL.get(self.request.user_header().role as usize).copied()
    }

    /// Returns whether the asker still waits. A server that keeps questions drops those that are not awaited.
    pub fn is_awaited(&self) -> bool {
        self.request.is_connected()
    }

    /// Answers and wakes the asker. An asker that is gone is no error.
    ///
    /// # Errors
    /// When there is no slot for the answer, or the bell is broken.
    pub fn reply(self, bytes: &[u8]) -> Result<(), Error> {
        let place = self
            .request
            .loan_slice_uninit(bytes.len())
            .map_err(failed("loan of a place", self.service))?;
        place.write_from_slice(bytes).send().map_err(failed("answering", self.service))?;
        let asker = self.request.user_header();
        match self.bells.get(asker.role as usize) {
            Some(bell) => bell.ring_one(asker.node),
            None => Ok(()),
        }
    }
}
