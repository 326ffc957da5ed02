//! A plan as its file has it, `deploy/experiments/*.toml`; nothing in it is checked but its form.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use protocol::dropped::shortened;
use serde::Deserialize;

use terminal::refusal::wrong_usage;

/// Longest reason why a file is no plan, characters.
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
    /// Pictures, the most important first.
    #[serde(default, rename = "panel")]
    pub(super) panels: Vec<PanelEntry>,
    /// What `--quick` changes.
    #[serde(default)]
    pub(super) quick: Quick,
}

/// A picture.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PanelEntry {
    pub(super) name: String,
    pub(super) title: String,
    /// A name, or the path of a task's file.
    pub(super) task: String,
    /// Of the task's file.
    pub(super) preset: Option<String>,
    /// Environment steps; without it those of the task's file.
    pub(super) steps: Option<u64>,
    /// Settings of every curve.
    #[serde(default)]
    pub(super) set: Vec<String>,
    /// Methods instead of the plan's.
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
    /// Instead of the panel's.
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
    /// Only these panels.
    pub(super) panels: Option<Vec<String>>,
    /// Settings laid over everything.
    #[serde(default)]
    pub(super) set: Vec<String>,
    /// Settings laid over those of single methods.
    #[serde(default)]
    pub(super) method: BTreeMap<String, Vec<String>>,
}

impl PlanFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Of wrong usage, in one line, when it is missing or is no plan.
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
