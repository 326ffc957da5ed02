//! `goalward export`: a run's policy and reward model as files that programs without Goalward read.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use run::folder::RunFolder;

use crate::destination;
use crate::programs::{self, Program};
use terminal::numbers;
use terminal::print::print_line;

/// Flags of `goalward export`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    /// Kind of the files: onnx takes raw observations and gives actions; safetensors has weights alone.
    #[arg(long, value_enum, default_value_t = Format::Onnx)]
    format: Format,
    /// Iterations that the checkpoint is after; by default the newest one.
    #[arg(long, value_name = "N")]
    checkpoint: Option<u64>,
    /// Folder for the files.
    #[arg(long, value_name = "DIR", default_value = "export")]
    out: PathBuf,
    /// Replaces files of the folder; never anything of a run.
    #[arg(long)]
    force: bool,
}

/// Kind of the exported files.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Format {
    Onnx,
    Safetensors,
}

impl Format {
    fn extension(self) -> &'static str {
        match self {
            Format::Onnx => "onnx",
            Format::Safetensors => "safetensors",
        }
    }
}

/// Exports the policy, and the reward model where it is a trained ensemble.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let folder = RunFolder::new(&arguments.run);
    let config = folder.config()?;
    destination::folder(&arguments.out, arguments.force)?;
    fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    let file = |name: &str| arguments.out.join(name).with_extension(arguments.format.extension());
    let mut rows = vec![("policy", export(&Program::Actor, arguments, &file("policy"))?)];
    if config.reward.model.is_one_ensemble() {
        let ensemble = file("ensemble");
        rows.push(("reward model", export(&Program::ProximityService, arguments, &ensemble)?));
    }
    print_line(numbers::table(&rows).trim_end());
    Ok(())
}

/// Lets a program write its file; what is to be said of it.
fn export(program: &Program, arguments: &Arguments, out: &Path) -> Result<String> {
    let mut command: Command = program.command()?;
    command.arg("export").arg("--run").arg(&arguments.run).arg("--out").arg(out);
    if let Some(iteration) = arguments.checkpoint {
        command.args(["--checkpoint", &iteration.to_string()]);
    }
    let iteration: u64 = programs::result(&mut command, "exporting")?;
    let bytes = fs::metadata(out).with_context(|| out.display().to_string())?.len();
    let (file, iteration) = (out.display(), numbers::count(iteration));
    Ok(format!("{file}, {}, after {iteration} iterations", numbers::bytes(bytes)))
}
