//! The other machines that take part in a run, as its gateway keeps them in a file of the run's folder, for
//! whoever looks. What is lost of it is missed by nobody, so nothing waits for the disk.

use std::fs;
use std::io;

use protocol::{build, durable};
use serde::{Deserialize, Serialize};

use crate::folder::RunFolder;

/// Longest name of a machine, characters.
pub const NAME_CHARS: usize = 40;

/// The machines of a run beside the one that learns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hosts {
    /// Those that take part.
    pub present: Vec<Host>,
    /// Those that broke the rules since the gateway was started.
    pub expelled: Vec<Expelled>,
}

/// A machine that takes part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Host {
    /// What the run calls it.
    pub name: String,
    /// What its programs are built from.
    pub build: String,
    /// Its living actors.
    pub actors: u64,
    /// The fastest of its last questions and answers, there and back, milliseconds; none before there was one.
    pub distance_ms: Option<f64>,
}

/// A machine that broke the rules.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Expelled {
    /// What the run called it.
    pub name: String,
    /// How.
    pub why: String,
}

impl Hosts {
    /// Those of a run; nobody where nobody says so.
    pub fn of_run(folder: &RunFolder) -> Hosts {
        let bytes = fs::read(folder.hosts_file()).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }

    /// Replaces those of a run.
    ///
    /// # Errors
    /// When the file cannot be written; there is the earlier one then.
    pub fn write(&self, folder: &RunFolder) -> io::Result<()> {
        durable::write_unsynced(&folder.hosts_file(), serde_json::to_vec(self)?)
    }

    /// Forgets those of a run.
    pub fn clear(folder: &RunFolder) {
        fs::remove_file(folder.hosts_file()).ok();
    }
}

impl Host {
    /// What there is to say of it, in a line; its build if that is not the one that speaks.
    pub fn line(&self) -> String {
        let distance = self.distance_ms.map(|ms| format!(", {ms:.1} ms away")).unwrap_or_default();
        format!("{}, actors: {}{distance}{}", self.name, self.actors, self.other_build())
    }

    /// Its build, as the end of a line, if that is not the one that speaks.
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
        let expelled = Expelled { name: "x".to_owned(), why: "it acts otherwise".to_owned() };
        let hosts = Hosts { present: vec![node], expelled: vec![expelled] };
        hosts.write(&folder).unwrap();
        assert_eq!(Hosts::of_run(&folder), hosts);
        fs::write(folder.hosts_file(), "{").unwrap();
        assert_eq!(Hosts::of_run(&folder), Hosts::default(), "what is no list is passed over");
        Hosts::clear(&folder);
        assert_eq!(fs::read_dir(folder.output()).unwrap().count(), 0);
    }
}
