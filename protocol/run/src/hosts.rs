//! The other machines that take part in a run. The run's gateway keeps them in a file of the run's
//! folder, for anyone to read. Losing the file does no harm, so writes do not wait for the disk.

use std::fs;
use std::io;

use protocol::{build, durable};
use serde::{Deserialize, Serialize};

use crate::folder::RunFolder;

/// Longest name of a machine, characters.
pub const NAME_CHARS: usize = 40;

/// The machines of a run other than the one that learns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hosts {
    /// Machines that take part.
    pub present: Vec<Host>,
    /// Machines that broke the rules since the run was started.
    pub expelled: Vec<Expelled>,
    /// Why an episode of theirs could not be audited, the first time; such episodes are not published.
    #[serde(default)]
    pub unaudited: Option<String>,
}

/// A machine that takes part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Host {
    /// Its name in the run.
    pub name: String,
    /// Build of its programs.
    pub build: String,
    /// Number of its living actors.
    pub actors: u64,
    /// Shortest of its latest round-trip times, milliseconds; `None` before the first.
    pub distance_ms: Option<f64>,
}

/// A machine that broke the rules.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Expelled {
    /// Its name in the run.
    pub name: String,
    /// How it broke the rules.
    pub why: String,
}

impl Hosts {
    /// Reads the machines of a run; there are none if the file cannot be read.
    pub fn of_run(folder: &RunFolder) -> Hosts {
        let bytes = fs::read(folder.hosts_file()).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }

    /// Replaces the machines of a run.
    ///
    /// # Errors
    /// If the file cannot be written; the earlier one is then kept.
    pub fn write(&self, folder: &RunFolder) -> io::Result<()> {
        durable::write_unsynced(&folder.hosts_file(), serde_json::to_vec(self)?)
    }

    /// Removes the file with the machines of a run.
    pub fn clear(folder: &RunFolder) {
        fs::remove_file(folder.hosts_file()).ok();
    }
}

impl Host {
    /// Describes the machine in a line, with its build if that differs from this program's.
    pub fn line(&self) -> String {
        let distance = self.distance_ms.map(|ms| format!(", {ms:.1} ms away")).unwrap_or_default();
        format!("{}, actors: {}{distance}{}", self.name, self.actors, self.other_build())
    }

    /// Returns its build, as the end of a line, if that differs from this program's.
    pub fn other_build(&self) -> String {
        match self.build == build::version() {
            true => String::new(),
            false => format!(", build {}", self.build),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_hosts_are_read() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        fs::create_dir(folder.output()).unwrap();
        assert_eq!(Hosts::of_run(&folder), Hosts::default());
        let node = Host {
            name: "node-7".to_owned(),
            build: "0.0.9".to_owned(),
            actors: 8,
            distance_ms: Some(0.42),
        };
        assert_eq!(node.line(), "node-7, actors: 8, 0.4 ms away, build 0.0.9");
        let same = Host { build: build::version().to_owned(), ..node.clone() };
        assert_eq!(same.line(), "node-7, actors: 8, 0.4 ms away");
        let expelled = Expelled { name: "x".to_owned(), why: "its episode differs".to_owned() };
        let unaudited = Some("the auditor has ended".to_owned());
        let hosts = Hosts { present: vec![node], expelled: vec![expelled], unaudited };
        hosts.write(&folder).unwrap();
        assert_eq!(Hosts::of_run(&folder), hosts);
        fs::write(folder.hosts_file(), "{").unwrap();
        assert_eq!(Hosts::of_run(&folder), Hosts::default(), "what is no list is passed over");
        Hosts::clear(&folder);
        assert_eq!(fs::read_dir(folder.output()).unwrap().count(), 0);
    }
}
