//! A plan as it is in its file, `deploy/experiments/*.toml`; only its form is checked here.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use protocol::dropped::shortened;
use serde::Deserialize;

use terminal::refusal::wrong_usage;

/// Longest reason given for refusing a plan, characters.
pub(super) const REASON_CHARS: usize = 500;

/// A plan.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlanFile {
    /// What the figure shows.
    pub(super) title: String,
    /// Seeds of every curve.
    pub(super) seeds: Vec<u64>,
    /// Methods of every panel, each a curve.
    #[serde(default)]
    pub(super) methods: Vec<String>,
    /// Settings of every panel.
    #[serde(default)]
    pub(super) set: Vec<String>,
    /// Panels, the most important first.
    #[serde(default, rename = "panel")]
    pub(super) panels: Vec<PanelEntry>,
    /// What `--quick` changes.
    #[serde(default)]
    pub(super) quick: Quick,
}

/// A panel, which is one picture.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PanelEntry {
    pub(super) name: String,
    pub(super) title: String,
    /// Name of the task, or path of the task's file.
    pub(super) task: String,
    /// Preset of the task's file.
    pub(super) preset: Option<String>,
    /// Environment steps; if `None`, those of the task's file.
    pub(super) steps: Option<u64>,
    /// Settings of every curve.
    #[serde(default)]
    pub(super) set: Vec<String>,
    /// Methods that replace the plan's.
    pub(super) methods: Option<Vec<String>>,
    /// Success rates of published curves, by method.
    #[serde(default)]
    pub(super) anchors: BTreeMap<String, f64>,
    /// Curves with settings of their own, beside the methods.
    #[serde(default, rename = "curve")]
    pub(super) curves: Vec<CurveEntry>,
}

/// A curve with settings of its own.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CurveEntry {
    pub(super) name: String,
    pub(super) method: String,
    /// Preset that replaces the panel's.
    pub(super) preset: Option<String>,
    #[serde(default)]
    pub(super) set: Vec<String>,
    pub(super) anchor: Option<f64>,
}

/// What `--quick` changes.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Quick {
    pub(super) steps: Option<u64>,
    pub(super) seeds: Option<Vec<u64>>,
    /// Panels to keep; all if `None`.
    pub(super) panels: Option<Vec<String>>,
    /// Settings that override those of the plan.
    #[serde(default)]
    pub(super) set: Vec<String>,
    /// Settings by method, which override all others.
    #[serde(default)]
    pub(super) method: BTreeMap<String, Vec<String>>,
}

impl PlanFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Wrong usage, in one line, when the file is missing or is no plan.
    pub(super) fn read(path: &Path) -> Result<PlanFile> {
        let shown = path.display();
        let text = std::fs::read_to_string(path)
            .map_err(|error| wrong_usage(format!("expected a plan in {shown}: {error}")))?;
        toml::from_str(&text).map_err(|error| {
            let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
            let line = before.matches('\n').count() + 1;
            let message = shortened(&error.message().replace('\n', " "), REASON_CHARS);
            wrong_usage(format!("{shown}, line {line}: {message}"))
        })
    }
}
