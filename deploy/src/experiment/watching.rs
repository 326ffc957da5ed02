//! Shows the progress of plans whose runs other processes train.

use std::time::Duration;

use anyhow::Result;

use super::archive::Archive;
use super::planned_run::PlannedRun;
use super::training::{Standing, Training};
use crate::supervisor::{Signals, runtime};
use terminal::numbers;
use terminal::status_line::StatusLine;

/// Time between two looks at the folders.
const TICK: Duration = Duration::from_secs(2);

/// How watching ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Watched {
    /// Every run is finished.
    Finished,
    /// The missing runs will not be trained any more.
    Over,
    /// The user stopped watching.
    Stopped,
}

/// Shows the progress of runs until all are finished, `is_over` returns true, or the user stops watching.
///
/// # Errors
/// When signals cannot be listened for.
pub(crate) fn watch(
    runs: &[PlannedRun],
    archive: &mut Archive,
    is_over: impl Fn() -> bool,
) -> Result<Watched> {
    let mut line = StatusLine::new();
    let watched = runtime()?.block_on(async {
        let mut signals = Signals::listen()?;
        loop {
            // Asked first, so that runs that finished before are still seen.
            let over = is_over();
            // Another experiment may begin the same run under another name.
            archive.look();
            let trainings: Vec<Training> =
                runs.iter().map(|run| Training::of(run, archive)).collect();
            if show(&trainings, &mut line) {
                return Ok(Watched::Finished);
            }
            if over {
                return Ok(Watched::Over);
            }
            tokio::select! {
                () = signals.stop.next() => return Ok(Watched::Stopped),
                () = tokio::time::sleep(TICK) => {}
            }
        }
    });
    line.finish();
    watched
}

/// Shows the progress of the runs; returns whether all are finished.
fn show(trainings: &[Training], line: &mut StatusLine) -> bool {
    let missing = trainings.iter().filter(|training| training.summary().is_none());
    let missing: Vec<&Training> = missing.collect();
    let trained = missing.iter().filter(|training| training.is_elsewhere());
    let trained: Vec<Option<Standing>> = trained.map(|training| training.standing()).collect();
    let percents = trained.iter().flatten().map(|standing| standing.percent).collect::<Vec<_>>();
    let doing = percents.iter().map(|percent| format!("{percent} %")).collect::<Vec<_>>();
    let finished = trainings.len() - missing.len();
    let (runs, at_work) = (trainings.len(), trained.len());
    let text = format!(
        "{finished} of {runs} runs finished  {at_work} being trained  {}",
        doing.join(", ")
    );
    let tenth = numbers::percent_done(finished as u64, runs as u64) / 10;
    line.show(&text, tenth, false);
    missing.is_empty()
}
