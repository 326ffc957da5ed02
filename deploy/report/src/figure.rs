//! A figure as data: which runs belong to which curve of which panel. Plans define figures (`goalward experiment`), the
//! report draws them (`goalward report`).

use protocol::task::Task;
use run::folder::RunFolder;

/// A figure of the paper, or any comparison: panels of curves, planned or measured.
#[derive(Debug)]
pub struct Figure<C = Curve> {
    /// Its name, such as `figure3`.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Its panels.
    pub panels: Vec<Panel<C>>,
}

/// A panel: curves of one task in one setting.
#[derive(Debug)]
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
    pub fn map<D>(&self, mut curve: impl FnMut(&C) -> D) -> Figure<D> {
        let mut panel = |panel: &Panel<C>| Panel {
            name: panel.name.clone(),
            title: panel.title.clone(),
            task: panel.task.clone(),
            curves: panel.curves.iter().map(&mut curve).collect(),
        };
        let panels = self.panels.iter().map(&mut panel).collect();
        Figure { name: self.name.clone(), title: self.title.clone(), panels }
    }
}
