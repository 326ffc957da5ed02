//! `goalward export`: a run's policy and reward model as files that programs without Goalward read.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use protocol::durable::{self, TemporaryFolder};
use run::folder::{POLICY_FILE, PROXIMITY_FILE, RunFolder};
use serde::Serialize;

use crate::output_format::OutputFormat;
use crate::programs::{self, Program};
use crate::{chosen_checkpoint, destination};
use terminal::numbers;

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
    output: OutputFormat,
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
    let has_ensemble = folder.config()?.reward.model.is_one_ensemble();
    destination::folder(&arguments.out, arguments.force)?;
    let parts = if has_ensemble { &PARTS[..] } else { &PARTS[..1] };
    let files: Vec<&str> = parts.iter().map(|part| part.weights).collect();
    let iteration = chosen_checkpoint::iterations(&folder, arguments.checkpoint, &files)?;
    let out = arguments.out.display().to_string();
    let exported = export_all(parts, iteration, arguments).with_context(|| out)?;
    arguments.output.print(&exported, |exported| table(exported))
}

/// A file of an export.
struct Part {
    of: &'static str,
    name: &'static str,
    /// File of a checkpoint with its weights.
    weights: &'static str,
    program: Program,
}

const PARTS: [Part; 2] = [
    Part { of: "policy", name: "policy", weights: POLICY_FILE, program: Program::Actor },
    Part {
        of: "reward model",
        name: "ensemble",
        weights: PROXIMITY_FILE,
        program: Program::ProximityService,
    },
];

/// Exports `parts`, all or none, in place of what an earlier export wrote.
fn export_all(parts: &[Part], iteration: u64, arguments: &Arguments) -> Result<Vec<Exported>> {
    let Arguments { run, out, format, .. } = arguments;
    durable::create_folder(durable::folder_of(out))?;
    let made = TemporaryFolder::beside(out)?;
    let file =
        |folder: &Path, part: &Part| folder.join(part.name).with_extension(format.extension());
    for part in parts {
        let mut command: Command = part.program.command()?;
        command.arg("export").arg("--run").arg(run).arg("--out").arg(file(made.path(), part));
        command.args(["--checkpoint", &iteration.to_string()]);
        programs::result_unless_stopped::<u64>(&mut command, "exporting")?;
    }
    durable::create_folder(out)?;
    let place = |part: &Part| -> Result<Exported> {
        let (made, file) = (file(made.path(), part), file(out, part));
        durable::rename(&made, &file)?;
        let bytes = fs::metadata(&file)?.len();
        Ok(Exported { of: part.of, file, bytes, iterations: iteration })
    };
    let exported = parts.iter().map(place).collect::<Result<_>>()?;
    let stale = PARTS[parts.len()..].iter().map(|part| file(out, part));
    stale.filter(|file| file.exists()).try_for_each(fs::remove_file)?;
    Ok(exported)
}

fn table(exported: &[Exported]) -> String {
    let row = |Exported { of, file, bytes, iterations }: &Exported| {
        let (file, bytes) = (file.display(), numbers::bytes(*bytes));
        (*of, format!("{file}, {bytes}, after {} iterations", numbers::count(*iterations)))
    };
    numbers::table(&exported.iter().map(row).collect::<Vec<_>>())
}
