//! The page that `goalward train` serves during training. It is a process of its own, so that its failures do not
//! affect the training, and it ends with the training.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, PercentEncode, utf8_percent_encode};

/// Longest time that the page may take to print its address.
const PATIENCE: Duration = Duration::from_secs(2);

/// Longest time that the page may take to end.
const FAREWELL: Duration = Duration::from_secs(1);

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
    /// Starts a page for the run at `run`. Returns `None` if that fails; training goes on without a page.
    pub(crate) fn start(run: &Path) -> Option<CompanionPage> {
        let run = run.canonicalize().ok()?;
        let mut command = Command::new(std::env::current_exe().ok()?);
        command.args(["page", "--beside-training"]).arg(run.parent()?);
        // The page has a process group of its own, so that Ctrl-C reaches the training alone.
        command.process_group(0).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut page = command.spawn().ok()?;
        let mut lines = BufReader::new(page.stdout.take()?).lines();
        let (told, first) = mpsc::sync_channel(1);
        let listening = thread::Builder::new().name("page".to_owned());
        listening.spawn(move || told.send(lines.next())).ok()?;
        let Ok(Some(Ok(line))) = first.recv_timeout(PATIENCE) else {
            page.kill().ok();
            page.wait().ok();
            return None;
        };
        let address = line.split_whitespace().next()?;
        let name = run.file_name()?.to_string_lossy();
        Some(CompanionPage { page, address: format!("{address}/#/run/{}", encoded(&name)) })
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

/// Percent-encodes a name for an address.
fn encoded(name: &str) -> PercentEncode<'_> {
    utf8_percent_encode(name, ENCODED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_encoded_as_a_browser_reads_them() {
        assert_eq!(encoded("navigation-0001_a.b~c").to_string(), "navigation-0001_a.b~c");
        assert_eq!(encoded("50% of a/b,#é").to_string(), "50%25%20of%20a%2Fb%2C%23%C3%A9");
    }
}
