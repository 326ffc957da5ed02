//! The actors of a run: started, started again when they die, and made more or fewer while it trains.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use run::actors_wanted::ActorsWanted;
use run::folder::RunFolder;
use run::hosts::Hosts;
use run::process::FINAL_CODE;

use super::process::Process;
use super::restart::{DEATH_WINDOW, Deaths, MOST_DEATHS};
use crate::limits;
use crate::listening::{Listening, require_an_actor};
use crate::machine::Machine;
use crate::programs::Program;
use crate::progress::ProgressView;

/// An actor leaves by itself when the run is over. The learner ends a moment later; if it does not,
/// the actor was wrong and comes back.
const COMEBACK: Duration = Duration::from_secs(1);

/// What the trajectories of a run come from.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    /// Environments, in so many actors.
    Environments {
        /// How many.
        count: u64,
        /// Their program.
        program: Program,
        /// How actors of other machines join, if they may.
        listening: Option<Listening>,
    },
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
    deaths: Deaths,
    /// Whether it has ended without an error.
    ended_well: bool,
    /// When it is started again, if it has ended.
    start_at: Option<Instant>,
    /// Whether it is left alone until then, because it has died too often.
    rests: bool,
}

impl Actor {
    /// Notes a death, and when to start again; says what is to be said about it.
    fn note_death(&mut self, how: &str) -> String {
        let (now, name) = (Instant::now(), self.process.name());
        let rest = self.deaths.note(now);
        self.ended_well = false;
        self.rests = rest.is_some();
        self.start_at = Some(now + rest.unwrap_or_default());
        match rest {
            None => format!("{name} ended ({how}) and is started again"),
            Some(rest) => format!(
                "{name} ended ({how}) {}: the run goes on without it and tries again in {} s",
                too_often(),
                rest.as_secs()
            ),
        }
    }
}

fn too_often() -> String {
    format!("for the {MOST_DEATHS}th time within {} s", DEATH_WINDOW.as_secs())
}

impl Actors {
    /// The actors of the run in `folder`, none of them started.
    pub(super) fn new(folder: &RunFolder, source: &Source) -> Self {
        let (folder, source) = (folder.clone(), source.clone());
        Actors { folder, source, working: Vec::new(), leaving: Vec::new(), named: 0 }
    }

    /// Takes on all of them.
    pub(super) fn take_on(&mut self) {
        match self.source {
            Source::Environments { count, .. } => self.scale(count),
            Source::Log { .. } => self.add(),
        }
    }

    /// Has as many as are wanted, and says so. None are enough where others do the work.
    pub(super) fn follow(
        &mut self,
        wanted: &mut ActorsWanted,
        are_others: bool,
        view: &ProgressView,
    ) {
        let allowed = |count: u64| {
            require_an_actor(count, are_others)?;
            Machine::here().require_room_for_actors(count)?;
            limits::check(count)?;
            Ok(count)
        };
        let changed = wanted.changed().map_err(anyhow::Error::from).transpose();
        match changed.map(|count| count.and_then(allowed)) {
            None => {}
            Some(Ok(count)) => {
                view.note(&format!("actors: {count} from now on"));
                self.scale(count);
            }
            Some(Err(error)) => view.note(&format!("the number of actors stays: {error:#}")),
        }
    }

    /// Takes actors on, or asks the last ones to stop, until there are so many. The one actor of a log
    /// stays the only one.
    fn scale(&mut self, count: u64) {
        if matches!(self.source, Source::Log { .. }) {
            return;
        }
        while (self.working.len() as u64) < count {
            self.add();
        }
        for mut actor in self.working.drain(count as usize..) {
            actor.process.ask_to_stop();
            self.leaving.push(actor.process);
        }
    }

    fn add(&mut self) {
        let name = format!("actor-{}", self.named);
        self.named += 1;
        let program = match &self.source {
            Source::Environments { program, .. } => program.clone(),
            Source::Log { .. } => Program::Actor,
        };
        let process = Process::new(&self.folder, program, &name, self.arguments(&name));
        let (deaths, start_at) = (Deaths::default(), Some(Instant::now()));
        self.working.push(Actor { process, deaths, ended_well: false, start_at, rests: false });
    }

    fn arguments(&self, name: &str) -> Vec<OsString> {
        let verb = match self.source {
            Source::Environments { .. } => "rollout",
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

    /// Starts actors that were taken on or have ended; returns whether one has come to the end of its
    /// log.
    ///
    /// # Errors
    /// When all of them die too often and no other machine has any, or one says that every other would die as
    /// well.
    pub(super) fn look_after(&mut self, view: &ProgressView) -> Result<bool> {
        for process in &mut self.leaving {
            process.reap()?;
        }
        self.leaving.retain(Process::is_running);
        let from_log = matches!(self.source, Source::Log { .. });
        for place in 0..self.working.len() {
            let actor = &mut self.working[place];
            let mut failure = None;
            match actor.process.reap()? {
                Some(status) if status.success() => {
                    (actor.ended_well, actor.start_at) = (true, Some(Instant::now() + COMEBACK));
                }
                Some(status) if status.code() == Some(i32::from(FINAL_CODE)) => {
                    return Err(actor.process.give_up(status, "and would come to the same again"));
                }
                Some(status) => failure = Some(status.to_string()),
                None => {}
            }
            if actor.start_at.is_some_and(|at| at <= Instant::now()) {
                if actor.ended_well && from_log {
                    return Ok(true);
                }
                (actor.start_at, actor.rests) = (None, false);
                failure = actor.process.start().err().map(|error| format!("{error:#}"));
            }
            if let Some(how) = failure {
                self.note_death(place, &how, view)?;
            }
        }
        Ok(false)
    }

    fn note_death(&mut self, place: usize, how: &str, view: &ProgressView) -> Result<()> {
        let said = self.working[place].note_death(how);
        if self.nobody_works(&self.hosts()) {
            let history = format!("{}, and no other actor works", too_often());
            return Err(self.working[place].process.give_up(how, &history));
        }
        view.note(&said);
        Ok(())
    }

    /// The other machines that take part.
    fn hosts(&self) -> Hosts {
        match self.source {
            Source::Environments { listening: Some(_), .. } => Hosts::of_run(&self.folder),
            _ => Hosts::default(),
        }
    }

    /// Whether all actors are left alone, and no other machine has any.
    fn nobody_works(&self, hosts: &Hosts) -> bool {
        let others_work = hosts.present.iter().any(|host| host.actors > 0);
        !others_work && self.working.iter().all(|actor| actor.rests)
    }

    /// All processes, those included that are leaving.
    pub(super) fn processes(&mut self) -> impl Iterator<Item = &mut Process> {
        self.working.iter_mut().map(|actor| &mut actor.process).chain(&mut self.leaving)
    }
}

#[cfg(test)]
mod tests {
    use run::hosts::Host;

    use super::*;

    #[test]
    fn a_run_goes_on_as_long_as_an_actor_works_on_any_machine() {
        let source = Source::Environments { count: 2, program: Program::Actor, listening: None };
        let mut actors = Actors::new(&RunFolder::new("run"), &source);
        actors.take_on();
        let with = |actors| {
            let (name, build) = ("node-7".to_owned(), "0.0.9".to_owned());
            let present = vec![Host { name, build, actors, distance_ms: None }];
            Hosts { present, expelled: Vec::new() }
        };
        actors.working[0].rests = true;
        assert!(!actors.nobody_works(&Hosts::default()), "the other one works");
        actors.working[1].rests = true;
        assert!(actors.nobody_works(&Hosts::default()));
        assert!(actors.nobody_works(&with(0)), "a machine that takes part without actors");
        assert!(!actors.nobody_works(&with(3)));
    }
}
