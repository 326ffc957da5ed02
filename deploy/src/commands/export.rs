//! `goalward export`: a run's policy and reward model as files that programs without Goalward read.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};
use run::checkpoint;
use run::config::RunConfig;
use run::folder::{POLICY_FILE, RunFolder};
use serde::Serialize;

use crate::destination;
use crate::figures::Figures;
use crate::programs::{self, Program};
use terminal::numbers;
use terminal::refusal::Refusal;

/// Flags of `goalward export`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    /// Kind of the files: onnx takes raw observations and gives actions; safetensors has weights alone.
    #[arg(long, value_enum, default_value_t = Format::Onnx)]
    format: Format,
    /// Checkpoint to export, by its number of iterations; by default the newest.
    #[arg(long, value_name = "N")]
    checkpoint: Option<u64>,
    /// Folder for the files.
    #[arg(long, value_name = "DIR", default_value = "export")]
    out: PathBuf,
    /// Overwrites existing files of the folder, but nothing of a run.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    figures: Figures,
}

/// A file that was written.
#[derive(Debug, Serialize)]
struct Exported {
    of: &'static str,
    file: PathBuf,
    bytes: u64,
    iterations: u64,
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
    if let Some(iteration) = arguments.checkpoint {
        checkpoint::chosen(&folder, Some(iteration), &[POLICY_FILE]).map_err(Refusal::usage)?;
    }
    destination::folder(&arguments.out, arguments.force)?;
    let exported = destination::filled(&[&arguments.out], || export_all(&config, arguments))?;
    arguments.figures.print(&exported, |exported| table(exported))
}

fn export_all(config: &RunConfig, arguments: &Arguments) -> Result<Vec<Exported>> {
    fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    let file = |name: &str| arguments.out.join(name).with_extension(arguments.format.extension());
    let mut exported = vec![export("policy", &Program::Actor, arguments, file("policy"))?];
    if config.reward.model.is_one_ensemble() {
        let service = Program::ProximityService;
        exported.push(export("reward model", &service, arguments, file("ensemble"))?);
    }
    Ok(exported)
}

/// Has a program write its file.
fn export(
    of: &'static str,
    program: &Program,
    arguments: &Arguments,
    file: PathBuf,
) -> Result<Exported> {
    let mut command: Command = program.command()?;
    command.arg("export").arg("--run").arg(&arguments.run).arg("--out").arg(&file);
    if let Some(iteration) = arguments.checkpoint {
        command.args(["--checkpoint", &iteration.to_string()]);
    }
    let iterations: u64 = programs::result(&mut command, "exporting")?;
    let bytes = fs::metadata(&file).with_context(|| file.display().to_string())?.len();
    Ok(Exported { of, file, bytes, iterations })
}

fn table(exported: &[Exported]) -> String {
    let row = |Exported { of, file, bytes, iterations }: &Exported| {
        let (file, bytes) = (file.display(), numbers::bytes(*bytes));
        (*of, format!("{file}, {bytes}, after {} iterations", numbers::count(*iterations)))
    };
    numbers::table(&exported.iter().map(row).collect::<Vec<_>>())
}
