//! The actors of a run: started, started again when they die, and made more or fewer while it trains.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use protocol::run::RunFolder;

use super::process::Process;
use super::restart::{ActorDeaths, DEATH_WINDOW, MOST_DEATHS};
use crate::programs::Program;
use crate::progress::ProgressView;

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

/// The actors of a run.
pub(super) struct Actors {
    folder: RunFolder,
    source: Source,
    working: Vec<Actor>,
    /// Asked to stop; their leases are handed out again.
    leaving: Vec<Process>,
    /// Actors there have been. Names are never used twice: the last of a name may still be leaving.
    named: u64,
}

struct Actor {
    process: Process,
    deaths: ActorDeaths,
    /// Whether it has ended without an error.
    ended_well: bool,
    /// When it is started again, if it has ended.
    start_at: Option<Instant>,
}

impl Actors {
    /// The actors of the run in `folder`, none of them started.
    pub(super) fn new(folder: &RunFolder, source: &Source) -> Self {
        let (folder, source) = (folder.clone(), source.clone());
        Actors { folder, source, working: Vec::new(), leaving: Vec::new(), named: 0 }
    }

    /// Starts all of them.
    pub(super) fn start(&mut self) -> Result<()> {
        match self.source {
            Source::Environments(count) => self.scale(count),
            Source::Log { .. } => self.add(),
        }
    }

    /// Starts actors, or asks the last ones to stop, until there are so many. The one actor of a log
    /// stays the only one.
    pub(super) fn scale(&mut self, count: u64) -> Result<()> {
        if matches!(self.source, Source::Log { .. }) {
            return Ok(());
        }
        while (self.working.len() as u64) < count {
            self.add()?;
        }
        for mut actor in self.working.drain(count as usize..) {
            actor.process.ask_to_stop();
            self.leaving.push(actor.process);
        }
        Ok(())
    }

    fn add(&mut self) -> Result<()> {
        let name = format!("actor-{}", self.named);
        self.named += 1;
        let mut process = Process::new(&self.folder, Program::Actor, &name, self.arguments(&name));
        process.start()?;
        let deaths = ActorDeaths::default();
        self.working.push(Actor { process, deaths, ended_well: false, start_at: None });
        Ok(())
    }

    fn arguments(&self, name: &str) -> Vec<OsString> {
        let verb = match self.source {
            Source::Environments(_) => "rollout",
            Source::Log { .. } => "replay",
        };
        let run = self.folder.path().into();
        let mut arguments = vec![verb.into(), "--run".into(), run, "--name".into(), name.into()];
        if let Source::Log { log, iterations } = &self.source {
            arguments.extend(["--log".into(), log.into()]);
            if let Some(count) = iterations {
                arguments.extend(["--iterations".into(), count.to_string().into()]);
            }
        }
        arguments
    }

    /// Starts actors again that have ended; returns whether one has come to the end of its log.
    ///
    /// # Errors
    /// When one of them dies too often.
    pub(super) fn look_after(&mut self, view: &ProgressView) -> Result<bool> {
        let now = Instant::now();
        for process in &mut self.leaving {
            process.reap()?;
        }
        self.leaving.retain(Process::is_running);
        for actor in &mut self.working {
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
                if actor.ended_well && matches!(self.source, Source::Log { .. }) {
                    return Ok(true);
                }
                actor.process.start()?;
            }
        }
        Ok(false)
    }

    /// All processes, those included that are leaving.
    pub(super) fn processes(&mut self) -> impl Iterator<Item = &mut Process> {
        self.working.iter_mut().map(|actor| &mut actor.process).chain(&mut self.leaving)
    }
}
