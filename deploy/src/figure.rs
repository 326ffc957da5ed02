//! A figure as data: which runs stand for which curve of which picture. Plans make figures
//! (`goalward experiment`), the report draws them (`goalward report`).

use protocol::task::Task;
use run::folder::RunFolder;

/// A figure of the paper, or any comparison: panels of curves, planned or measured.
pub(crate) struct Figure<C = Curve> {
    /// Its name, such as `figure3`.
    pub(crate) name: String,
    /// What it shows.
    pub(crate) title: String,
    /// Its pictures.
    pub(crate) panels: Vec<Panel<C>>,
}

/// A picture: curves of one task in one setting.
pub(crate) struct Panel<C = Curve> {
    /// Its name within the figure.
    pub(crate) name: String,
    /// What it shows.
    pub(crate) title: String,
    /// The task.
    pub(crate) task: Task,
    /// Its curves.
    pub(crate) curves: Vec<C>,
}

/// A method in a setting, over seeds.
pub(crate) struct Curve {
    /// Its name, unique in the panel.
    pub(crate) name: String,
    /// A run for each seed, all of one origin; they need not exist yet.
    pub(crate) runs: Vec<RunFolder>,
    /// Success rate of the authors' published curve at its end, in [0, 1].
    pub(crate) anchor: Option<f64>,
}

impl<C> Figure<C> {
    /// The same figure with what becomes of each curve.
    pub(crate) fn map<D>(self, curve: impl Fn(C) -> D) -> Figure<D> {
        let panel = |Panel { name, title, task, curves }: Panel<C>| {
            let curves = curves.into_iter().map(&curve).collect();
            Panel { name, title, task, curves }
        };
        let panels = self.panels.into_iter().map(panel).collect();
        Figure { name: self.name, title: self.title, panels }
    }
}
