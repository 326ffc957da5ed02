//! Checks that all runs of an experiment are by this build, unless the user wants otherwise.

use anyhow::Result;
use protocol::build::Build;

use super::archive::Archive;
use super::planned_run::PlannedRun;
use report::origin::Origin;
use terminal::refusal::wrong_usage;

/// Refuses runs that another build has begun.
///
/// # Errors
/// Wrong usage, in a line that says how many runs are by another build and names one.
pub(crate) fn refuse_other_builds(runs: &[PlannedRun], archive: &mut Archive) -> Result<()> {
    let mut others = Vec::new();
    for run in runs {
        let origin = Origin::of(&archive.folder_of(run)).filter(|origin| !origin.is_own());
        others.extend(origin.map(|origin| (archive.name_of(run), origin)));
    }
    let Some((name, origin)) = others.first() else { return Ok(()) };
    Err(wrong_usage(format!(
        "{}: expected runs of this build, {}, found {} of {} by another build, such as {name} by \
         {}; --other-build counts and continues them, another --out trains all runs again",
        archive.runs().display(),
        Build::own(),
        others.len(),
        runs.len(),
        origin.builds(),
    )))
}
