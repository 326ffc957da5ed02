//! Runs a program for one answer on a browser's behalf; a failure is returned with the program's last words.

use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use serde::de::DeserializeOwned;
use tokio::io::AsyncWriteExt;
use tokio::time::timeout;

use crate::supervisor::runtime;

/// Longest time that a program may take to answer.
const PATIENCE: Duration = Duration::from_secs(30);

/// Runs a program with `input` as its standard input and returns the JSON that it prints. The calling thread waits in a
/// runtime of its own, because the page's may end before the answer.
///
/// # Errors
/// When the program cannot start, takes too long, fails (with its last words) or prints something else.
pub(crate) fn of<T: DeserializeOwned>(program: Command, input: &[u8]) -> Result<T> {
    let patience = PATIENCE.as_secs();
    let answer = runtime()?.block_on(async { timeout(PATIENCE, printed(program, input)).await });
    let printed = answer.with_context(|| format!("no answer within {patience} s"))??;
    serde_json::from_slice(&printed).context("reading a program's answer")
}

async fn printed(program: Command, input: &[u8]) -> Result<Vec<u8>> {
    let mut program = tokio::process::Command::from(program);
    program.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
    let mut child = program.spawn().context("starting a program")?;
    let mut stdin = child.stdin.take().context("a program has an input")?;
    let writing = async move {
        // A write error is ignored: a program that fails before it has read everything says why itself.
        stdin.write_all(input).await.ok();
    };
    let ((), output) = tokio::join!(writing, child.wait_with_output());
    let output = output.context("waiting for a program")?;
    let said = String::from_utf8_lossy(&output.stderr);
    let why = last_words(&said).unwrap_or("a program failed without a word");
    ensure!(output.status.success(), "{why}");
    Ok(output.stdout)
}

/// Returns the last line that a failed program printed to standard error, without the prefix `goalward: `.
pub(crate) fn last_words(said: &str) -> Option<&str> {
    said.lines().last().map(|line| line.trim_start_matches("goalward: "))
}
