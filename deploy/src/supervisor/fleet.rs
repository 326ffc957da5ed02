//! All processes of a run: one learner, one proximity service, any number of actors.

use std::ffi::OsString;
use std::path::PathBuf;
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

/// What the trajectories of a run come from.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    /// Environments, in so many actors.
    Environments(u64),
    /// The log of a run, by one actor.
    Log {
        /// Folder of the log.
        log: PathBuf,
        /// Iterations to take from it; all that it has if absent.
        iterations: Option<u64>,
    },
}

/// The processes of a run.
pub(super) struct Fleet {
    pub(super) learner: Process,
    pub(super) service: Process,
    actors: Vec<Actor>,
    /// Whether actors that have done their work come back.
    actors_return: bool,
}

struct Actor {
    process: Process,
    deaths: ActorDeaths,
    /// Whether it has ended without an error.
    ended_well: bool,
    /// When it is started again, if it has ended.
    start_at: Option<Instant>,
}

impl Fleet {
    /// The processes of the run in `folder`, none of them started.
    pub(super) fn new(folder: &RunFolder, source: &Source) -> Self {
        let run = || [OsString::from("--run"), folder.path().into()];
        let core = |program, name, verb: &[OsString]| {
            Process::new(folder, program, name, [verb, &run()].concat())
        };
        let actor = |number: u64, verb: &str, further: &[OsString]| {
            let name = format!("actor-{number}");
            let named = ["--name".into(), OsString::from(&name)];
            let arguments = [&[verb.into()], &run()[..], &named, further].concat();
            let process = Process::new(folder, Program::Actor, &name, arguments);
            Actor { process, deaths: ActorDeaths::default(), ended_well: false, start_at: None }
        };
        let actors = match source {
            Source::Environments(count) => {
                (0..*count).map(|number| actor(number, "rollout", &[])).collect()
            }
            Source::Log { log, iterations } => {
                let count =
                    iterations.map(|count| ["--iterations".into(), count.to_string().into()]);
                let log = ["--log".into(), log.into()];
                let further = [&log[..], count.as_ref().map_or(&[], |count| &count[..])].concat();
                vec![actor(0, "replay", &further)]
            }
        };
        Fleet {
            learner: core(Program::Learner, "learner", &[]),
            service: core(Program::ProximityService, "proximity-service", &["serve".into()]),
            actors,
            actors_return: matches!(source, Source::Environments(_)),
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

    /// Starts actors again that have ended; returns whether one has come to the end of its log.
    ///
    /// # Errors
    /// When one of them dies too often.
    pub(super) fn look_after_actors(&mut self, view: &ProgressView) -> Result<bool> {
        let now = Instant::now();
        for actor in &mut self.actors {
            match actor.process.reap()? {
                Some(status) if status.success() => {
                    (actor.ended_well, actor.start_at) = (true, Some(now + COMEBACK));
                }
                Some(status) if actor.deaths.allow_restart(now) => {
                    let name = actor.process.name();
                    view.note(&format!("{name} ended ({status}) and is started again"));
                    (actor.ended_well, actor.start_at) = (false, Some(now));
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
                if actor.ended_well && !self.actors_return {
                    return Ok(true);
                }
                actor.process.start()?;
            }
        }
        Ok(false)
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
