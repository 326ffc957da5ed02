//! `goalward page`: the live page of runs.

use std::net::IpAddr;
use std::path::PathBuf;

use anyhow::Result;
use page::{Server, Settings};
use terminal::print::print_line;
use terminal::refusal::wrong_usage;

/// Flags of `goalward page`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folders of runs, or folders that have such.
    #[arg(default_value = "runs", value_name = "RUNS")]
    folders: Vec<PathBuf>,
    /// The address to listen on. Another than this machine's own asks browsers for the token in the
    /// address that is printed.
    #[arg(long, default_value = "127.0.0.1")]
    host: IpAddr,
    /// The port; 0 takes a free one.
    #[arg(long, default_value_t = 7878)]
    port: u16,
}

/// Serves the page until Ctrl-C.
pub(crate) fn run(arguments: Arguments) -> Result<()> {
    let Arguments { folders, host, port } = arguments;
    for folder in &folders {
        folder.read_dir().map_err(|error| {
            wrong_usage(format!("expected a folder of runs, {}: {error}", folder.display()))
        })?;
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let server = Server::listen(Settings { folders, host, port }).await;
        let server = server.map_err(|error| {
            wrong_usage(format!("{error:#}; --port chooses another port, 0 a free one"))
        })?;
        print_line(&format!("{}  (Ctrl-C ends it)", server.address()?));
        tokio::select! {
            ended = server.serve() => ended,
            interrupted = tokio::signal::ctrl_c() => Ok(interrupted?),
        }
    })
}
