//! [`rewrite`]: copies the log of a run, with other trajectories.

use std::fs;
use std::path::Path;

use bytes::Bytes;
use protocol::Error;

use super::file::FileWriter;
use super::run::read_run;
use super::topic::Contents;
use super::{folder, write_error};

/// Writes the records of a run's log into the folder `out`, in their order and with their log times. `change` replaces
/// trajectories and returns as many as it was given; it gets those of `at_once` messages at a time. Files that are cut
/// off or damaged are copied as far as they can be read.
///
/// # Errors
/// Those of `change`, [`Error::LogRead`] and [`Error::LogWrite`]; also when `out` already has a log.
pub fn rewrite<E: From<Error>>(
    log: &Path,
    out: &Path,
    at_once: usize,
    mut change: impl FnMut(Vec<Bytes>) -> Result<Vec<Bytes>, E>,
) -> Result<(), E> {
    let mut reader = read_run(log)?;
    fs::create_dir_all(out).map_err(|cause| write_error(out, "make the folder", &cause))?;
    let create = |contents: Contents| {
        let path = folder::path(out, contents, 0);
        FileWriter::create(&path, reader.metadata(), contents.topics())
    };
    let mut trajectories = create(Contents::Trajectories)?;
    let mut updates = create(Contents::Updates)?;
    loop {
        let mut messages = Vec::new();
        while messages.len() < at_once
            && let Some((_, message)) = reader.next_message()?
        {
            messages.push(message);
        }
        if messages.is_empty() {
            break;
        }
        let old = messages.iter().filter(|message| message.topic.is_of_trajectories());
        let mut changed = change(old.map(|message| message.bytes.clone()).collect())?.into_iter();
        for message in messages {
            let bytes = match message.topic.is_of_trajectories() {
                true => changed.next().expect("as many as were given"),
                false => message.bytes,
            };
            let is_update = Contents::Updates.topics().contains(&message.topic);
            let file = if is_update { &mut updates } else { &mut trajectories };
            file.message(message.topic, message.log_time_ns, &bytes)?;
        }
    }
    trajectories.seal()?;
    Ok(updates.seal()?)
}
