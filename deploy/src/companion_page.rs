//! The page that `goalward train` serves meanwhile: a process of its own, so that nothing that becomes of it
//! touches the training, and which ends with it.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, PercentEncode, utf8_percent_encode};

/// How long it may take to say where it is.
const PATIENCE: Duration = Duration::from_secs(2);

/// How long it may take to end.
const FAREWELL: Duration = Duration::from_secs(1);

/// What an address has as bytes in hexadecimal behind a `%`: all but what RFC 3986 leaves unreserved.
const ENCODED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'_').remove(b'.').remove(b'~');

/// How often it is looked at meanwhile.
const TICK: Duration = Duration::from_millis(5);

/// A page over the folder that a run is in.
pub(crate) struct CompanionPage {
    page: Child,
    address: String,
}

impl CompanionPage {
    /// Starts one for the run at `run`; none where it cannot be had, without which training goes on.
    pub(crate) fn start(run: &Path) -> Option<CompanionPage> {
        let run = run.canonicalize().ok()?;
        let mut command = Command::new(std::env::current_exe().ok()?);
        command.args(["page", "--beside-training"]).arg(run.parent()?);
        // In a group of its own: Ctrl-C is for the training alone.
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

    /// Where a browser finds the run.
    pub(crate) fn address(&self) -> &str {
        &self.address
    }
}

impl Drop for CompanionPage {
    fn drop(&mut self) {
        drop(self.page.stdin.take());
        // It may wait for an answer to somebody.
        let deadline = Instant::now() + FAREWELL;
        while matches!(self.page.try_wait(), Ok(None)) && Instant::now() < deadline {
            thread::sleep(TICK);
        }
        self.page.kill().ok();
        self.page.wait().ok();
    }
}

/// A name as a part of an address.
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
