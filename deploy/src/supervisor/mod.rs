//! Supervises a run: starts its processes, restarts those that die, shows progress, and ends them all.
//!
//! An actor that dies is restarted under its name, and the learner hands out its leases again. An actor that dies again
//! and again is left alone for a while, as long as another one works, here or on another machine. Learner and proximity
//! service share one state: if one of them dies, both are restarted from their last common checkpoint. None of this
//! changes the result.

mod actors;
mod bus_folder;
mod bus_watch;
mod fleet;
mod gateway;
mod joined;
mod process;
mod restart;
mod signals;

use std::process::ExitStatus;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use bus::BusAddress;
use protocol::messages::Progress;
use run::actors_wanted::ActorsWanted;
use run::checkpoint;
use run::config::RunConfig;
use run::folder::{Place, RunFolder};
use run::hosts::Hosts;
use run::updates::measured;

use crate::progress::ProgressView;
use crate::progress_file;
pub(crate) use actors::Source;
use bus_folder::BusFolder;
use bus_watch::BusWatch;
use fleet::Fleet;
pub(crate) use joined::{Joining, take_part};

use restart::{CoreRestarts, MOST_RESTARTS};
pub(crate) use signals::Signals;

/// Time between two checks of the processes if no signal arrives.
const TICK: Duration = Duration::from_millis(250);

/// How long the learner may take to finish its iteration and write a checkpoint.
const CHECKPOINT_PATIENCE: Duration = Duration::from_secs(60);

/// How long the service may take to stop when the learner has died.
const SURVIVOR_PATIENCE: Duration = Duration::from_secs(3);

/// How long to wait for the processes of a dead supervisor: their learner may be writing a checkpoint.
const PREDECESSOR_PATIENCE: Duration = Duration::from_secs(60);

/// How long processes that the supervisor did not start may take to notice the end of the run.
const FAREWELL_PATIENCE: Duration = Duration::from_secs(5);

/// How a run's training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// The run is finished.
    Finished,
    /// The user stopped the run; it can be continued.
    Stopped,
    /// The log that the run learned from has ended.
    EndOfLog,
}

/// Creates the tokio runtime for supervision and for everything else that waits for processes and signals.
///
/// # Errors
/// When the system cannot provide it.
pub(crate) fn runtime() -> Result<tokio::runtime::Runtime> {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    runtime.enable_all().build().context("preparing to wait")
}

/// Starts a run's processes and supervises them to its end.
///
/// # Errors
/// As [`supervise`].
pub(crate) fn block_on_supervision(
    folder: &RunFolder,
    source: &Source,
    view: &mut ProgressView,
) -> Result<Outcome> {
    runtime()?.block_on(supervise(folder, source, view))
}

/// Trains the run in `folder`, which has its configuration and demonstrations, to its end or to the end of the log that
/// it learns from.
///
/// # Errors
/// When a process cannot start or dies too often, or the bus fails. No process is left behind.
async fn supervise(
    folder: &RunFolder,
    source: &Source,
    view: &mut ProgressView,
) -> Result<Outcome> {
    let mut signals = Signals::listen()?;
    let place = folder.place()?;
    let address = BusAddress::for_start(folder.path())?;
    if !await_predecessors(&address, &mut signals, view).await? {
        return Ok(Outcome::Stopped);
    }
    address.remove()?;
    settle_checkpoints(folder, view)?;
    progress_file::clear(folder);
    Hosts::clear(folder);
    let (config, wanted) = (folder.config()?, ActorsWanted::here(folder));
    let watch = BusWatch::start(&address)?;
    let fleet = Fleet::new(folder, source);
    let restarts = CoreRestarts::default();
    let bus = BusFolder::of(&address);
    let mut supervision =
        Supervision { folder, config, place, bus, view, signals, watch, fleet, restarts, wanted };
    let outcome = supervision.run().await;
    let Supervision { mut fleet, mut signals, watch, view, .. } = supervision;
    let ended = fleet.end(&mut signals).await;
    watch.end();
    clear_bus(ended, &address, view).await;
    outcome
}

/// Removes what a run left in shared memory after its processes `ended`. A failure is only noted, since the user is to
/// learn how the run itself came out.
async fn clear_bus(ended: Result<()>, address: &BusAddress, view: &ProgressView) {
    let removed = match ended {
        Ok(()) => remove_from_bus(address).await,
        Err(error) => Err(error),
    };
    if let Err(error) = removed {
        view.note(&format!("something of the run is left in shared memory: {error:#}"));
    }
}

/// Removes a run's bus once processes without a supervisor have noticed the end of the run.
pub(crate) async fn remove_from_bus(address: &BusAddress) -> Result<()> {
    let deadline = tokio::time::Instant::now() + FAREWELL_PATIENCE;
    while address.is_anyone_alive()? && tokio::time::Instant::now() < deadline {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    Ok(address.remove()?)
}

/// Returns the iterations of the newest intact checkpoint, and tells the user about damaged ones that were passed over.
fn settle_checkpoints(folder: &RunFolder, view: &ProgressView) -> Result<Option<u64>> {
    let found = checkpoint::settle(folder)?;
    found.remarks().iter().for_each(|remark| view.note(remark));
    Ok(found.newest.map(|newest| newest.iteration))
}

/// Waits for the processes of a dead supervisor to end; returns false if the user does not want to wait.
async fn await_predecessors(
    address: &BusAddress,
    signals: &mut Signals,
    view: &mut ProgressView,
) -> Result<bool> {
    let deadline = tokio::time::Instant::now() + PREDECESSOR_PATIENCE;
    let mut is_said = false;
    while address.is_anyone_alive()? {
        if !std::mem::replace(&mut is_said, true) {
            view.activity("waiting for processes of an earlier start to end");
        }
        tokio::select! {
            () = signals.stop.next() => return Ok(false),
            () = tokio::time::sleep_until(deadline) => {
                bail!(
                    "processes of an earlier start of this run still live after {} s",
                    PREDECESSOR_PATIENCE.as_secs()
                );
            }
            () = tokio::time::sleep(TICK) => {}
        }
    }
    Ok(true)
}

struct Supervision<'a> {
    folder: &'a RunFolder,
    config: RunConfig,
    place: Place,
    bus: BusFolder,
    view: &'a mut ProgressView,
    signals: Signals,
    watch: BusWatch,
    fleet: Fleet,
    restarts: CoreRestarts,
    wanted: ActorsWanted,
}

impl Supervision<'_> {
    async fn run(&mut self) -> Result<Outcome> {
        self.view.activity("starting the processes");
        self.fleet.start()?;
        self.fleet.actors.look_after(self.view)?;
        loop {
            tokio::select! {
                () = self.signals.stop.next() => return self.stop().await,
                () = self.signals.child.next() => {}
                progress = self.watch.next() => self.show(progress?),
                () = tokio::time::sleep(TICK) => self.view.tick(),
            }
            if let Some(outcome) = self.look_after().await? {
                return Ok(outcome);
            }
        }
    }

    /// Shows progress on the terminal and writes it to the run's folder.
    fn show(&mut self, progress: Progress) {
        if let Err(error) = progress_file::write(self.folder, &progress) {
            tracing::debug!("progress could not be written: {error}");
        }
        self.view.show(&measured(&self.config, progress));
    }

    /// Notices deaths and restarts what died; returns the outcome if the run has ended.
    async fn look_after(&mut self) -> Result<Option<Outcome>> {
        self.place.check()?;
        self.bus.check()?;
        if let Some(status) = self.fleet.learner.reap()? {
            if status.success() && self.is_finished() {
                return Ok(Some(Outcome::Finished));
            }
            return self.restart_core(CoreProcess::Learner, status).await;
        }
        if let Some(status) = self.fleet.service.reap()? {
            return self.restart_core(CoreProcess::Service, status).await;
        }
        let can_be_joined = self.fleet.gateway.is_some();
        self.fleet.actors.follow(&mut self.wanted, can_be_joined, self.view);
        if let Some(gateway) = &mut self.fleet.gateway {
            gateway.look_after(self.folder, self.view)?;
        }
        if self.fleet.actors.look_after(self.view)? {
            self.end_learner().await?;
            return Ok(Some(self.unless_finished(Outcome::EndOfLog)));
        }
        Ok(None)
    }

    fn unless_finished(&self, outcome: Outcome) -> Outcome {
        if self.is_finished() { Outcome::Finished } else { outcome }
    }

    fn is_finished(&self) -> bool {
        self.folder.summary_file().exists()
    }

    /// Restarts learner and proximity service, one of which has died, unless the run is finished.
    async fn restart_core(
        &mut self,
        dead: CoreProcess,
        status: ExitStatus,
    ) -> Result<Option<Outcome>> {
        let Fleet { learner, service, .. } = &mut self.fleet;
        let (dead, survivor, patience) = match dead {
            CoreProcess::Learner => (learner, service, SURVIVOR_PATIENCE),
            // The learner waits for an answer that does not come, and repeats what it has not recorded.
            CoreProcess::Service => (service, learner, Duration::ZERO),
        };
        if let Some(error) = dead.final_error(status) {
            return Err(error);
        }
        survivor.ask_to_stop();
        if survivor.is_running()
            && survivor.ended(&mut self.signals.child, patience).await?.is_none()
        {
            survivor.kill()?;
        }
        if self.folder.summary_file().exists() {
            return Ok(Some(Outcome::Finished));
        }
        let checkpoint = settle_checkpoints(self.folder, self.view)?;
        if !self.restarts.allow_restart(checkpoint) {
            let history = format!("after {MOST_RESTARTS} restarts without a new checkpoint");
            return Err(dead.give_up(status, &history));
        }
        let place = match checkpoint {
            Some(iteration) => format!("the checkpoint after iteration {iteration}"),
            None => "the beginning".to_owned(),
        };
        self.view.note(&format!(
            "{} ended ({status}); restarting learner and proximity service from {place}",
            dead.name()
        ));
        self.fleet.start_core()?;
        Ok(None)
    }

    /// Stops the run at the user's request.
    async fn stop(&mut self) -> Result<Outcome> {
        self.view.note(
            "stopping: the learner finishes its iteration and writes a checkpoint (press Ctrl-C \
             again to stop at once)",
        );
        self.end_learner().await?;
        Ok(self.unless_finished(Outcome::Stopped))
    }

    /// Ends the learner with a checkpoint. The learner needs the other processes for it, so they end later.
    ///
    /// # Errors
    /// When the learner could not write the checkpoint, but not when the user does not wait for it.
    async fn end_learner(&mut self) -> Result<()> {
        let learner = &mut self.fleet.learner;
        learner.ask_to_stop();
        let (status, is_asked_again) = tokio::select! {
            status = learner.ended(&mut self.signals.child, CHECKPOINT_PATIENCE) => (status?, false),
            () = self.signals.stop.next() => (None, true),
        };
        match status {
            Some(status) if status.success() => Ok(()),
            Some(status) => Err(learner.give_up(status, "without a checkpoint of its latest work")),
            None => {
                self.view.note(
                    "killing the learner; the work since its last checkpoint is repeated when the run is \
                     resumed",
                );
                learner.kill().context("ending the learner")?;
                let seconds = CHECKPOINT_PATIENCE.as_secs();
                ensure!(is_asked_again, "expected a checkpoint within {seconds} s, found none");
                Ok(())
            }
        }
    }
}

/// The two processes that share a state.
#[derive(Clone, Copy)]
enum CoreProcess {
    Learner,
    Service,
}
