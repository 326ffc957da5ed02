//! The list of runs as browsers get it.

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

/// All runs, newest first, and errors of those that cannot be read.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct List {
    pub(crate) folder: String,
    pub(crate) runs: Vec<Listed>,
    pub(crate) trouble: Vec<String>,
}
