//! Runs in a list, as browsers get them.

use run::overview::Overview;
use serde::Serialize;

/// A run in the list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Listed {
    pub(crate) id: String,
    /// Seconds since 1970.
    pub(crate) begun: u64,
    #[serde(flatten)]
    pub(crate) overview: Overview,
}

/// All runs, newest first, and what keeps others from being among them.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct List {
    pub(crate) folder: String,
    pub(crate) runs: Vec<Listed>,
    pub(crate) trouble: Vec<String>,
}
