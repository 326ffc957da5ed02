//! `goalward page`: the live page of runs.

use std::io::ErrorKind;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use anyhow::Result;
use bus::BusAddress;
use page::{PagePrograms, Processes, Score, Server, Settings};
use prost::Message;
use protocol::trajectory::Trajectory;
use report::programs::Estimates;
use run::folder::RunFolder;
use run::hosts::{Host, Hosts};
use run::process::at_end_of_input;
use serde::de::IgnoredAny;
use terminal::print::print_line;
use terminal::refusal::wrong_usage;

use crate::commands::status;
use crate::listening::{node_name, resolved};
use crate::other_reward::OtherReward;
use crate::programs::Program;
use crate::supervisor::{Signals, runtime};
use crate::{answer, named_runs, processes, progress_file, scenes};

/// Niceness of the page and of what it starts, which yield to training; 19 is most.
const NICENESS: i32 = 10;

/// Flags of `goalward page`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folders of runs, or folders that contain them, such as that of an experiment.
    #[arg(default_value = "runs", value_name = "RUNS")]
    folders: Vec<PathBuf>,
    /// The address to listen on, or its name. Browsers need the token in the printed address.
    #[arg(long, default_value = "127.0.0.1", value_parser = own_address)]
    host: IpAddr,
    /// The port; 0 takes a free one.
    #[arg(long, default_value_t = 7878)]
    port: u16,
    /// Ends with its standard input, and takes a free port where the port is taken; for `goalward train`.
    #[arg(long, hide = true)]
    beside_training: bool,
}

/// Parses an address of this machine, or the name of one.
fn own_address(text: &str) -> Result<IpAddr, String> {
    let found = text.parse::<IpAddr>().or_else(|_| match resolved((text, 0)) {
        Ok(found) => found.map(|found| found.ip()).ok_or_else(String::new),
        Err(error) => Err(format!(" ({error})")),
    });
    found.map_err(|why| format!("expected an address such as 0.0.0.0, found {text}{why}"))
}

/// Serves the page until Ctrl-C.
pub(crate) fn run(arguments: Arguments) -> Result<()> {
    let Arguments { folders, host, port, beside_training } = arguments;
    named_runs::at(&folders)?;
    // If the system refuses, the page runs with normal priority.
    rustix::process::nice(NICENESS).ok();
    let runtime = runtime()?;
    let ended = runtime.block_on(async {
        let listen = |port| {
            let folders = folders.clone();
            let (name, programs) = (node_name(), Box::new(OfRuns));
            Server::listen(Settings { folders, host, port, name, programs })
        };
        let mut server = listen(port).await;
        if beside_training && server.is_err() {
            server = listen(0).await;
        }
        let server = server.map_err(|error| {
            let kind = error.root_cause().downcast_ref().map(std::io::Error::kind);
            match kind {
                Some(ErrorKind::AddrInUse | ErrorKind::PermissionDenied) => {
                    wrong_usage(format!("{error:#}; --port chooses another port, 0 a free one"))
                }
                Some(ErrorKind::AddrNotAvailable) => wrong_usage(format!("{error:#}")),
                _ => error,
            }
        })?;
        print_line(&format!("{}  (Ctrl-C ends it)", server.address()?));
        let mut signals = Signals::listen()?;
        let end = async {
            match beside_training {
                true => end_of_input().await,
                false => std::future::pending().await,
            }
        };
        tokio::select! {
            ended = server.serve(end) => ended,
            () = signals.stop.next() => Ok(()),
        }
    });
    // Nobody waits for what programs of runs still answer.
    runtime.shutdown_background();
    ended
}

/// Waits until the standard input ends, because the process that held it is gone.
async fn end_of_input() {
    let (ended, wait) = tokio::sync::oneshot::channel::<()>();
    if at_end_of_input(move || drop(ended)).is_ok() {
        wait.await.ok();
    }
}

/// Asks the programs of the runs themselves.
struct OfRuns;

impl PagePrograms for OfRuns {
    fn draw(
        &self,
        folder: &RunFolder,
        setting: Option<&str>,
        episode: &Trajectory,
        pictures: bool,
        out: &Path,
    ) -> Result<()> {
        let episode = std::slice::from_ref(episode);
        let (actor, input) = scenes::command(folder, setting, episode, pictures, out)?;
        answer::of(actor, &input).map(|IgnoredAny| ())
    }

    fn estimate(
        &self,
        folder: &RunFolder,
        checkpoint: Option<u64>,
        observations: &[u8],
    ) -> Result<Estimates> {
        let mut service = Program::ProximityService.command()?;
        service.arg("estimate").arg("--run").arg(folder.path());
        service.args(checkpoint.map(|iteration| format!("--checkpoint={iteration}")));
        answer::of(service, observations)
    }

    fn score(&self, folder: &RunFolder, changes: &[String], episode: &Trajectory) -> Result<Score> {
        let OtherReward { config, model } = OtherReward::of(folder, changes)?;
        let place = tempfile::tempdir()?;
        let configuration = place.path().join("config.toml");
        std::fs::write(&configuration, config.to_text())?;
        let mut service = Program::ProximityService.command()?;
        service.arg("score").arg("--run").arg(folder.path()).arg("--config").arg(configuration);
        if let Some(model) = &model {
            service.arg("--model").arg(model.path());
        }
        answer::of(service, &episode.encode_to_vec())
    }

    fn processes(&self, folder: &RunFolder) -> Result<Option<Processes>> {
        let Some(address) = BusAddress::if_started(folder.path())? else { return Ok(None) };
        let found = processes::Processes::on(&address)?;
        let newest = progress_file::read(folder);
        let age = progress_file::age(folder);
        let mut heard = newest.as_ref().map_or(Vec::new(), |newest| newest.actors_heard.clone());
        heard.iter_mut().for_each(|actor| actor.ago_s += age.as_secs_f64());
        let silence = || {
            let said = terminal::numbers::duration(age.as_secs_f64());
            format!("nothing heard for {said}: its learner is silent, or the disk is full")
        };
        let trouble = match &newest {
            Some(newest) if age < status::PATIENCE => status::trouble(&found, Some(newest)),
            Some(_) => found.trouble().or_else(|| Some(silence())),
            None => found.trouble(),
        };
        Ok(found.train().then(|| Processes {
            trouble,
            head: processes::HEAD,
            rows: found.rows(&heard),
            hosts: Hosts::of_run(folder).present.iter().map(Host::line).collect(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_served_at_an_address_or_its_name() {
        for own in ["127.0.0.1", "localhost"] {
            assert!(own_address(own).unwrap().is_loopback());
        }
        assert_eq!(own_address("::1").map(|found| found.is_ipv6()), Ok(true));
        // No system looks up such a name.
        let said = own_address("no\0name").unwrap_err();
        assert!(said.starts_with("expected an address such as 0.0.0.0, found no"), "{said}");
    }
}
