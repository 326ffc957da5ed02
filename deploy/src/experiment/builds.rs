//! That all runs of an experiment are of the build at work, unless the user wants otherwise.

use anyhow::Result;
use protocol::build::Build;

use super::archive::Archive;
use super::planned_run::PlannedRun;
use report::origin::Origin;
use terminal::refusal::wrong_usage;

/// Looks at every run that was begun.
///
/// # Errors
/// Of wrong usage, in a line that says how many runs are of another build and names one.
pub(crate) fn refuse_other_builds(runs: &[PlannedRun], archive: &mut Archive) -> Result<()> {
    let mut others = Vec::new();
    for run in runs {
        let origin = Origin::of(&archive.folder_of(run)).filter(|origin| !origin.is_own());
        others.extend(origin.map(|origin| (archive.name_of(run), origin)));
    }
    let Some((name, origin)) = others.first() else { return Ok(()) };
    Err(wrong_usage(format!(
        "{}: expected runs of this build, {}, found {} of {} of another one, such as {name} by {}; \
         --other-build counts and continues them, another --out trains all anew",
        archive.runs().display(),
        Build::own(),
        others.len(),
        runs.len(),
        origin.builds(),
    )))
}
