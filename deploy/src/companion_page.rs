//! The page that `goalward train` serves during training. It is a process of its own, so that its failures do not
//! affect the training, and it ends with the training.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, PercentEncode, utf8_percent_encode};

use crate::answer::last_words;

/// Longest time that the page may take to print its address.
const PATIENCE: Duration = Duration::from_secs(2);

/// Longest time that the page may take to end. It ends at once unless a browser shows it.
const FAREWELL: Duration = Duration::from_secs(3);

/// Characters that are percent-encoded in an address: all except those that RFC 3986 leaves unreserved.
const ENCODED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'_').remove(b'.').remove(b'~');

/// Time between two checks whether the page has ended.
const TICK: Duration = Duration::from_millis(5);

/// A page of the folder that contains a run.
pub(crate) struct CompanionPage {
    page: Child,
    address: String,
}

impl CompanionPage {
    /// Starts a page for the run at `run`.
    ///
    /// # Errors
    /// When the program cannot be started, or does not print its address in time. Training goes on without a page.
    pub(crate) fn start(run: &Path) -> Result<CompanionPage> {
        let run = run.canonicalize()?;
        let (folder, name) = run.parent().zip(run.file_name()).context("expected a folder")?;
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["page", "--beside-training"]).arg(folder);
        let mut errors = tempfile::tempfile()?;
        // The page has a process group of its own, so that Ctrl-C reaches the training alone.
        command.process_group(0).stdin(Stdio::piped()).stdout(Stdio::piped());
        command.stderr(errors.try_clone()?);
        let mut page = CompanionPage { page: command.spawn()?, address: String::new() };
        let printed = page.printed();
        let address = printed.with_context(|| why_not(&mut errors))?;
        page.address = address_of_run(&address, &name.to_string_lossy());
        Ok(page)
    }

    /// Waits for the address that the page prints; `None` if it ends before that or takes too long.
    fn printed(&mut self) -> Option<String> {
        let mut lines = BufReader::new(self.page.stdout.take()?).lines();
        let (told, first) = mpsc::sync_channel(1);
        let listening = thread::Builder::new().name("page".to_owned());
        listening.spawn(move || told.send(lines.next())).ok()?;
        let line = first.recv_timeout(PATIENCE).ok()??.ok()?;
        line.split_whitespace().next().map(str::to_owned)
    }

    /// Returns the address at which a browser finds the run.
    pub(crate) fn address(&self) -> &str {
        &self.address
    }
}

impl Drop for CompanionPage {
    fn drop(&mut self) {
        drop(self.page.stdin.take());
        // The page may still be waiting for a program that answers a browser.
        let deadline = Instant::now() + FAREWELL;
        while matches!(self.page.try_wait(), Ok(None)) && Instant::now() < deadline {
            thread::sleep(TICK);
        }
        self.page.kill().ok();
        self.page.wait().ok();
    }
}

/// Returns the address of a run on a page. What names the run comes behind the query, which has the token.
fn address_of_run(page: &str, name: &str) -> String {
    format!("{page}#/run/{}", encoded(name))
}

/// Percent-encodes a name for an address.
fn encoded(name: &str) -> PercentEncode<'_> {
    utf8_percent_encode(name, ENCODED)
}

/// Returns why a page has printed no address: the last line of its `errors`, if there is one.
fn why_not(errors: &mut File) -> String {
    let mut said = String::new();
    errors.rewind().and_then(|()| errors.read_to_string(&mut said)).ok();
    let late = || format!("expected its address within {} s, found none", PATIENCE.as_secs());
    last_words(&said).map_or_else(late, str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_encoded_as_a_browser_reads_them() {
        assert_eq!(encoded("navigation-0001_a.b~c").to_string(), "navigation-0001_a.b~c");
        assert_eq!(encoded("50% of a/b,#é").to_string(), "50%25%20of%20a%2Fb%2C%23%C3%A9");
        let address = address_of_run("http://127.0.0.1:7878/?token=abc", "a b");
        assert_eq!(address, "http://127.0.0.1:7878/?token=abc#/run/a%20b");
    }

    #[test]
    fn a_page_that_does_not_start_says_so() {
        // The program of this test has no verb `page` and ends with a refusal that names the flag.
        let directory = tempfile::tempdir().unwrap();
        let refused = CompanionPage::start(directory.path()).err().unwrap().to_string();
        assert!(refused.contains("beside-training"), "{refused}");
    }
}
