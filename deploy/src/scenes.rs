//! Recorded episodes acted again by the program of their task, and written with what a viewer draws.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use prost::Message;
use protocol::trajectory::Trajectory;
use run::folder::RunFolder;

use crate::programs::Program;

/// The command that writes episodes of a run to a new file, and what it reads. `setting` is that of their
/// environment, as JSON, where it is not the run's; an environment of Python renders `pictures`, if it can.
///
/// # Errors
/// When the run has no configuration, or the program is not there.
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
