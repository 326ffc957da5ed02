//! Has the program of a task act recorded episodes again and write them as scenes for viewers.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use prost::Message;
use protocol::trajectory::Trajectory;
use run::folder::RunFolder;

use crate::programs::Program;

/// Returns the command that writes `episodes` of a run to the new file `out`, and the command's input. `setting` is the
/// setting of their environment as JSON, if it is not the run's. With `pictures`, a Python environment renders
/// pictures, if it can.
///
/// # Errors
/// When the run has no configuration, or the program is missing.
pub(crate) fn command(
    folder: &RunFolder,
    setting: Option<&str>,
    episodes: &[Trajectory],
    pictures: bool,
    out: &Path,
) -> Result<(Command, Vec<u8>)> {
    let mut actor = Program::acting_in(&folder.config()?.task).command()?;
    actor.arg("scenes").arg("--run").arg(folder.path()).arg("--out").arg(out);
    actor.args(setting.into_iter().flat_map(|setting| ["--setting", setting]));
    actor.args(pictures.then_some("--pictures"));
    let encoded = episodes.iter().flat_map(Message::encode_length_delimited_to_vec);
    Ok((actor, encoded.collect()))
}
