//! A figure as data: which runs stand for which curve of which picture. Plans make figures
//! (`goalward experiment`), the report draws them (`goalward report`).

use protocol::run::RunFolder;
use protocol::task::Task;

/// A figure of the paper, or any comparison: panels of curves.
pub(crate) struct Figure {
    /// Its name, such as `figure3`.
    pub(crate) name: String,
    /// What it shows.
    pub(crate) title: String,
    /// Its pictures.
    pub(crate) panels: Vec<Panel>,
}

/// A picture: curves of one task in one setting.
pub(crate) struct Panel {
    /// Its name within the figure.
    pub(crate) name: String,
    /// What it shows.
    pub(crate) title: String,
    /// The task.
    pub(crate) task: Task,
    /// Its curves.
    pub(crate) curves: Vec<Curve>,
}

/// A method in a setting, over seeds.
pub(crate) struct Curve {
    /// Its name, unique in the panel.
    pub(crate) name: String,
    /// A run for each seed; they need not exist yet.
    pub(crate) runs: Vec<RunFolder>,
    /// Success rate of the authors' published curve at its end, in [0, 1].
    pub(crate) anchor: Option<f64>,
}
