//! The processes of a live run: those on its bus, and what the system says about each. A process that is stopped, gone
//! or stuck is thus named, with its process id.

use std::collections::BTreeSet;
use std::fs;
use std::time::{Duration, Instant};

use anyhow::Result;
use bus::{BusAddress, Member};
use protocol::messages::ActorHeard;
use run::process_stat::ProcessStat;
use serde::Serialize;

use terminal::numbers;

const SUPERVISOR: &str = "supervisor";

/// Column titles of the table of processes.
pub(crate) const HEAD: [&str; 8] =
    ["process", "id", "state", "processor", "up", "leases", "steps/s", "heard of"];

/// The processes that every run has besides its actors.
const CORE: [&str; 3] = [SUPERVISOR, "learner", "proximity-service"];

/// Shortest time over which processor time is measured.
const LEAST_SAMPLE: Duration = Duration::from_millis(250);

/// Stands for an unknown value.
const UNKNOWN: &str = "-";

/// What a process is doing, as far as the system knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum State {
    /// The process runs, or waits for something.
    Running,
    /// A signal has stopped the process.
    Stopped,
    /// The process has ended or was never there.
    Gone,
    /// The process lives, but the system does not show it: it belongs to another user, or is in another container or on
    /// another machine.
    Hidden,
}

/// A process of a run.
#[derive(Debug)]
struct Process {
    /// Short name: supervisor, learner, proximity-service, actor-0 and so on.
    name: String,
    /// Name on the bus.
    full_name: String,
    id: Option<u32>,
    state: State,
    begun: Option<ProcessStat>,
}

/// A process of a run, as printed for programs.
#[derive(Debug, Serialize)]
pub(crate) struct ProcessFigures {
    process: String,
    id: Option<u32>,
    state: State,
    /// For actors, in this field and the next two: leases held, environment steps per second since the actor was first
    /// heard of, and seconds since it was last heard of.
    leases: Option<u32>,
    steps_per_s: Option<f64>,
    heard_s_ago: Option<f64>,
}

/// The processes of a run.
#[derive(Debug)]
pub(crate) struct Processes {
    looked: Instant,
    processes: Vec<Process>,
}

impl Processes {
    /// Lists the processes on a run's bus, except for this one.
    ///
    /// # Errors
    /// When the bus cannot be listed.
    pub(crate) fn on(address: &BusAddress) -> Result<Processes> {
        Ok(Processes::of(address.members()?))
    }

    fn of(members: Vec<Member>) -> Processes {
        let mut known = BTreeSet::from([std::process::id()]);
        let others = members.into_iter().filter(|member| match member.process {
            // Some processes have two names on the bus; the first one is the process's own.
            Some(id) => is_elsewhere(&member.name) || known.insert(id),
            None => true,
        });
        let mut processes: Vec<Process> = others.map(Process::of).collect();
        processes.sort_by_key(|process| {
            let place = CORE.iter().position(|name| *name == process.name);
            (place.unwrap_or(CORE.len()), process.name.len(), process.name.clone())
        });
        Processes { looked: Instant::now(), processes }
    }

    /// Returns whether processes that train are among them, not only tools.
    pub(crate) fn train(&self) -> bool {
        let trains = |name: &str| CORE.contains(&name) || is_actor(name);
        self.processes.iter().any(|process| trains(&process.name) && process.state != State::Gone)
    }

    /// Returns the number of living actors on this machine.
    pub(crate) fn actors_here(&self) -> usize {
        let is_here = |name: &str| is_actor(name) && !is_elsewhere(name);
        let alive = self.processes.iter().filter(|process| process.state != State::Gone);
        alive.filter(|process| is_here(&process.full_name)).count()
    }

    /// Returns a phrase that says why the run does not go on as it should, if that can be seen.
    pub(crate) fn trouble(&self) -> Option<String> {
        let stopped = |name: &&str| self.state(name) == State::Stopped;
        let gone = |name: &&str| self.state(name) == State::Gone;
        if let Some(name) = CORE[1..].iter().copied().find(stopped) {
            return Some(format!("stalled: {name} is stopped"));
        }
        if gone(&SUPERVISOR) {
            return Some("ending: its supervisor is gone".to_owned());
        }
        if let Some(name) = CORE[1..].iter().copied().find(gone) {
            return Some(format!("starting or ending: {name} is not there"));
        }
        let actors = || self.processes.iter().filter(|process| is_actor(&process.name));
        if actors().next().is_none() {
            return Some("starting or ending: no actor is there".to_owned());
        }
        if actors().all(|actor| matches!(actor.state, State::Stopped | State::Gone)) {
            return Some("stalled: no actor is running".to_owned());
        }
        stopped(&SUPERVISOR).then(|| "training, but its supervisor is stopped".to_owned())
    }

    fn state(&self, name: &str) -> State {
        let found = self.processes.iter().find(|process| process.name == name);
        found.map_or(State::Gone, |process| process.state)
    }

    /// Returns a row for each process, with the columns of [`HEAD`].
    pub(crate) fn rows(&self, heard: &[ActorHeard]) -> Vec<[String; 8]> {
        std::thread::sleep(LEAST_SAMPLE.saturating_sub(self.looked.elapsed()));
        let row = |process: &Process| {
            let heard = heard.iter().find(|heard| heard.name == process.full_name);
            process.row(self.looked.elapsed(), heard)
        };
        self.processes.iter().map(row).collect()
    }

    /// Returns the processes for programs.
    pub(crate) fn figures(&self, heard: &[ActorHeard]) -> Vec<ProcessFigures> {
        let figures = |process: &Process| {
            let heard = heard.iter().find(|heard| heard.name == process.full_name);
            ProcessFigures {
                process: process.name.clone(),
                id: process.id,
                state: process.state,
                leases: heard.map(|heard| heard.leases),
                steps_per_s: heard.map(|heard| heard.steps_per_s),
                heard_s_ago: heard.map(|heard| heard.ago_s),
            }
        };
        self.processes.iter().map(figures).collect()
    }

    /// Returns the rows below their titles, followed by how to continue processes that are stopped.
    pub(crate) fn table(&self, heard: &[ActorHeard]) -> String {
        let head = std::iter::once(HEAD.map(str::to_owned));
        let rows: Vec<_> = head.chain(self.rows(heard)).collect();
        let stopped = self.processes.iter().filter(|process| process.state == State::Stopped);
        let advice = stopped.filter_map(|process| {
            let (name, id) = (&process.name, process.id?);
            Some(format!("{name} is stopped by a signal: `kill -CONT {id}` resumes it\n"))
        });
        numbers::columns(&rows) + &advice.collect::<String>()
    }
}

impl Process {
    fn of(member: Member) -> Process {
        let Member { name: full_name, process: id, lives } = member;
        // An actor on another machine has the id of the gateway, which stands in for it.
        let id = id.filter(|_| !is_elsewhere(&full_name));
        let suffix = id.map(|id| format!("-{id}")).unwrap_or_default();
        let name = full_name.strip_suffix(&suffix).unwrap_or(&full_name).to_owned();
        let begun = id.filter(|_| lives).and_then(ProcessStat::of);
        let state = match begun {
            Some(stat) => state(&stat),
            None if lives => State::Hidden,
            None => State::Gone,
        };
        Process { name, full_name, id, state, begun }
    }

    fn row(&self, sample: Duration, heard: Option<&ActorHeard>) -> [String; 8] {
        let unknown = || UNKNOWN.to_owned();
        let state = match self.state {
            State::Running => "running",
            State::Stopped => "stopped",
            State::Gone => "gone",
            State::Hidden => "hidden",
        };
        let worked = self.id.and_then(ProcessStat::of).zip(self.begun);
        let share =
            worked.map(|(now, begun)| now.busy.saturating_sub(begun.busy).div_duration_f64(sample));
        let up = self.begun.and_then(|stat| uptime()?.checked_sub(stat.started));
        [
            self.name.clone(),
            self.id.map_or_else(unknown, |id| id.to_string()),
            state.to_owned(),
            share.map_or_else(unknown, |share| numbers::percent(share, 0)),
            up.map_or_else(unknown, |up| numbers::duration(up.as_secs_f64())),
            heard.map_or_else(unknown, |heard| heard.leases.to_string()),
            heard.map_or_else(unknown, |heard| numbers::count(heard.steps_per_s.round() as u64)),
            heard.map_or_else(unknown, |heard| format!("{} ago", numbers::duration(heard.ago_s))),
        ]
    }
}

fn is_actor(name: &str) -> bool {
    name.starts_with("actor")
}

/// Returns whether a name on the bus stands for a process on another machine.
fn is_elsewhere(name: &str) -> bool {
    name.contains('@')
}

fn state(stat: &ProcessStat) -> State {
    match stat.state {
        'T' | 't' => State::Stopped,
        'Z' | 'X' => State::Gone,
        _ => State::Running,
    }
}

/// Returns how long the machine has been running.
fn uptime() -> Option<Duration> {
    let text = fs::read_to_string("/proc/uptime").ok()?;
    Duration::try_from_secs_f64(text.split_whitespace().next()?.parse().ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_runs_and_is_younger_than_the_machine() {
        let stat = ProcessStat::of(std::process::id()).unwrap();
        assert_eq!(state(&stat), State::Running);
        assert!(uptime().unwrap() >= stat.started);
    }

    fn process(name: &str, state: State) -> Process {
        let name = name.to_owned();
        Process { full_name: name.clone(), name, id: None, state, begun: None }
    }

    fn processes(states: &[(&str, State)]) -> Processes {
        let processes = states.iter().map(|&(name, state)| process(name, state)).collect();
        Processes { looked: Instant::now(), processes }
    }

    #[test]
    fn trouble_is_named() {
        use State::{Gone, Running, Stopped};
        let all = |states: [State; 4]| {
            let names = ["supervisor", "learner", "proximity-service", "actor-0"];
            let states: Vec<_> = names.into_iter().zip(states).collect();
            processes(&states).trouble()
        };
        assert_eq!(all([Running; 4]), None);
        for (states, expected) in [
            ([Running, Stopped, Running, Running], "stalled: learner is stopped"),
            ([Running, Running, Stopped, Running], "stalled: proximity-service is stopped"),
            ([Running, Running, Running, Stopped], "stalled: no actor is running"),
            ([Stopped, Running, Running, Running], "training, but its supervisor is stopped"),
            ([Running, Gone, Running, Running], "starting or ending: learner is not there"),
            ([Gone, Running, Running, Running], "ending: its supervisor is gone"),
        ] {
            assert_eq!(all(states).as_deref(), Some(expected));
        }
        let some = [("actor-0", Running), ("actor-1", Gone), ("actor-0-7@node-7", State::Hidden)];
        assert_eq!(processes(&some).actors_here(), 1);
        assert!(!processes(&[("replay", Running)]).train());
        assert!(processes(&[("actor-3", Running)]).train());
    }

    #[test]
    fn a_process_with_two_names_has_one_row() {
        let member = |name: &str, process| Member { name: name.into(), process, lives: true };
        let first = u32::MAX - 1;
        let found = Processes::of(vec![
            member(&format!("actor-0-{first}"), Some(first)),
            member("learner", Some(first - 1)),
            member("learner-trainer", Some(first - 1)),
            member("status", Some(std::process::id())),
        ]);
        let names: Vec<&str> = found.processes.iter().map(|process| &*process.name).collect();
        assert_eq!(names, ["learner", "actor-0"]);
        let name = format!("actor-0-{first}");
        let heard = ActorHeard { name, leases: 3, ago_s: 31.0, steps_per_s: 4_100.4 };
        let table = found.table(&[heard]);
        let row = table.lines().last().unwrap();
        assert!(row.contains("hidden") && row.contains("3       4,100    31 s ago"), "{table}");
    }
}
