//! Questions and answers: leases and scores. A question without anybody to answer is an error, a
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

/// A service of this kind.
#[derive(Debug)]
pub(super) struct Question {
    service: &'static str,
    server: Role,
    max_clients: usize,
    /// First size of a place for a question and for an answer.
    first_place_bytes: usize,
    /// Whether a longer one makes the following places larger, or is an error.
    growth: AllocationStrategy,
}

/// Lists of leases are short, and there are many clients: fixed places keep their memory small.
pub(super) const LEASES: Question = Question {
    service: "leases",
    server: Role::Learner,
    max_clients: MAX_NODES,
    first_place_bytes: 32 << 10,
    growth: AllocationStrategy::Static,
};

/// Whole batches of trajectories in, their scores out; asked by the learner and a few tools.
pub(super) const SCORES: Question = Question {
    service: "scores",
    server: Role::ProximityService,
    max_clients: 8,
    first_place_bytes: 64 << 10,
    growth: AllocationStrategy::PowerOfTwo,
};

/// Open questions of one client. One is the rule; the others are given up, but still in the hands
/// of a server that is busy.
const MAX_OPEN: usize = 4;

/// How long an asker sleeps before it looks for a server again.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// Whom the answer wakes.
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

/// The asker's end.
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
                // A server that is stuck must not hang its askers: they have deadlines.
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
            return Err(self.error("asking", "nobody there who could answer"));
        }
        self.bell.ring()?;
        Ok(Pending { pending, service: self.service })
    }

    /// Asks until there is an answer that can be read: waits for a server to appear, and asks again when it is
    /// gone. A dead one is gone when somebody has cleaned it away ([`Bus::clean_up`]). Every server gets the
    /// question, and what one of them answers that `read` makes nothing of is dropped. Sleeps on the asker's own
    /// `doorbell`, whose rings it takes, so afterwards the asker looks at everything it receives.
    ///
    /// # Errors
    /// When `keep_waiting`, which is called at every look, has one.
    pub fn ask<T, E: From<Error>>(
        &self,
        bytes: &[u8],
        doorbell: &Doorbell,
        read: impl Fn(Bytes) -> Option<T>,
        mut keep_waiting: impl FnMut() -> Result<(), E>,
    ) -> Result<T, E> {
        let mut sent = self.send(bytes);
        loop {
            // None where the question is lost.
            let polled = sent.as_ref().ok().and_then(|pending| pending.poll().ok());
            let is_lost = polled.is_none();
            let answered = polled.flatten();
            // Behind an answer that is not the server's another may be waiting already.
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

/// A question on its way. Dropping it gives the answer up.
#[derive(Debug)]
pub struct Pending {
    pending: PendingResponse<SharedMemory, [u8], Asker, [u8], ()>,
    service: &'static str,
}

impl Pending {
    /// The answer, once.
    ///
    /// # Errors
    /// When the server dropped the question or is gone. A dead server is gone when somebody has
    /// cleaned it away ([`Bus::clean_up`]).
    pub fn poll(&self) -> Result<Option<Bytes>, Error> {
        let connected = self.pending.is_connected();
        // Looked at after the connection, so that an answer just before the end is not missed.
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

/// The end that answers.
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
                // An asker that is stuck must not hang its server.
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
        })?;
        let bells = Role::ALL.into_iter().map(|role| bus.ringer(role)).collect::<Result<_, _>>()?;
        Ok(Server { server, bells, service: question.service })
    }

    /// The next question. It may be kept and answered later, after others.
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

/// A question received. Dropping it unanswered tells the asker so.
#[derive(Debug)]
pub struct Request {
    request: ActiveRequest<SharedMemory, [u8], Asker, [u8], ()>,
    bells: Rc<[Rc<Ringer>]>,
    service: &'static str,
}

impl Request {
    /// The question, in shared memory.
    pub fn bytes(&self) -> &[u8] {
        self.request.payload()
    }

    /// What the asker says it is.
    pub fn asker(&self) -> Option<Role> {
        Role::ALL.get(self.request.user_header().role as usize).copied()
    }

    /// Whether the asker still waits. One that keeps questions drops those whose asker does not.
    pub fn is_awaited(&self) -> bool {
        self.request.is_connected()
    }

    /// Answers and wakes the asker. An asker that is gone is no error.
    ///
    /// # Errors
    /// When there is no place for the answer.
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
