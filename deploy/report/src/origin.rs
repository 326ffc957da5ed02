//! Which runs are seeds of one curve: those trained by the same build on the same demonstrations.

use mcap_log::recorded_builds;
use protocol::build::Build;
use protocol::build::shown;
use run::folder::RunFolder;
use run::origin::Demonstrations;
use run::summary::Summary;

use crate::figure::{Curve, Figure};

/// The origin of a run apart from its configuration: builds and demonstrations.
#[derive(Clone, Debug)]
pub struct Origin {
    /// The builds that trained it, one after another; empty if they were not recorded.
    builds: Vec<Build>,
    /// The demonstrations that it imitated.
    demonstrations: Imitated,
}

#[derive(Clone, Debug)]
enum Imitated {
    Nobody,
    Unknown,
    Known(Box<Demonstrations>),
}

impl Origin {
    /// Returns the origin of a run; `None` if it has not begun.
    pub fn of(folder: &RunFolder) -> Option<Origin> {
        let config = folder.config().ok()?;
        let (builds, demonstrations) = match Summary::of_run(folder).ok().flatten() {
            Some(summary) => (summary.builds, summary.demonstrations),
            None => {
                let builds = recorded_builds(&folder.log()).ok().filter(|all| !all.is_empty())?;
                let is_unknown = builds.iter().all(Build::is_unknown);
                let builds = if is_unknown { Vec::new() } else { builds };
                (builds, Demonstrations::of_run(folder, &config).ok().flatten())
            }
        };
        let demonstrations = match demonstrations {
            _ if !config.imitates() => Imitated::Nobody,
            None => Imitated::Unknown,
            Some(known) => Imitated::Known(Box::new(known)),
        };
        Some(Origin { builds, demonstrations })
    }

    /// Returns whether only the build of the running program has trained it.
    pub fn is_own(&self) -> bool {
        let own = Build::own();
        !self.builds.is_empty() && self.builds.iter().all(|build| build.difference(own).is_none())
    }

    /// Returns the builds, in one line.
    pub fn builds(&self) -> String {
        shown(&self.builds)
    }

    /// Returns marks that identify it. Two runs with the same configuration apart from the seed are seeds of one curve
    /// if their origins have a mark in common.
    pub fn marks(&self) -> Vec<String> {
        let marks = self.demonstrations.marks().into_iter();
        marks.map(|mark| format!("{mark} {:?}", self.builds)).collect()
    }

    fn is_alike(&self, other: &Origin) -> bool {
        have_one_in_common(&self.marks(), &other.marks())
    }
}

fn have_one_in_common(one: &[String], other: &[String]) -> bool {
    one.iter().any(|mark| other.contains(mark))
}

impl Imitated {
    fn marks(&self) -> Vec<String> {
        match self {
            Imitated::Known(known) => known.marks(),
            Imitated::Nobody | Imitated::Unknown => vec![self.phrase()],
        }
    }

    fn are_alike(&self, other: &Imitated) -> bool {
        have_one_in_common(&self.marks(), &other.marks())
    }

    fn phrase(&self) -> String {
        match self {
            Imitated::Nobody => "no demonstrations".to_owned(),
            Imitated::Unknown => "unknown demonstrations".to_owned(),
            Imitated::Known(known) => known.to_string(),
        }
    }
}

/// Splits curves so that no curve of the figure has runs of several origins.
pub fn apart(mut figure: Figure) -> Figure {
    for panel in &mut figure.panels {
        panel.curves =
            std::mem::take(&mut panel.curves).into_iter().flat_map(curves_apart).collect();
    }
    figure
}

/// Splits a curve by the origins of its runs; the new names say what differs. Runs that have not begun stay with the
/// first origin.
fn curves_apart(curve: Curve) -> Vec<Curve> {
    let mut groups: Vec<(Origin, Vec<RunFolder>)> = Vec::new();
    for run in &curve.runs {
        let Some(origin) = Origin::of(run) else { continue };
        match groups.iter_mut().find(|(other, _)| other.is_alike(&origin)) {
            Some((_, runs)) => runs.push(run.clone()),
            None => groups.push((origin, vec![run.clone()])),
        }
    }
    if groups.len() < 2 {
        return vec![curve];
    }
    let names = names(&curve.name, groups.iter().map(|(origin, _)| origin).collect());
    let begun: Vec<RunFolder> = groups.iter().flat_map(|(_, runs)| runs.clone()).collect();
    let to_come = curve.runs.into_iter().filter(|run| !begun.contains(run));
    groups[0].1.extend(to_come);
    let groups = names.into_iter().zip(groups);
    groups.map(|(name, (_, runs))| Curve { name, runs, anchor: curve.anchor }).collect()
}

/// Returns a name for each origin that says what differs, with a number where names would be equal.
fn names(curve: &str, origins: Vec<&Origin>) -> Vec<String> {
    let first = origins[0];
    let builds_differ = origins.iter().any(|origin| origin.builds != first.builds);
    let imitated = |origin: &&&Origin| !origin.demonstrations.are_alike(&first.demonstrations);
    let demonstrations_differ = origins.iter().any(|origin| imitated(&origin));
    let mut names: Vec<String> = Vec::new();
    for origin in origins {
        let mut name = curve.to_owned();
        if builds_differ {
            name += &format!(", {}", origin.builds());
        }
        if demonstrations_differ {
            name += &format!(", {}", origin.demonstrations.phrase());
        }
        if names.contains(&name) {
            name += &format!(" ({})", names.len() + 1);
        }
        names.push(name);
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    fn build(commit: &str) -> Build {
        Build {
            version: "0.1.0".into(),
            commit: commit.into(),
            rustc: "rustc".into(),
            ..Build::default()
        }
    }

    fn origin(builds: &[&str], demonstrations: Option<(&str, bool)>) -> Origin {
        let known = |(sha256, of_own_seed): (&str, bool)| {
            let build = build("aa");
            let known = Demonstrations { sha256: sha256.to_owned(), of_own_seed, build };
            Imitated::Known(Box::new(known))
        };
        let builds = builds.iter().map(|commit| build(commit)).collect();
        Origin { builds, demonstrations: demonstrations.map_or(Imitated::Nobody, known) }
    }

    #[test]
    fn seeds_have_one_build_and_alike_demonstrations() {
        let own_seed = |hash| origin(&["aa"], Some((hash, true)));
        assert!(own_seed("1").is_alike(&own_seed("2")), "recorded for each seed");
        let given = |hash| origin(&["aa"], Some((hash, false)));
        assert!(given("1").is_alike(&given("1")) && !given("1").is_alike(&given("2")));
        assert!(!given("1").is_alike(&own_seed("2")));
        let nobody = |builds: &[&str]| origin(builds, None);
        assert!(nobody(&["aa"]).is_alike(&nobody(&["aa"])));
        assert!(!nobody(&["aa"]).is_alike(&nobody(&["aa", "bb"])));
        assert!(!nobody(&["aa"]).is_alike(&nobody(&[])) && nobody(&[]).is_alike(&nobody(&[])));
        assert!(!nobody(&["aa"]).is_own() && !nobody(&[]).is_own());
    }

    #[test]
    fn curves_are_named_by_what_differs() {
        let origins = [origin(&["aa"], Some(("1", false))), origin(&["bb"], Some(("1", false)))];
        let found = names("ours", origins.iter().collect());
        assert_eq!(found, ["ours, 0.1.0, commit aa, rustc", "ours, 0.1.0, commit bb, rustc"]);
        let origins = [origin(&[], Some(("1", false))), origin(&[], Some(("2", false)))];
        let found = names("ours", origins.iter().collect());
        assert_eq!(found, ["ours, demonstrations 1", "ours, demonstrations 2"]);
    }
}
