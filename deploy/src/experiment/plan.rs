//! A checked plan: every run that it asks for, with its whole configuration.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Result;
use protocol::dropped::shortened;

use super::archive::Archive;
use super::file::{CurveEntry, PanelEntry, PlanFile, Quick, REASON_CHARS};
use super::planned_run::PlannedRun;
use crate::description;
use report::figure::{Curve, Figure, Panel};
use terminal::refusal::wrong_usage;

/// A plan that can be carried out.
#[derive(Debug)]
pub(crate) struct Plan(Figure<PlannedCurve>);

#[derive(Debug)]
struct PlannedCurve {
    name: String,
    anchor: Option<f64>,
    /// One run for each seed.
    runs: Vec<PlannedRun>,
}

/// Reads plans that are to be carried out together.
///
/// # Errors
/// Wrong usage, when a plan is invalid, or two have the same name.
pub(crate) fn read_all(paths: &[impl AsRef<Path>], quick: bool) -> Result<Vec<Plan>> {
    let mut plans: Vec<Plan> = Vec::new();
    for path in paths {
        let path = path.as_ref();
        let plan = Plan::read(path, quick)?;
        if plans.iter().any(|other| other.0.name == plan.0.name) {
            let (shown, name) = (path.display(), &plan.0.name);
            return Err(wrong_usage(format!("{shown}: another plan is called {name}, too")));
        }
        plans.push(plan);
    }
    Ok(plans)
}

/// Returns the runs of plans, each once, in the order in which they are to be trained.
pub(crate) fn queue(plans: &[Plan], archive: &mut Archive) -> Vec<PlannedRun> {
    let mut runs: Vec<_> = plans.iter().flat_map(Plan::runs).collect();
    runs.sort_by_key(|(seed, _)| *seed);
    let mut known = BTreeSet::new();
    runs.retain(|(_, run)| known.insert(archive.name_of(run)));
    runs.into_iter().map(|(_, run)| run.clone()).collect()
}

impl Plan {
    /// Reads a plan and checks all of it; with `quick`, the plan has its reduced size.
    ///
    /// # Errors
    /// Wrong usage, in one line that names the file, the panel and the curve.
    pub(crate) fn read(path: &Path, quick: bool) -> Result<Plan> {
        let file = PlanFile::read(path)?;
        let refused = |error: anyhow::Error| {
            // The message contains names from the file, which may be long.
            let words = shortened(&format!("{error:#}"), REASON_CHARS);
            wrong_usage(format!("{}: {words}", path.display()))
        };
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self::of(name, file, quick).map_err(refused)
    }

    fn of(name: String, file: PlanFile, quick: bool) -> Result<Plan> {
        check_names("panel", file.panels.iter().map(|panel| panel.name.as_str()))?;
        for panel in &file.panels {
            let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
            if panel.name.is_empty() || !panel.name.chars().all(plain) {
                let name = &panel.name;
                let expected = "expected a name of letters, digits, `-`, `_` and `.`";
                return Err(wrong_usage(format!("panel {name:?}: {expected}")));
            }
        }
        let mut panels = Vec::new();
        for panel in &file.panels {
            // The whole plan is checked, including what a quick one leaves out.
            let planned = planned(panel, &file, quick)
                .map_err(|error| wrong_usage(format!("panel {}: {error:#}", panel.name)))?;
            let only = file.quick.panels.as_ref().filter(|_| quick);
            if only.is_none_or(|only| only.contains(&panel.name)) {
                panels.push(planned);
            }
        }
        check_quick(&file)?;
        identify_programs(&mut panels)?;
        Ok(Plan(Figure { name, title: file.title, panels }))
    }

    /// Returns all runs, each with the place of its seed in its curve, so that the first seeds of all curves can be
    /// trained before the second ones.
    pub(super) fn runs(&self) -> impl Iterator<Item = (usize, &PlannedRun)> {
        let curves = self.0.panels.iter().flat_map(|panel| &panel.curves);
        curves.flat_map(|curve| curve.runs.iter().enumerate())
    }

    /// Returns the plan as a figure whose runs are where they are, or will be, in `archive`.
    pub(crate) fn figure(&self, archive: &mut Archive) -> Figure {
        self.0.map(|curve| Curve {
            name: curve.name.clone(),
            runs: curve.runs.iter().map(|run| archive.folder_of(run)).collect(),
            anchor: curve.anchor,
        })
    }
}

/// Returns the curves of a panel: first its methods, then those with settings of their own.
fn curves_of(panel: &PanelEntry, methods: &[String]) -> Vec<CurveEntry> {
    let of_method = |method: &String| CurveEntry {
        name: method.clone(),
        method: method.clone(),
        preset: panel.preset.clone(),
        set: Vec::new(),
        anchor: panel.anchors.get(method).copied(),
    };
    let own = panel.curves.iter().map(|curve| CurveEntry {
        name: curve.name.clone(),
        method: curve.method.clone(),
        preset: curve.preset.as_ref().or(panel.preset.as_ref()).cloned(),
        set: curve.set.clone(),
        anchor: curve.anchor,
    });
    methods.iter().map(of_method).chain(own).collect()
}

/// Returns a panel with its runs.
fn planned(panel: &PanelEntry, file: &PlanFile, quick: bool) -> Result<Panel<PlannedCurve>> {
    let methods = panel.methods.as_ref().unwrap_or(&file.methods);
    let curves = curves_of(panel, methods);
    check_names("curve", curves.iter().map(|curve| curve.name.as_str()))?;
    if let Some(stray) = panel.anchors.keys().find(|name| !methods.contains(name)) {
        return Err(wrong_usage(format!("anchors: there is no curve of the method {stray}")));
    }
    let seeds = file.quick.seeds.as_ref().filter(|_| quick).unwrap_or(&file.seeds);
    check_names("seed", seeds)?;
    let mut curves_planned = Vec::new();
    for curve in curves {
        let anchor = curve.anchor;
        let runs = seeds.iter().map(|&seed| {
            let settings = settings_of(file, panel, &curve, seed, quick);
            let preset = curve.preset.as_deref();
            PlannedRun::of(&panel.task, preset, &curve.method, seed, settings)
        });
        let sound = anchor.is_none_or(|anchor| (0.0..=1.0).contains(&anchor));
        let runs = if sound {
            runs.collect()
        } else {
            Err(wrong_usage(format!("expected an anchor in [0, 1], found {anchor:?}")))
        };
        let named = |error| wrong_usage(format!("curve {}: {error:#}", curve.name));
        curves_planned.push(PlannedCurve { anchor, runs: runs.map_err(named)?, name: curve.name });
    }
    let first = curves_planned.first().and_then(|curve| curve.runs.first());
    let task = first.map(|run| run.config.task.clone());
    let task = task.ok_or_else(|| wrong_usage("expected a curve, found none"))?;
    let PanelEntry { name, title, .. } = panel;
    Ok(Panel { name: name.clone(), title: title.clone(), task, curves: curves_planned })
}

/// Sets the hashes of the programs of the user's own tasks; each program is read once. Another build of a program may
/// act differently, so its runs are different ones.
fn identify_programs(panels: &mut [Panel<PlannedCurve>]) -> Result<()> {
    let mut known: BTreeMap<PathBuf, Option<String>> = BTreeMap::new();
    for panel in panels {
        let Panel { name, task, curves, .. } = panel;
        let runs = curves.iter_mut().flat_map(|curve| &mut curve.runs);
        for task in runs.map(|run| &mut run.config.task).chain([task]) {
            let Some(program) = task.program.clone() else { continue };
            let sha256 = match known.entry(program) {
                Entry::Occupied(known) => known.get().clone(),
                Entry::Vacant(place) => {
                    let found = description::program_sha256(task)
                        .map_err(|error| wrong_usage(format!("panel {name}: {error:#}")))?;
                    place.insert(found).clone()
                }
            };
            task.program_sha256 = sha256;
        }
    }
    Ok(())
}

/// Returns the settings of a run, from general to specific; those of a quick plan override all others.
fn settings_of(
    PlanFile { set, quick: at_reduced_size, .. }: &PlanFile,
    panel: &PanelEntry,
    curve: &CurveEntry,
    seed: u64,
    quick: bool,
) -> Vec<String> {
    let mut settings = vec![format!("method={}", curve.method), format!("seed={seed}")];
    let steps = |steps| format!("steps={steps}");
    settings.extend(panel.steps.map(steps));
    settings.extend(set.iter().chain(&panel.set).chain(&curve.set).cloned());
    if quick {
        let Quick { steps: fewer, set, method, .. } = at_reduced_size;
        settings.extend(fewer.map(steps));
        let of_method = method.get(&curve.method).into_iter().flatten();
        settings.extend(set.iter().chain(of_method).cloned());
    }
    settings
}

/// Checks that there is at least one name, and each only once.
fn check_names<T: Ord + std::fmt::Display>(
    what: &str,
    names: impl IntoIterator<Item = T>,
) -> Result<()> {
    let mut known = BTreeSet::new();
    for name in names {
        if known.contains(&name) {
            return Err(wrong_usage(format!("expected every {what} once, found {name} again")));
        }
        known.insert(name);
    }
    if known.is_empty() {
        return Err(wrong_usage(format!("expected a {what}, found none")));
    }
    Ok(())
}

/// Checks that the panels and methods that the table `quick` names are in the plan.
fn check_quick(file: &PlanFile) -> Result<()> {
    for name in file.quick.panels.iter().flatten() {
        if !file.panels.iter().any(|panel| panel.name == *name) {
            return Err(wrong_usage(format!("quick: there is no panel {name}")));
        }
    }
    for name in file.quick.method.keys() {
        let listed = file.panels.iter().filter_map(|panel| panel.methods.as_ref()).flatten();
        let own = file.panels.iter().flat_map(|panel| &panel.curves).map(|curve| &curve.method);
        if !file.methods.iter().chain(listed).chain(own).any(|method| method == name) {
            return Err(wrong_usage(format!("quick: there is no curve of the method {name}")));
        }
    }
    Ok(())
}
