//! A run that actors on other machines can join.

use std::ffi::OsString;
use std::fmt;
use std::fs;
use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use protocol::error::within;
use protocol::task::Task;
use protocol::{MAX_ACTORS, durable};
use run::config::RunConfig;
use run::folder::RunFolder;
use run::hosts::NAME_CHARS;
use run::repeat::quoted;
use serde::{Deserialize, Serialize};

use crate::limits;
use crate::programs::{self, Program};
use terminal::refusal::wrong_usage;

/// Default share of other machines' episodes that is acted again.
const AUDITED: f64 = 0.01;

/// How a run lets other machines in.
#[derive(Clone, Copy, Debug, Default, clap::Args, Serialize, Deserialize)]
pub(crate) struct ListenOptions {
    /// Accepts actors of other machines, started there by `goalward join`, at this address, such as 0.0.0.0:7447.
    #[arg(long, value_name = "ADDRESS", value_parser = own_address)]
    listen: Option<SocketAddr>,
    /// Fraction of other machines' episodes that is re-simulated here; a machine whose episodes differ is expelled. By
    /// default 0.01, or 0 for a task that is not deterministic.
    #[arg(long, value_name = "SHARE", requires = "listen")]
    audit: Option<f64>,
}

/// Where a run listens, and what its machines must agree on.
#[derive(Clone, Debug)]
pub(crate) struct Listening {
    listen: SocketAddr,
    golden: String,
    audit: f64,
    actor: PathBuf,
}

/// Parses an address to listen at; its host may be a name.
fn own_address(text: &str) -> Result<SocketAddr, String> {
    let found = resolved(text).map_err(|error| format!(" ({error})"));
    let refused =
        |why: String| format!("expected an address such as 0.0.0.0:7447, found {text}{why}");
    found.and_then(|found| found.ok_or_else(String::new)).map_err(refused)
}

/// Returns the first address of a host, of version 4 if there is one; `None` if it has none.
///
/// # Errors
/// When the name is not known, or is not one.
pub(crate) fn resolved(host: impl ToSocketAddrs) -> std::io::Result<Option<SocketAddr>> {
    let found: Vec<SocketAddr> = host.to_socket_addrs()?.collect();
    Ok(found.iter().find(|address| address.is_ipv4()).or(found.first()).copied())
}

/// Formats the options as they are typed after a command.
impl fmt::Display for ListenOptions {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ListenOptions { listen, audit } = self;
        listen.map_or(Ok(()), |address| write!(formatter, " --listen {address}"))?;
        audit.map_or(Ok(()), |share| write!(formatter, " --audit {share}"))
    }
}

impl ListenOptions {
    /// Checks that other machines can join the run as requested or, without `--listen`, that the run has an actor.
    ///
    /// # Errors
    /// When the gateway's program is missing, the address cannot be told to other machines or listened on, the share to
    /// audit is not in 0 to 1, or the task's episodes cannot be acted again. Without `--listen`, as
    /// [`require_an_actor`].
    pub(crate) fn check(self, config: &RunConfig) -> Result<()> {
        let RunConfig { task, resources, .. } = config;
        let Some(listen) = self.listen else { return require_an_actor(resources.actors, false) };
        let words =
            "--listen: expected a port above 0, which other machines can connect to, found 0";
        ensure!(listen.port() != 0, wrong_usage(words));
        // All actors may be on other machines.
        limits::check(MAX_ACTORS as u64)?;
        Program::Gateway.check()?;
        let (share, name) = (self.audit(task), &task.name);
        let expected = |what: &str| wrong_usage(format!("--audit: expected {what}"));
        let is_share = (0.0..=1.0).contains(&share);
        ensure!(is_share, expected(&format!("a share in 0 to 1, found {share}")));
        let can_audit = task.deterministic || share == 0.0;
        ensure!(can_audit, expected(&format!("a deterministic task, found {name}")));
        let free = TcpListener::bind(listen);
        free.map(drop).map_err(|error| wrong_usage(format!("listening at {listen}: {error}")))
    }

    /// Saves the options in the run's folder, for [`how_to_resume`].
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn keep(self, folder: &RunFolder) -> Result<()> {
        let file = folder.listening_file();
        if self.listen.is_none() {
            fs::remove_file(file).ok();
            return Ok(());
        }
        let written = durable::write_unsynced(&file, serde_json::to_vec(&self)?);
        written.with_context(|| file.display().to_string())
    }

    /// Returns the options that a run was last trained with.
    fn of_run(folder: &RunFolder) -> ListenOptions {
        let bytes = fs::read(folder.listening_file()).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }

    fn audit(self, task: &Task) -> f64 {
        self.audit.unwrap_or(if task.deterministic { AUDITED } else { 0.0 })
    }

    /// Prepares a laid-out run for other machines; `None` if none may join.
    ///
    /// # Errors
    /// As [`golden`].
    pub(crate) fn prepare(self, folder: &RunFolder, task: &Task) -> Result<Option<Listening>> {
        let Some(listen) = self.listen else { return Ok(None) };
        let golden = golden(folder, task).context("the golden episodes of the run")?;
        let actor = Program::acting_in(task).path()?;
        Ok(Some(Listening { listen, golden, audit: self.audit(task), actor }))
    }
}

/// Returns the command that continues a run with the options it was last trained with.
pub(crate) fn how_to_resume(folder: &RunFolder) -> String {
    let (goalward, run) = (programs::own_command(), quoted(folder.path().display()));
    format!("{goalward} train --resume --run {run}{}", ListenOptions::of_run(folder))
}

/// Checks that a run has an actor of its own, which it needs unless other machines can join it.
///
/// # Errors
/// When the run has no actor.
pub(crate) fn require_an_actor(actors: u64, can_be_joined: bool) -> Result<()> {
    let expected = "at least 1, unless other machines can join the run (--listen)";
    Ok(within("resources.actors", actors > 0 || can_be_joined, expected, actors)?)
}

/// Returns the hash of a run's golden episodes, as this machine's actor acts them.
///
/// # Errors
/// When this machine cannot act in the task.
pub(crate) fn golden(folder: &RunFolder, task: &Task) -> Result<String> {
    let mut actor = Program::acting_in(task).command()?;
    actor.arg("golden").arg("--run").arg(folder.path());
    programs::result_unless_stopped(&mut actor, "acting golden episodes")
}

/// Returns this machine's name among the hosts of a run: the host name without its domain, with the characters and up
/// to the length that a hub accepts.
pub(crate) fn host_name() -> String {
    host_name_of(&node_name())
}

fn host_name_of(node: &str) -> String {
    let fits = |letter: &char| letter.is_ascii_alphanumeric() || "-_".contains(*letter);
    let label = node.split('.').next().unwrap_or_default();
    let name: String = label.chars().filter(fits).take(NAME_CHARS).collect();
    if name.is_empty() { "localhost".to_owned() } else { name }
}

/// Returns the name by which other machines find this one.
pub(crate) fn node_name() -> String {
    let system = rustix::system::uname();
    system.nodename().to_str().unwrap_or("localhost").to_owned()
}

impl Listening {
    /// Returns the arguments of the gateway.
    pub(crate) fn arguments(&self, folder: &RunFolder) -> Vec<OsString> {
        let listen = self.listen.to_string();
        let (address, golden, audit) =
            (self.address(), self.golden.clone(), self.audit.to_string());
        let mut arguments = vec!["serve".into(), "--run".into(), folder.path().into()];
        let flags = [
            ("--listen", listen),
            ("--address", address),
            ("--golden", golden),
            ("--audit", audit),
        ];
        for (flag, value) in flags {
            arguments.extend([flag.into(), value.into()]);
        }
        arguments.extend(["--actor".into(), self.actor.clone().into()]);
        arguments
    }

    /// Returns a line that says what to type on another machine.
    pub(crate) fn how_to_join(&self, folder: &RunFolder) -> String {
        let (address, key) = (self.address(), quoted(folder.join_file().display()));
        format!("other machines: goalward join {address} --key {key}")
    }

    /// Returns the address at which other machines find the run.
    fn address(&self) -> String {
        match self.listen.ip() {
            ip if ip.is_unspecified() => format!("{}:{}", node_name(), self.listen.port()),
            _ => self.listen.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_continued_as_it_listened() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        fs::create_dir(folder.output()).unwrap();
        let alone = format!(" train --resume --run {}", directory.path().display());
        assert!(how_to_resume(&folder).ends_with(&alone), "{}", how_to_resume(&folder));
        let listen = Some("0.0.0.0:7447".parse().unwrap());
        ListenOptions { listen, audit: Some(0.5) }.keep(&folder).unwrap();
        let listening = format!("{alone} --listen 0.0.0.0:7447 --audit 0.5");
        assert!(how_to_resume(&folder).ends_with(&listening), "{}", how_to_resume(&folder));
        fs::write(folder.listening_file(), "{").unwrap();
        assert!(how_to_resume(&folder).ends_with(&alone), "what says nothing is passed over");
        ListenOptions::default().keep(&folder).unwrap();
        assert!(!folder.listening_file().exists());
    }

    #[test]
    fn a_run_listens_at_a_name() {
        let address = own_address("127.0.0.1:7447").unwrap();
        assert_eq!(own_address("localhost:7447").map(|found| found.port()), Ok(7447));
        assert_eq!(resolved(("127.0.0.1", 7447)).unwrap(), Some(address));
        for wrong in ["7447", "127.0.0.1", "127.0.0.1:70000"] {
            let said = own_address(wrong).unwrap_err();
            let expected = format!("expected an address such as 0.0.0.0:7447, found {wrong}");
            assert!(said.starts_with(&expected), "{said}");
        }
    }

    #[test]
    fn a_hub_takes_every_machine_by_its_name() {
        for (node, name) in [
            ("node-7", "node-7"),
            ("ip-10-0-0-7.eu-central-1.compute.internal", "ip-10-0-0-7"),
            ("Ünser Rechner_2", "nserRechner_2"),
            ("", "localhost"),
        ] {
            assert_eq!(host_name_of(node), name);
        }
        assert_eq!(host_name_of(&"x".repeat(64)), "x".repeat(40));
    }
}
