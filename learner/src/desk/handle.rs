//! The trainer's end of the desk: orders one way, complete rollouts the other.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Result, anyhow};
use bus::{Bus, Ringer, Role};

use super::{Desk, Order, RolledOut, Setup};

/// Orders that may wait; the trainer gives a handful per iteration.
const ORDERS: usize = 64;

/// The trainer's end of the desk.
pub struct DeskHandle {
    orders: SyncSender<Order>,
    rollouts: Receiver<RolledOut>,
    ringer: std::rc::Rc<Ringer>,
    thread: Option<JoinHandle<Result<f64>>>,
}

impl DeskHandle {
    /// Starts the desk; `bus` is the trainer's own, over which it rings the desk.
    ///
    /// # Errors
    /// When the desk cannot open its ports or the log.
    pub fn start(setup: Setup, bus: &Bus) -> Result<DeskHandle> {
        let (orders, incoming) = sync_channel(ORDERS);
        let (outgoing, rollouts) = sync_channel(1);
        let (ready, opened) = sync_channel(1);
        let body = move || {
            let mut desk = Desk::open(setup, incoming, outgoing)?;
            // The trainer may have gone; then the first order says so.
            ready.send(()).ok();
            desk.run()
        };
        let thread = std::thread::Builder::new().name("desk".to_owned()).spawn(body)?;
        let ringer = bus.ringer(Role::Learner)?;
        let mut handle = DeskHandle { orders, rollouts, ringer, thread: Some(thread) };
        match opened.recv() {
            Ok(()) => Ok(handle),
            Err(_) => Err(handle.failure()),
        }
    }

    /// Gives an order.
    ///
    /// # Errors
    /// Why the desk has ended, if it has.
    pub fn order(&mut self, order: Order) -> Result<()> {
        if self.orders.send(order).is_err() {
            return Err(self.failure());
        }
        Ok(self.ringer.ring()?)
    }

    /// The next complete rollout, if it comes within `patience`.
    ///
    /// # Errors
    /// Why the desk has ended, if it has.
    pub fn rolled_out(&mut self, patience: Duration) -> Result<Option<RolledOut>> {
        use std::sync::mpsc::RecvTimeoutError::{Disconnected, Timeout};
        match self.rollouts.recv_timeout(patience) {
            Ok(rolled_out) => Ok(Some(rolled_out)),
            Err(Timeout) => Ok(None),
            Err(Disconnected) => Err(self.failure()),
        }
    }

    /// Returns when everything recorded so far is on the disk.
    ///
    /// # Errors
    /// Why the desk has ended, if it has.
    pub fn sync(&mut self) -> Result<()> {
        let (done, synced) = sync_channel(1);
        self.order(Order::Sync(done))?;
        if synced.recv().is_err() {
            return Err(self.failure());
        }
        Ok(())
    }

    /// Ends the desk and waits for it; returns the seconds that appending to the log took.
    ///
    /// # Errors
    /// Why the desk failed, if it did.
    pub fn finish(mut self) -> Result<f64> {
        self.order(Order::Finish)?;
        self.join()
    }

    fn failure(&mut self) -> anyhow::Error {
        self.join().err().unwrap_or_else(|| anyhow!("the desk ended before the run"))
    }

    fn join(&mut self) -> Result<f64> {
        let Some(thread) = self.thread.take() else { return Ok(0.0) };
        // The panic itself has been printed by the thread.
        thread.join().unwrap_or_else(|_| Err(anyhow!("the desk panicked")))
    }
}
