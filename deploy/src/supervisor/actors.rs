//! The actors of a run: started, restarted when they die, and made more or fewer while it trains.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use run::actors_wanted::ActorsWanted;
use run::folder::RunFolder;
use run::hosts::Hosts;

use super::process::Process;
use super::restart::{DEATH_WINDOW, Deaths, MOST_DEATHS};
use crate::limits;
use crate::listening::{Listening, require_an_actor};
use crate::machine::Machine;
use crate::programs::Program;
use crate::progress::ProgressView;

/// Pause before an actor that ended without an error is restarted. An actor leaves when the run is over, and the
/// learner ends a moment later; if the learner does not, the run still needs the actor.
const COMEBACK: Duration = Duration::from_secs(1);

/// Where the trajectories of a run come from.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    /// Environments that actors act in.
    Environments {
        /// Number of actors.
        count: u64,
        /// Program of the actors.
        program: Program,
        /// How actors on other machines join, if they may.
        listening: Option<Listening>,
    },
    /// The log of a run, which one actor replays.
    Log {
        /// Folder of the log.
        log: PathBuf,
        /// Iterations to take from the log; all of them if `None`.
        iterations: Option<u64>,
    },
}

/// The actors of a run.
pub(super) struct Actors {
    folder: RunFolder,
    source: Source,
    working: Vec<Actor>,
    /// Actors that were asked to stop; their leases are handed out again.
    leaving: Vec<Process>,
    /// Number of actors ever added. Names are never used twice: the last actor of a name may still be leaving.
    named: u64,
}

struct Actor {
    process: Process,
    deaths: Deaths,
    /// Whether the actor has ended without an error.
    ended_well: bool,
    /// When the actor is to be started, if it does not run.
    start_at: Option<Instant>,
    /// Whether the actor is left alone until then, because it has died too often.
    rests: bool,
}

impl Actor {
    /// Notes a death, and when to restart the actor; returns a remark about it.
    fn note_death(&mut self, how: &str) -> String {
        let (now, name) = (Instant::now(), self.process.name());
        let rest = self.deaths.note(now);
        self.ended_well = false;
        self.rests = rest.is_some();
        self.start_at = Some(now + rest.unwrap_or_default());
        match rest {
            None => format!("{name} ended ({how}); restarting it"),
            Some(rest) => format!(
                "{name} ended ({how}) {}: the run continues without it and restarts it in {} s",
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
    /// Creates the actors of the run in `folder`, none of them started.
    pub(super) fn new(folder: &RunFolder, source: &Source) -> Self {
        let (folder, source) = (folder.clone(), source.clone());
        Actors { folder, source, working: Vec::new(), leaving: Vec::new(), named: 0 }
    }

    /// Adds all actors of the source.
    pub(super) fn take_on(&mut self) {
        match self.source {
            Source::Environments { count, .. } => self.scale(count),
            Source::Log { .. } => self.scale(1),
        }
    }

    /// Changes to the wanted number of actors if it is a new one, and says so. One that cannot be had is taken back.
    /// With `are_others`, it may be 0, since other machines can do the work.
    pub(super) fn follow(
        &mut self,
        wanted: &mut ActorsWanted,
        are_others: bool,
        view: &ProgressView,
    ) {
        let allowed = |count: u64| {
            let is_log = matches!(self.source, Source::Log { .. });
            ensure!(!is_log, "one actor replays the log");
            require_an_actor(count, are_others)?;
            Machine::here().require_room_for_actors("--actors", count)?;
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
            Some(Err(error)) => {
                view.note(&format!("the number of actors is unchanged: {error:#}"));
                if let Err(error) = wanted.refuse(self.working.len() as u64) {
                    view.note(&error.to_string());
                }
            }
        }
    }

    /// Adds actors, or asks the last ones to stop, until there are `count`.
    fn scale(&mut self, count: u64) {
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

    /// Starts actors that were added or have ended; returns whether one has reached the end of its log.
    ///
    /// # Errors
    /// When all actors die too often and no other machine has any, or when one fails as every other would.
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
                Some(status) => match actor.process.final_error(status) {
                    Some(error) => return Err(error),
                    None => failure = Some(status.to_string()),
                },
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

    /// Returns the other machines that take part.
    fn hosts(&self) -> Hosts {
        match self.source {
            Source::Environments { listening: Some(_), .. } => Hosts::of_run(&self.folder),
            _ => Hosts::default(),
        }
    }

    /// Returns whether all actors are left alone and no other machine has any.
    fn nobody_works(&self, hosts: &Hosts) -> bool {
        let others_work = hosts.present.iter().any(|host| host.actors > 0);
        !others_work && self.working.iter().all(|actor| actor.rests)
    }

    /// Returns all processes, including those that are leaving.
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
            Hosts { present, ..Hosts::default() }
        };
        actors.working[0].rests = true;
        assert!(!actors.nobody_works(&Hosts::default()), "the other one works");
        actors.working[1].rests = true;
        assert!(actors.nobody_works(&Hosts::default()));
        assert!(actors.nobody_works(&with(0)), "a machine that takes part without actors");
        assert!(!actors.nobody_works(&with(3)));
    }
}
