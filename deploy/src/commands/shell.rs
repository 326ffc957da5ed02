//! `goalward completions` and `goalward manual`: describes the command line to shells and `man`.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Command;
use clap_complete::Shell;
use run::repeat::quoted;
use terminal::print::print_line;

use crate::destination;

/// Flags of `goalward completions`.
#[derive(Debug, clap::Args)]
pub(crate) struct Completions {
    /// The shell; such as `source <(goalward completions bash)`.
    shell: Shell,
}

/// Flags of `goalward manual`.
#[derive(Debug, clap::Args)]
pub(crate) struct Manual {
    /// Folder for the pages, such as ~/.local/share/man/man1.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Prints the completion script for a shell.
pub(crate) fn completions(arguments: &Completions, mut command: Command) {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "goalward", &mut script);
    print_line(String::from_utf8_lossy(&script).trim_end());
}

/// Writes a page for `goalward` and for each of its verbs.
pub(crate) fn manual(arguments: &Manual, command: Command) -> Result<()> {
    let shown = quoted(arguments.out.display());
    destination::outside_runs(&arguments.out)?;
    fs::create_dir_all(&arguments.out).with_context(|| shown.clone())?;
    clap_mangen::generate_to(command, &arguments.out).with_context(|| shown.clone())?;
    print_line(&format!("{shown}: man -l {shown}/goalward.1"));
    Ok(())
}
