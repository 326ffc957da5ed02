//! Carries out plans: starts the next run, notices which runs have ended, and shows the progress.
//!
//! Every run is a `goalward train` of its own, which supervises its processes, locks its folder and can be continued.
//! So nothing is lost if an experiment ends early, in whatever way: a finished run has a summary and is skipped, and a
//! run that has begun continues from its newest checkpoint.

use std::collections::VecDeque;
use std::process::ExitStatus;
use std::time::Duration;

use anyhow::{Context, Result};
use mcap_log::is_being_written;
use run::summary::Summary;

use super::archive::Archive;
use super::estimate::Estimate;
use super::planned_run::PlannedRun;
use super::recorder::Recorder;
use super::training::{Standing, Training};
use crate::child::Child;
use crate::supervisor::{Signals, runtime};
use terminal::numbers;
use terminal::refusal::{STOPPED, WRONG_USAGE};
use terminal::status_line::StatusLine;

/// Time between two checks of the processes if no signal arrives.
const TICK: Duration = Duration::from_millis(500);

/// How an experiment ended.
#[derive(Debug, Default)]
pub(crate) struct Ended {
    /// Whether the user stopped it.
    pub(crate) is_stopped: bool,
    /// Runs that failed.
    pub(crate) failed: Vec<String>,
    /// Runs that another process is training.
    pub(crate) elsewhere: Vec<String>,
}

/// Trains runs in their order, `jobs` at a time, and skips finished ones. Runs that another build has begun fail,
/// unless `other_build` is set: then they are continued.
///
/// # Errors
/// When signals cannot be listened for, or the system cannot say how a process ended. A run that cannot start or fails
/// is no error.
pub(crate) fn execute(
    runs: &[PlannedRun],
    archive: &mut Archive,
    jobs: usize,
    other_build: bool,
) -> Result<Ended> {
    let mut execution = Execution {
        jobs,
        other_build,
        runs: runs.len(),
        finished: 0,
        waiting: VecDeque::new(),
        recorder: None,
        running: Vec::new(),
        estimate: Estimate::default(),
        line: StatusLine::new(),
        elsewhere: Vec::new(),
        ended: Ended::default(),
    };
    for run in runs {
        let training = Training::of(run, archive);
        match Summary::of_finished(&training.folder, |remark| execution.line.note(remark)) {
            Some(summary) => execution.count(&training, &summary),
            None => execution.waiting.push_back(training),
        }
    }
    let outcome = runtime()?.block_on(execution.run());
    execution.line.finish();
    let elsewhere = execution.elsewhere.into_iter().map(|training| training.name).collect();
    outcome.map(|()| Ended { elsewhere, ..execution.ended })
}

struct Execution {
    jobs: usize,
    other_build: bool,
    /// Number of runs of all plans, each counted once.
    runs: usize,
    finished: usize,
    waiting: VecDeque<Training>,
    /// Records the demonstrations of the first waiting run.
    recorder: Option<Recorder>,
    running: Vec<(Training, Child)>,
    /// Runs that another process was found to be training.
    elsewhere: Vec<Training>,
    estimate: Estimate,
    line: StatusLine,
    ended: Ended,
}

/// What was begun for the next run.
enum Begun {
    Training(Child),
    Recording(Recorder),
    /// Nothing, since another process has finished the run in the meantime.
    Nothing,
    /// Nothing, since another process is training the run.
    Elsewhere,
    /// Nothing yet, since another process is recording the run's demonstrations.
    Later,
}

impl Execution {
    async fn run(&mut self) -> Result<()> {
        let mut signals = Signals::listen()?;
        loop {
            let is_news = self.reap()?;
            let can_start_more = !self.ended.is_stopped && self.start_next();
            let is_idle = self.running.is_empty() && self.recorder.is_none();
            if is_idle && self.waiting.is_empty() {
                self.look_elsewhere();
            }
            if is_idle && (self.waiting.is_empty() || self.ended.is_stopped) {
                return Ok(());
            }
            self.show(is_news);
            let pause = if can_start_more { Duration::ZERO } else { TICK };
            tokio::select! {
                biased;
                () = signals.stop.next() => self.stop(),
                () = signals.child.next() => {}
                () = tokio::time::sleep(pause) => {}
            }
        }
    }

    /// Starts the next run or the recording of its demonstrations, if there is room for it; returns whether there was
    /// anything to do.
    fn start_next(&mut self) -> bool {
        if self.recorder.is_some() || self.running.len() >= self.jobs {
            return false;
        }
        let Some(mut training) = self.waiting.pop_front() else { return false };
        match self.begin(&mut training) {
            Ok(Begun::Training(child)) => self.running.push((training, child)),
            Ok(Begun::Recording(recorder)) => {
                self.recorder = Some(recorder);
                self.waiting.push_front(training);
            }
            Ok(Begun::Nothing) => {}
            Ok(Begun::Elsewhere) => self.leave_to_others(training),
            Ok(Begun::Later) => {
                self.waiting.push_back(training);
                return false;
            }
            Err(error) => self.fail(&training, &format!("cannot begin: {error:#}")),
        }
        true
    }

    fn begin(&mut self, training: &mut Training) -> Result<Begun> {
        training.claim().with_context(|| training.folder.path().display().to_string())?;
        if let Some(summary) = training.summary() {
            self.count(training, &summary);
            return Ok(Begun::Nothing);
        }
        if training.is_elsewhere() {
            return Ok(Begun::Elsewhere);
        }
        training.require_same_program()?;
        let Some(file) = training.missing_demonstrations() else {
            return training.start(self.jobs == 1, self.other_build).map(Begun::Training);
        };
        if is_being_written(&file) {
            return Ok(Begun::Later);
        }
        Recorder::start(&training.run.config, file).map(Begun::Recording)
    }

    /// Notices what has ended; returns whether a run has.
    fn reap(&mut self) -> Result<bool> {
        let mut is_news = false;
        for (training, mut child) in std::mem::take(&mut self.running) {
            match child.reap()? {
                Some(status) => {
                    is_news = true;
                    self.settle(training, status);
                }
                None => self.running.push((training, child)),
            }
        }
        if let Some(mut recorder) = self.recorder.take() {
            match recorder.child.reap()? {
                Some(status) => self.settle_recording(recorder, status),
                None => self.recorder = Some(recorder),
            }
        }
        Ok(is_news)
    }

    fn settle(&mut self, training: Training, status: ExitStatus) {
        let ended_with = |code: u8| status.code() == Some(i32::from(code));
        // A process that a signal ended has no code.
        let was_stopped = status.code().is_none() || ended_with(STOPPED);
        match training.summary() {
            Some(summary) => self.count(&training, &summary),
            None if self.ended.is_stopped && was_stopped => {}
            None if ended_with(WRONG_USAGE) && training.is_elsewhere() => {
                self.leave_to_others(training)
            }
            None => {
                let words = training.output().last_lines();
                self.fail(&training, &format!("ended ({status}); {words}"));
            }
        }
    }

    fn settle_recording(&mut self, recorder: Recorder, status: ExitStatus) {
        let Err(error) = recorder.end(status) else { return };
        if !self.ended.is_stopped
            && let Some(training) = self.waiting.pop_front()
        {
            self.fail(&training, &format!("has no demonstrations: {error:#}"));
        }
    }

    fn count(&mut self, training: &Training, summary: &Summary) {
        self.finished += 1;
        self.estimate.add(&training.run.config, summary.wall_s);
    }

    fn fail(&mut self, training: &Training, how: &str) {
        self.line.note(&format!("the run {} {how}", training.name));
        self.ended.failed.push(training.name.clone());
    }

    fn leave_to_others(&mut self, training: Training) {
        self.line.note(&format!("the run {} is being trained by another process", training.name));
        self.elsewhere.push(training);
    }

    /// Takes back the runs that other processes have finished or stopped training.
    fn look_elsewhere(&mut self) {
        let (trained, left): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.elsewhere).into_iter().partition(Training::is_elsewhere);
        self.elsewhere = trained;
        self.waiting.extend(left);
    }

    /// Passes on the user's request to stop; the second time, runs end at once.
    fn stop(&mut self) {
        if !std::mem::replace(&mut self.ended.is_stopped, true) {
            self.line.note(
                "stopping: every run writes a checkpoint (press Ctrl-C again to stop at once)",
            );
        }
        let recording = self.recorder.iter_mut().map(|recorder| &mut recorder.child);
        let training = self.running.iter_mut().map(|(_, child)| child);
        for child in recording.chain(training) {
            if !child.end_input() {
                child.interrupt();
            }
        }
    }

    fn show(&mut self, is_news: bool) {
        let standings: Vec<_> =
            self.running.iter().map(|(training, _)| (training, training.standing())).collect();
        let mut doing: Vec<String> =
            standings.iter().map(|(training, standing)| words(training, *standing)).collect();
        doing.extend(self.recorder.as_ref().map(Recorder::words));
        let seconds = |training: &Training| self.estimate.seconds(&training.run.config);
        let running_s = standings.iter().map(|(training, standing)| {
            seconds(training) * standing.map_or(1.0, Standing::part_left)
        });
        let left_s = running_s.chain(self.waiting.iter().map(seconds)).sum::<f64>();
        let at_once = self.jobs.min(self.running.len() + self.waiting.len()).max(1);
        let failed = match self.ended.failed.len() {
            0 => String::new(),
            count => format!(", {count} failed"),
        };
        let line = format!(
            "{} of {} runs finished{failed}  {} waiting  {} left  {}",
            self.finished,
            self.runs,
            self.waiting.len(),
            numbers::duration(left_s / at_once as f64),
            doing.join("; "),
        );
        let tenth = numbers::percent_done(self.finished as u64, self.runs as u64) / 10;
        self.line.show(&line, tenth, is_news);
    }
}

/// Describes a run that is being trained.
fn words(training: &Training, standing: Option<Standing>) -> String {
    let name = &training.name;
    match standing {
        None => name.clone(),
        Some(Standing { percent, success_rate }) if success_rate.is_finite() => {
            format!("{name} {percent} %, success {}", numbers::percent(success_rate, 0))
        }
        Some(Standing { percent, .. }) => format!("{name} {percent} %"),
    }
}
