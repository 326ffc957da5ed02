//! A run that lets actors of other machines in.

use std::ffi::OsString;
use std::net::{SocketAddr, TcpListener};

use anyhow::{Context, Result};
use protocol::task::Task;
use run::folder::RunFolder;

use crate::programs::{self, Program};
use terminal::refusal::wrong_usage;

/// Where a run listens, and what its machines must agree on.
#[derive(Clone, Debug)]
pub(crate) struct Listening {
    listen: SocketAddr,
    golden: String,
}

/// Checks that a run can listen there.
///
/// # Errors
/// Without the gateway's program, or when the system does not let it listen.
pub(crate) fn check(listen: SocketAddr) -> Result<()> {
    Program::Gateway.check()?;
    let free = TcpListener::bind(listen);
    free.map(drop).map_err(|error| wrong_usage(format!("listening at {listen}: {error}")))
}

/// What this machine's actor makes of a run's golden episodes.
///
/// # Errors
/// When the task cannot be acted here.
pub(crate) fn golden(folder: &RunFolder, task: &Task) -> Result<String> {
    let mut actor = Program::acting_in(task).command()?;
    programs::result(actor.arg("golden").arg("--run").arg(folder.path()), "acting golden episodes")
}

/// What this machine is called.
pub(crate) fn host_name() -> String {
    let system = rustix::system::uname();
    system.nodename().to_str().unwrap_or("localhost").to_owned()
}

impl Listening {
    /// Prepares a run that is laid out.
    ///
    /// # Errors
    /// As [`golden`].
    pub(crate) fn prepare(
        folder: &RunFolder,
        task: &Task,
        listen: SocketAddr,
    ) -> Result<Listening> {
        let golden = golden(folder, task).context("the golden episodes of the run")?;
        Ok(Listening { listen, golden })
    }

    /// What the gateway is to do.
    pub(crate) fn arguments(&self, folder: &RunFolder) -> Vec<OsString> {
        let listen = self.listen.to_string();
        let (address, golden) = (self.address(), self.golden.clone());
        let mut arguments = vec!["serve".into(), "--run".into(), folder.path().into()];
        for (flag, value) in [("--listen", listen), ("--address", address), ("--golden", golden)] {
            arguments.extend([flag.into(), value.into()]);
        }
        arguments
    }

    /// What to type on another machine.
    pub(crate) fn how_to_join(&self, folder: &RunFolder) -> String {
        let (address, run) = (self.address(), folder.path().display());
        format!("other machines: goalward join {address} --key {run}/join.toml")
    }

    /// Where other machines find it.
    fn address(&self) -> String {
        match self.listen.ip() {
            ip if ip.is_unspecified() => format!("{}:{}", host_name(), self.listen.port()),
            _ => self.listen.to_string(),
        }
    }
}
