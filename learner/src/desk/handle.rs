//! The trainer's end of the desk: it sends orders and receives complete rollouts.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Result, anyhow};
use bus::{Bus, Ringer, Role};

use super::{Desk, Order, RolledOut, Setup};

/// Maximum number of queued orders; the trainer gives a handful per iteration.
const ORDERS: usize = 64;

/// The trainer's end of the desk.
pub struct DeskHandle {
    orders: SyncSender<Order>,
    rollouts: Receiver<RolledOut>,
    ringer: std::rc::Rc<Ringer>,
    thread: Option<JoinHandle<Result<f64>>>,
}

impl DeskHandle {
    /// Starts the desk; `bus` is the trainer's own, over which it rings the desk's doorbell.
    ///
    /// # Errors
    /// When the desk cannot open its ports or the log.
    pub fn start(setup: Setup, bus: &Bus) -> Result<DeskHandle> {
        let (orders, incoming) = sync_channel(ORDERS);
        let (outgoing, rollouts) = sync_channel(1);
        let (ready, opened) = sync_channel(1);
        let body = move || {
            let mut desk = Desk::open(setup, incoming, outgoing)?;
            // If the trainer is gone, the desk notices when it looks for orders.
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

    /// Sends an order to the desk.
    ///
    /// # Errors
    /// When the desk has ended; the error says why.
    pub fn order(&mut self, order: Order) -> Result<()> {
        if self.orders.send(order).is_err() {
            return Err(self.failure());
        }
        Ok(self.ringer.ring()?)
    }

    /// Returns the next complete rollout, if it arrives within `patience`.
    ///
    /// # Errors
    /// When the desk has ended; the error says why.
    pub fn rolled_out(&mut self, patience: Duration) -> Result<Option<RolledOut>> {
        use std::sync::mpsc::RecvTimeoutError::{Disconnected, Timeout};
        match self.rollouts.recv_timeout(patience) {
            Ok(rolled_out) => Ok(Some(rolled_out)),
            Err(Timeout) => Ok(None),
            Err(Disconnected) => Err(self.failure()),
        }
    }

    /// Waits until everything recorded so far is on the disk.
    ///
    /// # Errors
    /// When the desk has ended; the error says why.
    pub fn sync(&mut self) -> Result<()> {
        let (done, synced) = sync_channel(1);
        self.order(Order::Sync(done))?;
        if synced.recv().is_err() {
            return Err(self.failure());
        }
        Ok(())
    }

    /// Ends the desk of a run that is over, and waits for it; returns the seconds spent appending to the log.
    ///
    /// # Errors
    /// When the desk failed; the error says why.
    pub fn finish(mut self) -> Result<f64> {
        self.order(Order::Finish)?;
        self.join()
    }

    /// Ends the desk of a run that was stopped, and waits for it.
    ///
    /// # Errors
    /// When the desk failed; the error says why.
    pub fn stop(mut self) -> Result<()> {
        self.order(Order::Stop)?;
        self.join()?;
        Ok(())
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

impl Drop for DeskHandle {
    /// Has the desk seal the log if the trainer has failed, so that what it learned from last is recorded.
    fn drop(&mut self) {
        if self.thread.is_none() {
            return;
        }
        self.orders.send(Order::Leave).ok();
        self.ringer.ring().ok();
        if let Err(error) = self.join() {
            tracing::error!("{error:#}");
        }
    }
}
