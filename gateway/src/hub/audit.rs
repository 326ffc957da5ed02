//! The audit: some episodes of hosts are re-simulated on this machine before they are published. What is sampled and
//! cannot be re-simulated is not published, so a failing auditor admits nothing; the learner grants the lease again.

use std::collections::{BTreeMap, VecDeque};
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::time::Duration;

use anyhow::{Context, Result};
use bytes::Bytes;
use prost::Message;
use protocol::dropped::Dropped;
use protocol::messages::AuditRequest;
use protocol::task::Spec;
use protocol::trajectory::{Encoded, Trajectory};
use run::folder::RunFolder;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::{mpsc, watch};

use super::newest::Newest;

/// Number of episodes that may wait for the auditor; beyond that, hosts wait.
const WAITING: usize = 16;

/// Number of verdicts kept for hosts that send an episode again: a call may time out before its audit ends.
const KEPT: usize = 1024;

/// How long the auditor may take to start and to answer, and how much longer for each step of the episode. Then it is
/// killed. This is ample, as only an auditor that hangs should meet it.
const PATIENCE: [Duration; 2] = [Duration::from_secs(60), Duration::from_secs(1)];

/// Pause before an auditor that has failed is started again.
const PAUSE: Duration = Duration::from_millis(500);

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
    trouble: Arc<OnceLock<String>>,
}

/// What the audit of an episode found.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Verdict {
    /// It comes out the same here.
    Same,
    /// How it comes out otherwise.
    Differs(String),
    /// It could not be re-simulated.
    Unknown,
}

/// The verdicts of the latest episodes given to the auditor, by hash; `None` until there is one.
struct Judged {
    verdicts: BTreeMap<u64, watch::Receiver<Option<Verdict>>>,
    order: VecDeque<u64>,
    /// Episodes of policies that are not, or no longer, among the newest.
    late: Dropped,
}

impl Judged {
    fn new() -> Judged {
        let late = Dropped::new("episodes of hosts whose policy is not here for their audit");
        Judged { verdicts: BTreeMap::new(), order: VecDeque::new(), late }
    }

    /// Returns the verdict on an episode, or the place where it will be. An episode that could not be judged is judged
    /// anew.
    fn of(&self, hash: u64) -> Option<watch::Receiver<Option<Verdict>>> {
        let found = self.verdicts.get(&hash)?;
        let is_unknown = *found.borrow() == Some(Verdict::Unknown);
        (!is_unknown).then(|| found.clone())
    }

    fn keep(&mut self, hash: u64, verdict: watch::Receiver<Option<Verdict>>) {
        self.verdicts.insert(hash, verdict);
        self.order.push_back(hash);
        if self.order.len() > KEPT
            && let Some(oldest) = self.order.pop_front()
        {
            self.verdicts.remove(&oldest);
        }
    }
}

/// A sampled episode; `None` if it cannot be judged here.
pub(super) struct Trial(Option<watch::Receiver<Option<Verdict>>>);

impl Trial {
    /// Waits for the verdict.
    pub(super) async fn verdict(self) -> Verdict {
        let Some(mut judged) = self.0 else { return Verdict::Unknown };
        match judged.wait_for(Option::is_some).await {
            Ok(verdict) => verdict.clone().unwrap_or(Verdict::Unknown),
            Err(_) => Verdict::Unknown,
        }
    }
}

/// An episode to judge.
struct Case {
    version: u64,
    weights: Bytes,
    trajectory: Bytes,
    /// How long the auditor may take.
    patience: Duration,
    verdict: watch::Sender<Option<Verdict>>,
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
        let trouble = Arc::<OnceLock<String>>::default();
        tokio::spawn(work(audit.program.clone(), folder.clone(), waiting, trouble.clone()));
        let (random, judged) = (RandomState::new(), Mutex::new(Judged::new()));
        Auditor { share: audit.share, random, spec, weights, cases, judged, trouble }
    }

    /// Returns why an episode could not be re-simulated, the first time.
    pub(super) fn trouble(&self) -> Option<String> {
        self.trouble.get().cloned()
    }

    /// Has an episode judged if it is sampled. Bytes that are not a trajectory are not: they are refused later.
    pub(super) async fn trial(&self, trajectory: &Bytes) -> Option<Trial> {
        // A host that waits for a place must not learn from it that its episode is sampled.
        let Ok(place) = self.cases.reserve().await else { return Some(Trial(None)) };
        // No host can know which episodes are sampled, and the decision is the same each time an episode is sent.
        let hash = self.random.hash_one(&trajectory[..]);
        if hash as f64 / u64::MAX as f64 >= self.share {
            return None;
        }
        let known = self.judged().of(hash);
        if known.is_some() {
            return Some(Trial(known));
        }
        let decoded = Encoded::decode(trajectory.clone(), &self.spec).ok()?.trajectory;
        Some(Trial(self.give(place, hash, trajectory, &decoded)))
    }

    /// Gives an episode to the auditor; returns `None` if the hub lacks the policy that acted. It has those of all open
    /// leases.
    fn give(
        &self,
        place: mpsc::Permit<'_, Case>,
        hash: u64,
        trajectory: &Bytes,
        decoded: &Trajectory,
    ) -> Option<watch::Receiver<Option<Verdict>>> {
        let version = decoded.policy_version;
        let weights = self.weights.borrow().of_version(version);
        let Some(weights) = weights else {
            self.judged().late.note(format!("lane {}, version {version}", decoded.lane));
            return None;
        };
        let (verdict, judged) = watch::channel(None);
        let patience = PATIENCE[0] + decoded.steps * PATIENCE[1];
        let case = Case { version, weights, trajectory: trajectory.clone(), patience, verdict };
        place.send(case);
        self.judged().keep(hash, judged.clone());
        Some(judged)
    }

    fn judged(&self) -> MutexGuard<'_, Judged> {
        self.judged.lock().expect("nothing panics while it holds the verdicts")
    }
}

/// Judges one case after another.
async fn work(
    program: PathBuf,
    folder: RunFolder,
    mut cases: mpsc::Receiver<Case>,
    trouble: Arc<OnceLock<String>>,
) {
    let mut actor = None;
    let mut audited: u64 = 0;
    let mut failed = Dropped::new("episodes of hosts that could not be audited");
    while let Some(case) = cases.recv().await {
        let mut judged = judge(&case, &mut actor, &program, &folder).await;
        if let Err(error) = &judged {
            tracing::warn!("restarting the auditor: {error:#}");
            tokio::time::sleep(PAUSE).await;
            judged = judge(&case, &mut actor, &program, &folder).await;
        }
        audited += u64::from(judged.is_ok());
        if judged.is_ok() && audited.is_power_of_two() {
            tracing::info!("episodes of hosts re-simulated: {audited}");
        }
        let verdict = judged.unwrap_or_else(|error| {
            let why = format!("{error:#}");
            failed.note_loudly(&why);
            trouble.get_or_init(|| why);
            Verdict::Unknown
        });
        case.verdict.send_replace(Some(verdict));
    }
}

/// Has the program judge a case. The program is started if it is not running, and killed if it fails or takes too long.
async fn judge(
    case: &Case,
    actor: &mut Option<Actor>,
    program: &Path,
    folder: &RunFolder,
) -> Result<Verdict> {
    let mut running = actor.take().map_or_else(|| Actor::start(program, folder), Ok)?;
    let difference = tokio::time::timeout(case.patience, running.judge(case)).await;
    let difference =
        difference.with_context(|| format!("no verdict within {:?}", case.patience))??;
    *actor = Some(running);
    Ok(difference.map_or(Verdict::Same, Verdict::Differs))
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

    /// Hangs at its first start, and reports a difference at the second.
    const HANGING: &str = r#"#!/bin/sh
[ -e "$0.hung" ] || { touch "$0.hung"; exec sleep 60; }
echo '"another observation"'
exec sleep 60
"#;

    fn block_on<T>(work: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(work)
    }

    #[test]
    fn an_auditor_that_dies_or_hangs_is_started_again_for_the_same_episode() {
        for text in [PROGRAM, HANGING] {
            let directory = tempfile::tempdir().unwrap();
            let program = auditor(directory.path(), text);
            let (verdict, judged) = watch::channel(None);
            let (weights, trajectory) = (Bytes::from_static(b"w"), Bytes::from_static(b"t"));
            let (cases, waiting) = mpsc::channel(1);
            let patience = Duration::from_secs(2);
            let case = Case { version: 3, weights, trajectory, patience, verdict };
            cases.try_send(case).ok().unwrap();
            drop(cases);
            let trouble = Arc::default();
            block_on(work(program, RunFolder::new(directory.path()), waiting, trouble));
            let difference = Verdict::Differs("another observation".to_owned());
            assert_eq!(*judged.borrow(), Some(difference));
        }
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

    /// Dies at its first two starts, and reports no difference at the third.
    const DYING: &str = r#"#!/bin/sh
echo >> "$0.starts"
[ "$(wc -l < "$0.starts")" -gt 2 ] || exit 1
echo null
exec sleep 60
"#;

    /// Starts an auditor of all episodes at a hub that has the weights of version 0.
    fn of_all(program: PathBuf, directory: &Path, config: &RunConfig) -> Auditor {
        let mut newest = Newest::default();
        newest.take(0, Bytes::from_static(b"w"));
        let (_, weights) = watch::channel(newest);
        let audit = Audit { share: 1.0, program };
        Auditor::start(&audit, &RunFolder::new(directory), config.task.spec(), weights)
    }

    async fn verdict(auditor: &Auditor, trajectory: &Bytes) -> Verdict {
        auditor.trial(trajectory).await.unwrap().verdict().await
    }

    /// The host's call ends before the verdict; when the episode is sent again, the auditor is still at work on it.
    #[test]
    fn an_episode_is_judged_once_however_often_a_host_sends_it() {
        let directory = tempfile::tempdir().unwrap();
        let program = auditor(directory.path(), SLOW);
        let config = run::tasks::configuration("navigation", None, &[]).unwrap();
        let trajectory = episode(&config);
        block_on(async {
            let auditor = of_all(program, directory.path(), &config);
            let impatient = Duration::from_millis(100);
            let first = timeout(impatient, verdict(&auditor, &trajectory)).await;
            assert!(first.is_err(), "the call ended first");
            assert_eq!(verdict(&auditor, &trajectory).await, Verdict::Same);
            assert_eq!(verdict(&auditor, &trajectory).await, Verdict::Same);
        });
        let judged = fs::read_to_string(directory.path().join("auditor.judged")).unwrap();
        assert_eq!(judged.lines().count(), 1);
    }

    #[test]
    fn what_cannot_be_audited_does_not_count_as_the_same() {
        let directory = tempfile::tempdir().unwrap();
        let program = auditor(directory.path(), DYING);
        let config = run::tasks::configuration("navigation", None, &[]).unwrap();
        let trajectory = episode(&config);
        let decoded = Encoded::decode(trajectory.clone(), &config.task.spec()).unwrap().trajectory;
        let of_no_policy = Trajectory { policy_version: 7, ..decoded };
        block_on(async {
            let auditor = of_all(program, directory.path(), &config);
            let unknown = verdict(&auditor, &Encoded::encode(of_no_policy).bytes).await;
            assert_eq!(unknown, Verdict::Unknown);
            assert_eq!(verdict(&auditor, &trajectory).await, Verdict::Unknown);
            // The next host that runs the same lease sends the same bytes.
            assert_eq!(verdict(&auditor, &trajectory).await, Verdict::Same);
        });
    }
}
