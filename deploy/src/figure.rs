//! Figures: curves of runs side by side, as `goalward experiment` plans them and `goalward report`
//! draws them.
//!
//! Runs that do not exist or are not finished may be listed; whoever reads a figure shows what there
//! is and says what is missing.

use protocol::run::RunFolder;
use protocol::task::Task;

/// A figure of the paper, or any comparison: panels of curves.
pub(crate) struct Figure {
    /// Short name, of a file.
    pub(crate) name: String,
    /// What it shows.
    pub(crate) title: String,
    /// Its pictures.
    pub(crate) panels: Vec<Panel>,
}

/// A picture: curves of one task in one setting.
pub(crate) struct Panel {
    /// Short name, of a file.
    pub(crate) name: String,
    /// What it shows.
    pub(crate) title: String,
    /// The task of all its runs.
    pub(crate) task: Task,
    /// Its curves.
    pub(crate) curves: Vec<Curve>,
}

/// A method in a setting, over seeds.
pub(crate) struct Curve {
    /// What it is called in the legend.
    pub(crate) name: String,
    /// A run for each seed.
    pub(crate) runs: Vec<RunFolder>,
    /// Success rate of the authors' published curve at its end, in [0, 1].
    pub(crate) anchor: Option<f64>,
}
