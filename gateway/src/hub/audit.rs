//! The audit: some episodes of hosts are re-simulated on this machine before they are published.

use std::collections::{BTreeMap, VecDeque};
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Mutex, MutexGuard};

use anyhow::{Context, Result};
use bytes::Bytes;
use prost::Message;
use protocol::messages::AuditRequest;
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use run::folder::RunFolder;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::{mpsc, watch};

use super::newest::Newest;

/// Number of episodes that may wait for the auditor; beyond that, hosts wait.
const WAITING: usize = 16;

/// Number of verdicts kept for hosts that send an episode again: a call may time out before its audit ends.
const KEPT: usize = 1024;

/// The share of episodes that is audited, and the program that audits them.
#[derive(Clone, Debug)]
pub struct Audit {
    /// Fraction of episodes that are audited, in [0, 1].
    pub share: f64,
    /// The program that can act in the run's task.
    pub program: PathBuf,
}

/// Has sampled episodes re-simulated.
pub(super) struct Auditor {
    share: f64,
    random: RandomState,
    spec: Spec,
    weights: watch::Receiver<Newest>,
    cases: mpsc::Sender<Case>,
    judged: Mutex<Judged>,
}

/// How an episode differs, or `Some(None)` if it does not; `None` until it is judged.
type Verdict = Option<Option<String>>;

/// The verdicts of the latest episodes given to the auditor, by hash.
#[derive(Default)]
struct Judged {
    verdicts: BTreeMap<u64, watch::Receiver<Verdict>>,
    order: VecDeque<u64>,
}

impl Judged {
    fn keep(&mut self, hash: u64, verdict: watch::Receiver<Verdict>) {
        self.verdicts.insert(hash, verdict);
        self.order.push_back(hash);
        if self.order.len() > KEPT
            && let Some(oldest) = self.order.pop_front()
        {
            self.verdicts.remove(&oldest);
        }
    }
}

/// An episode that has been or will be judged.
pub(super) struct Trial(watch::Receiver<Verdict>);

impl Trial {
    /// Waits for the verdict; returns how the episode differs from its re-simulation, if it does.
    pub(super) async fn difference(mut self) -> Option<String> {
        self.0.wait_for(Option::is_some).await.ok()?.clone().flatten()
    }
}

/// An episode to judge.
struct Case {
    version: u64,
    weights: Bytes,
    trajectory: Bytes,
    verdict: watch::Sender<Verdict>,
}

impl Auditor {
    /// Starts the auditor, inside a Tokio runtime. The program itself starts with the first episode.
    pub(super) fn start(
        audit: &Audit,
        folder: &RunFolder,
        spec: Spec,
        weights: watch::Receiver<Newest>,
    ) -> Auditor {
        let (cases, waiting) = mpsc::channel(WAITING);
        tokio::spawn(work(audit.program.clone(), folder.clone(), waiting));
        let (random, judged) = (RandomState::new(), Mutex::default());
        Auditor { share: audit.share, random, spec, weights, cases, judged }
    }

    /// Has an episode judged if it is sampled. An episode that cannot be re-simulated here passes.
    pub(super) async fn trial(&self, trajectory: &Bytes) -> Option<Trial> {
        // No host can know which episodes are sampled, and the decision is the same each time an episode is sent.
        let hash = self.random.hash_one(&trajectory[..]);
        if hash as f64 / u64::MAX as f64 >= self.share {
            return None;
        }
        let known = self.judged().verdicts.get(&hash).cloned();
        match known {
            Some(verdict) => Some(Trial(verdict)),
            None => self.give(hash, trajectory).await.map(Trial),
        }
    }

    /// Gives an episode to the auditor; returns `None` if it cannot be re-simulated here.
    async fn give(&self, hash: u64, trajectory: &Bytes) -> Option<watch::Receiver<Verdict>> {
        // Bytes that are not a trajectory are refused later, before they would be published.
        let decoded = Encoded::decode(trajectory.clone(), &self.spec).ok()?.trajectory;
        let version = decoded.policy_version;
        let weights = self.weights.borrow().of_version(version)?;
        let (verdict, judged) = watch::channel(None);
        let case = Case { version, weights, trajectory: trajectory.clone(), verdict };
        self.cases.send(case).await.ok()?;
        self.judged().keep(hash, judged.clone());
        Some(judged)
    }

    fn judged(&self) -> MutexGuard<'_, Judged> {
        self.judged.lock().expect("nothing panics while it holds the verdicts")
    }
}

/// Judges one case after another.
async fn work(program: PathBuf, folder: RunFolder, mut cases: mpsc::Receiver<Case>) {
    let mut actor = None;
    let mut audited: u64 = 0;
    while let Some(case) = cases.recv().await {
        let mut judged = judge(&case, &mut actor, &program, &folder).await;
        if let Err(error) = &judged {
            tracing::warn!("restarting the auditor: {error:#}");
            judged = judge(&case, &mut actor, &program, &folder).await;
        }
        audited += u64::from(judged.is_ok());
        if judged.is_ok() && audited.is_power_of_two() {
            tracing::info!("episodes of hosts re-simulated: {audited}");
        }
        let difference = judged.unwrap_or_else(|error| {
            tracing::error!("an episode could not be audited: {error:#}");
            None
        });
        case.verdict.send_replace(Some(difference));
    }
}

/// Has the program judge a case. The program is started if it is not running, and dropped if it fails.
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

/// The program that re-simulates episodes.
struct Actor {
    /// Killed when this is dropped.
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
    use std::time::Duration;

    use actor::factory::Factory;
    use actor::lane::Lane;
    use protocol::messages::Lease;
    use run::config::RunConfig;
    use tokio::time::timeout;

    use super::*;

    /// Exits at its first start, and reports a difference at the second.
    const PROGRAM: &str = r#"#!/bin/sh
[ -e "$0.died" ] || { touch "$0.died"; exit 1; }
echo '"another observation"'
exec sleep 60
"#;

    fn auditor(directory: &Path, text: &str) -> PathBuf {
        let program = directory.join("auditor");
        fs::write(&program, text).unwrap();
        fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();
        program
    }

    #[test]
    fn an_auditor_that_dies_is_started_again_for_the_same_episode() {
        let directory = tempfile::tempdir().unwrap();
        let program = auditor(directory.path(), PROGRAM);
        let (verdict, judged) = watch::channel(None);
        let (weights, trajectory) = (Bytes::from_static(b"w"), Bytes::from_static(b"t"));
        let (cases, waiting) = mpsc::channel(1);
        cases.try_send(Case { version: 3, weights, trajectory, verdict }).ok().unwrap();
        drop(cases);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(work(program, RunFolder::new(directory.path()), waiting));
        assert_eq!(*judged.borrow(), Some(Some("another observation".to_owned())));
    }

    fn episode(config: &RunConfig) -> Bytes {
        let factory = Factory::of_run(actor::BUILT_IN, config).unwrap();
        let lease = Lease { steps_owed: 1, ..Lease::default() };
        let mut lane = Lane::begin(lease, &factory, None, config.seed).unwrap();
        loop {
            if let Some(trajectory) = lane.step(&[0], Some(0.0)).unwrap() {
                return Encoded::encode(trajectory).bytes;
            }
        }
    }

    /// Takes half a second to report that its episode does not differ, and counts it.
    const SLOW: &str = r#"#!/bin/sh
sleep 0.5
echo >> "$0.judged"
echo null
exec sleep 60
"#;

    async fn difference(auditor: &Auditor, trajectory: &Bytes) -> Option<String> {
        auditor.trial(trajectory).await?.difference().await
    }

    /// The host's call ends before the verdict; when the episode is sent again, the auditor is still at work on it.
    #[test]
    fn an_episode_is_judged_once_however_often_a_host_sends_it() {
        let directory = tempfile::tempdir().unwrap();
        let program = auditor(directory.path(), SLOW);
        let config = run::tasks::configuration("navigation", None, &[]).unwrap();
        let trajectory = episode(&config);
        let mut newest = Newest::default();
        newest.take(0, Bytes::from_static(b"w"));
        let (_newest, weights) = watch::channel(newest);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let audit = Audit { share: 1.0, program: program.clone() };
            let folder = RunFolder::new(directory.path());
            let auditor = Auditor::start(&audit, &folder, config.task.spec(), weights);
            let impatient = Duration::from_millis(100);
            let first = timeout(impatient, difference(&auditor, &trajectory)).await;
            assert!(first.is_err(), "the call ended first");
            assert_eq!(difference(&auditor, &trajectory).await, None);
            assert_eq!(difference(&auditor, &trajectory).await, None);
        });
        let judged = fs::read_to_string(directory.path().join("auditor.judged")).unwrap();
        assert_eq!(judged.lines().count(), 1);
    }
}
