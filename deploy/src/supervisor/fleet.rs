//! All processes of a run: one learner, one proximity service, any number of actors.

use std::ffi::OsString;
use std::time::{Duration, Instant};

use anyhow::Result;
use protocol::run::RunFolder;

use super::process::Process;
use super::restart::{ActorDeaths, DEATH_WINDOW, MOST_DEATHS};
use super::signals::Signals;
use crate::programs::Program;
use crate::progress::ProgressView;

/// How long processes may take to stop when the learner is done.
const STOP_PATIENCE: Duration = Duration::from_secs(10);

/// An actor leaves by itself when the run is over. The learner ends a moment later; if it does not,
/// the actor was wrong and comes back.
const COMEBACK: Duration = Duration::from_secs(1);

/// The processes of a run.
pub(super) struct Fleet {
    pub(super) learner: Process,
    pub(super) service: Process,
    actors: Vec<Actor>,
}

struct Actor {
    process: Process,
    deaths: ActorDeaths,
    /// When it is started again, if it has ended.
    start_at: Option<Instant>,
}

impl Fleet {
    /// The processes of the run in `folder`, none of them started.
    pub(super) fn new(folder: &RunFolder, actor_count: u64) -> Self {
        let run = || [OsString::from("--run"), folder.path().into()];
        let process = |program, name: &str, before: &[&str], after: &[&str]| {
            let before = before.iter().map(OsString::from);
            let arguments = before.chain(run()).chain(after.iter().map(OsString::from)).collect();
            Process::new(folder, program, name, arguments)
        };
        let actor = |number: u64| {
            let name = format!("actor-{number}");
            let process = process(Program::Actor, &name, &["rollout"], &["--name", &name]);
            Actor { process, deaths: ActorDeaths::default(), start_at: None }
        };
        Fleet {
            learner: process(Program::Learner, "learner", &[], &[]),
            service: process(Program::ProximityService, "proximity-service", &[], &[]),
            actors: (0..actor_count).map(actor).collect(),
        }
    }

    /// Starts every process.
    pub(super) fn start(&mut self) -> Result<()> {
        self.start_core()?;
        self.actors.iter_mut().try_for_each(|actor| actor.process.start())
    }

    /// Starts proximity service and learner.
    pub(super) fn start_core(&mut self) -> Result<()> {
        self.service.start()?;
        self.learner.start()
    }

    /// Starts actors again that have ended.
    ///
    /// # Errors
    /// When one of them dies too often.
    pub(super) fn look_after_actors(&mut self, view: &ProgressView) -> Result<()> {
        let now = Instant::now();
        for actor in &mut self.actors {
            match actor.process.reap()? {
                Some(status) if status.success() => actor.start_at = Some(now + COMEBACK),
                Some(status) if actor.deaths.allow_restart(now) => {
                    let name = actor.process.name();
                    view.note(&format!("{name} ended ({status}) and is started again"));
                    actor.start_at = Some(now);
                }
                Some(status) => {
                    let seconds = DEATH_WINDOW.as_secs();
                    let history = format!("for the {MOST_DEATHS}th time within {seconds} s");
                    return Err(actor.process.give_up(status, &history));
                }
                None => {}
            }
            if actor.start_at.is_some_and(|at| at <= now) {
                actor.start_at = None;
                actor.process.start()?;
            }
        }
        Ok(())
    }

    /// Ends all processes: politely at first, by force after [`STOP_PATIENCE`] or when the user
    /// asks again.
    pub(super) async fn end(&mut self, signals: &mut Signals) -> Result<()> {
        self.processes().for_each(Process::ask_to_stop);
        let deadline = tokio::time::Instant::now() + STOP_PATIENCE;
        loop {
            for process in self.processes() {
                process.reap()?;
            }
            if !self.processes().any(|process| process.is_running()) {
                return Ok(());
            }
            tokio::select! {
                () = signals.child.next() => {}
                () = signals.stop.next() => break,
                () = tokio::time::sleep_until(deadline) => break,
            }
        }
        self.processes().try_for_each(Process::kill)
    }

    fn processes(&mut self) -> impl Iterator<Item = &mut Process> {
        let actors = self.actors.iter_mut().map(|actor| &mut actor.process);
        [&mut self.learner, &mut self.service].into_iter().chain(actors)
    }
}
