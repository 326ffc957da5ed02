//! A figure as data: which runs belong to which curve of which panel. Plans define figures (`goalward experiment`), the
//! report draws them (`goalward report`).

use protocol::task::Task;
use run::folder::RunFolder;

/// A figure of the paper, or any comparison: panels of curves, planned or measured.
pub struct Figure<C = Curve> {
    /// Its name, such as `figure3`.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Its panels.
    pub panels: Vec<Panel<C>>,
}

/// A panel: curves of one task in one setting.
pub struct Panel<C = Curve> {
    /// Its name within the figure.
    pub name: String,
    /// Its title.
    pub title: String,
    /// The task.
    pub task: Task,
    /// Its curves.
    pub curves: Vec<C>,
}

/// A method in a setting, over seeds.
pub struct Curve {
    /// Its name, unique in the panel.
    pub name: String,
    /// A run for each seed, all of one origin; they need not exist yet.
    pub runs: Vec<RunFolder>,
    /// Success rate that the authors published, in [0, 1].
    pub anchor: Option<f64>,
}

impl<C> Figure<C> {
    /// Returns the same figure with `curve` applied to each curve.
    pub fn map<D>(self, curve: impl Fn(C) -> D) -> Figure<D> {
        let panel = |Panel { name, title, task, curves }: Panel<C>| {
            let curves = curves.into_iter().map(&curve).collect();
            Panel { name, title, task, curves }
        };
        let panels = self.panels.into_iter().map(panel).collect();
        Figure { name: self.name, title: self.title, panels }
    }
}
