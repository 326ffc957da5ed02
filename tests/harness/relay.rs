//! A link between two machines that a test can slow down, make lossy, or cut: a relay of TCP connections.

use std::io::{Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Most pieces in flight in one direction of a connection.
const UNDER_WAY: usize = 1024;

/// Largest piece, bytes.
const PIECE: usize = 16 << 10;

/// How often a cut link is checked.
const LOOK_EVERY: Duration = Duration::from_millis(2);

/// Delay of a lost piece: the least time after which TCP retransmits.
const SENT_AGAIN: Duration = Duration::from_millis(200);

/// On a lossy link, one in this many pieces is lost.
const LOST_ONE_OF: u64 = 100;

/// A link to one address.
#[derive(Debug)]
pub struct Relay {
    address: SocketAddr,
    link: Arc<Link>,
}

#[derive(Debug, Default)]
struct Link {
    delay_us: AtomicU64,
    is_cut: AtomicBool,
    is_lossy: AtomicBool,
    pieces: AtomicU64,
}

impl Relay {
    /// Starts a link without faults from `here` to `target`, which need not be listening yet.
    pub fn new(here: IpAddr, target: &str) -> Relay {
        let listener = TcpListener::bind((here, 0)).unwrap();
        let address = listener.local_addr().unwrap();
        let (link, target) = (Arc::new(Link::default()), target.to_owned());
        let shared = Arc::clone(&link);
        start(move || {
            for near in listener.incoming().flatten() {
                // If nobody listens there, dropping the connection tells the client.
                let Ok(far) = TcpStream::connect(&target) else { continue };
                carry(near.try_clone().unwrap(), far.try_clone().unwrap(), &shared);
                carry(far, near, &shared);
            }
        });
        Relay { address, link }
    }

    /// The address that clients connect to.
    pub fn address(&self) -> String {
        self.address.to_string()
    }

    /// Sets the one-way delay.
    pub fn delay(&self, delay: Duration) {
        self.link.delay_us.store(delay.as_micros() as u64, Ordering::Relaxed);
    }

    /// Sets whether one per cent of the pieces is lost and retransmitted.
    pub fn lose(&self, is_lossy: bool) {
        self.link.is_lossy.store(is_lossy, Ordering::Relaxed);
    }

    /// Sets whether the link is cut: nothing comes through, but connections stay open.
    pub fn cut(&self, is_cut: bool) {
        self.link.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

impl Link {
    /// Returns when a piece that is sent now arrives.
    fn due(&self) -> Instant {
        let number = self.pieces.fetch_add(1, Ordering::Relaxed);
        let delay = Duration::from_micros(self.delay_us.load(Ordering::Relaxed));
        let is_lost = self.is_lossy.load(Ordering::Relaxed) && number.is_multiple_of(LOST_ONE_OF);
        Instant::now() + delay + if is_lost { SENT_AGAIN } else { Duration::ZERO }
    }
}

fn start(body: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().name("relay".to_owned()).spawn(body).unwrap();
}

/// Carries one direction of a connection to its end.
fn carry(from: TcpStream, to: TcpStream, link: &Arc<Link>) {
    let (pieces, arriving) = sync_channel(UNDER_WAY);
    let (reader, writer) = (Arc::clone(link), Arc::clone(link));
    start(move || take(from, &pieces, &reader));
    start(move || bring(to, &arriving, &writer));
}

fn take(mut from: TcpStream, pieces: &SyncSender<(Instant, Vec<u8>)>, link: &Link) {
    let mut piece = vec![0; PIECE];
    while let Ok(length @ 1..) = from.read(&mut piece) {
        if pieces.send((link.due(), piece[..length].to_vec())).is_err() {
            return;
        }
    }
}

fn bring(mut to: TcpStream, arriving: &Receiver<(Instant, Vec<u8>)>, link: &Link) {
    to.set_nodelay(true).ok();
    while let Ok((due, piece)) = arriving.recv() {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        while link.is_cut.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK_EVERY);
        }
        if to.write_all(&piece).is_err() {
            return;
        }
    }
    to.shutdown(Shutdown::Write).ok();
}
