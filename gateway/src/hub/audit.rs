//! The audit: some episodes of hosts are acted again here before they are published.

use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context, Result};
use bytes::Bytes;
use prost::Message;
use protocol::messages::AuditRequest;
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use run::folder::RunFolder;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::{mpsc, oneshot, watch};

use super::newest::Newest;

/// Episodes that may wait for the auditor; hosts wait beyond that.
const WAITING: usize = 16;

/// Which episodes are audited, and by whom.
#[derive(Clone, Debug)]
pub struct Audit {
    /// How many of them, in [0, 1].
    pub share: f64,
    /// The program that acts in the run's task.
    pub program: PathBuf,
}

/// Has episodes acted again.
pub(super) struct Auditor {
    share: f64,
    random: RandomState,
    drawn: AtomicU64,
    spec: Spec,
    weights: watch::Receiver<Newest>,
    cases: mpsc::Sender<Case>,
}

/// An episode to be judged.
struct Case {
    version: u64,
    weights: Bytes,
    trajectory: Bytes,
    verdict: oneshot::Sender<Option<String>>,
}

impl Auditor {
    /// Begins within a runtime; the program starts with the first episode.
    pub(super) fn start(
        audit: &Audit,
        folder: &RunFolder,
        spec: Spec,
        weights: watch::Receiver<Newest>,
    ) -> Auditor {
        let (cases, waiting) = mpsc::channel(WAITING);
        tokio::spawn(work(audit.program.clone(), folder.clone(), waiting));
        let (random, drawn) = (RandomState::new(), AtomicU64::new(0));
        Auditor { share: audit.share, random, drawn, spec, weights, cases }
    }

    /// How an episode differs from what this machine makes of it, if it is one of the sample and does. An
    /// episode that cannot be acted again here is let pass.
    pub(super) async fn difference(&self, trajectory: &Bytes) -> Option<String> {
        if !self.draws() {
            return None;
        }
        // What is no trajectory is refused where it would be published.
        let decoded = Encoded::decode(trajectory.clone(), &self.spec).ok()?.trajectory;
        let version = decoded.policy_version;
        let weights = self.weights.borrow().of_version(version)?;
        let (verdict, judged) = oneshot::channel();
        let case = Case { version, weights, trajectory: trajectory.clone(), verdict };
        self.cases.send(case).await.ok()?;
        judged.await.ok()?
    }

    /// No host can know which episodes are of the sample.
    fn draws(&self) -> bool {
        let number = self.drawn.fetch_add(1, Ordering::Relaxed);
        let drawn = self.random.hash_one(number) as f64 / u64::MAX as f64;
        drawn < self.share
    }
}

/// Judges one case after another.
async fn work(program: PathBuf, folder: RunFolder, mut cases: mpsc::Receiver<Case>) {
    let mut actor = None;
    let mut audited: u64 = 0;
    while let Some(case) = cases.recv().await {
        let mut judged = judge(&case, &mut actor, &program, &folder).await;
        if let Err(error) = &judged {
            tracing::warn!("the auditor is started again: {error:#}");
            judged = judge(&case, &mut actor, &program, &folder).await;
        }
        audited += u64::from(judged.is_ok());
        if judged.is_ok() && audited.is_power_of_two() {
            tracing::info!("episodes of hosts acted again: {audited}");
        }
        let difference = judged.unwrap_or_else(|error| {
            tracing::error!("an episode could not be audited: {error:#}");
            None
        });
        case.verdict.send(difference).ok();
    }
}

/// Has the program judge, which is started where there is none; one that fails is gone.
async fn judge(
    case: &Case,
    actor: &mut Option<Actor>,
    program: &Path,
    folder: &RunFolder,
) -> Result<Option<String>> {
    let mut running = actor.take().map_or_else(|| Actor::start(program, folder), Ok)?;
    let difference = running.judge(case).await?;
    *actor = Some(running);
    Ok(difference)
}

/// The program that acts episodes again.
struct Actor {
    /// It ends when this does.
    _process: Child,
    input: ChildStdin,
    output: Lines<BufReader<ChildStdout>>,
    version: Option<u64>,
}

impl Actor {
    fn start(program: &Path, folder: &RunFolder) -> Result<Actor> {
        let mut command = Command::new(program);
        command.arg("audit").arg("--run").arg(folder.path()).kill_on_drop(true);
        let started = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut process = started.with_context(|| program.display().to_string())?;
        let input = process.stdin.take().context("the auditor's input")?;
        let output = process.stdout.take().context("the auditor's output")?;
        let output = BufReader::new(output).lines();
        Ok(Actor { _process: process, input, output, version: None })
    }

    async fn judge(&mut self, case: &Case) -> Result<Option<String>> {
        let is_new = self.version != Some(case.version);
        let weights = is_new.then(|| case.weights.clone());
        let request = AuditRequest { weights, trajectory: case.trajectory.clone() };
        let request = request.encode_to_vec();
        self.input.write_all(&(request.len() as u64).to_le_bytes()).await?;
        self.input.write_all(&request).await?;
        self.input.flush().await?;
        let line = self.output.next_line().await?;
        let line = line.ok_or_else(|| io::Error::other("the auditor has ended"))?;
        self.version = Some(case.version);
        serde_json::from_str(&line).with_context(|| format!("expected a difference, found {line}"))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// Dies of its first episode, and finds something in the next.
    const PROGRAM: &str = r#"#!/bin/sh
[ -e "$0.died" ] || { touch "$0.died"; exit 1; }
echo '"another observation"'
exec sleep 60
"#;

    #[test]
    fn an_auditor_that_dies_is_started_again_for_the_same_episode() {
        let directory = tempfile::tempdir().unwrap();
        let program = directory.path().join("auditor");
        fs::write(&program, PROGRAM).unwrap();
        fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();
        let (verdict, mut judged) = oneshot::channel();
        let (weights, trajectory) = (Bytes::from_static(b"w"), Bytes::from_static(b"t"));
        let (cases, waiting) = mpsc::channel(1);
        cases.try_send(Case { version: 3, weights, trajectory, verdict }).ok().unwrap();
        drop(cases);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(work(program, RunFolder::new(directory.path()), waiting));
        assert_eq!(judged.try_recv().unwrap().as_deref(), Some("another observation"));
    }
}
