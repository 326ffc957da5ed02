//! All pictures of a report. Each is an SVG file and is also embedded in the page.

use std::collections::BTreeMap;

use anyhow::Result;
use run::tasks::place;

use crate::chart;
use crate::episode;
use crate::estimate;
use crate::grid::{Classes, Everywhere};
use crate::learning::{self, Against};
use crate::measured::{Measured, MeasuredFigure, MeasuredPanel};
use crate::palette::Palette;
use crate::programs::ReportPrograms;

/// Size of a chart against environment steps, pixels.
const SIZE: [u32; 2] = [720, 400];

/// Size of a chart against wall time, pixels.
const SMALL_SIZE: [u32; 2] = [720, 300];

/// The pictures of a report by the names of their files.
pub(crate) struct Pictures {
    files: BTreeMap<String, String>,
    /// Episodes: name of the picture and caption, or why there is none.
    episodes: Vec<Result<(String, String), String>>,
    /// Heat maps by the stems of their panels: the caption, or why there is none.
    heats: BTreeMap<String, Result<String, String>>,
}

impl Pictures {
    /// Draws the pictures of figures. If a run's programs fail, the pictures that need them are left out, and the
    /// report says why.
    ///
    /// # Errors
    /// When a chart cannot be drawn.
    pub(crate) fn of(
        figures: &[MeasuredFigure],
        programs: &dyn ReportPrograms,
    ) -> Result<Pictures> {
        let mut pictures =
            Pictures { files: BTreeMap::new(), episodes: Vec::new(), heats: BTreeMap::new() };
        let panels = || figures.iter().flat_map(|figure| &figure.panels);
        let names = |panel: &'_ MeasuredPanel| -> Vec<String> {
            panel.curves.iter().map(|curve| curve.name.clone()).collect()
        };
        let names: Vec<Vec<String>> = panels().map(names).collect();
        let names: Vec<Vec<&str>> =
            names.iter().map(|names| names.iter().map(String::as_str).collect()).collect();
        let palette = Palette::of(&names);
        for figure in figures {
            for panel in &figure.panels {
                let stem = stem(&figure.name, &panel.name);
                pictures.draw_learning(&stem, panel, &palette)?;
                pictures.draw_heat(stem, panel, programs);
            }
        }
        let mut runs: Vec<&Measured> = panels().flat_map(asked).collect();
        runs.sort_by_key(|run| (place(&run.config.task.name), &run.config.task.name));
        runs.dedup_by(|run, before| run.config.task.name == before.config.task.name);
        runs.into_iter().for_each(|run| pictures.draw_episode(run, programs));
        Ok(pictures)
    }

    /// Returns the name and text of every file.
    pub(crate) fn files(&self) -> impl Iterator<Item = (&str, &str)> {
        self.files.iter().map(|(name, text)| (name.as_str(), text.as_str()))
    }

    /// Returns the learning curves of a panel.
    pub(crate) fn learning(&self, figure: &str, panel: &str, against: Against) -> Option<&str> {
        self.text(&learning_file(&stem(figure, panel), against))
    }

    /// Returns the heat map of a panel and its caption, or why it could not be drawn; `None` if the panel has none.
    pub(crate) fn heat(&self, figure: &str, panel: &str) -> Option<Result<(&str, &str), &str>> {
        let stem = stem(figure, panel);
        let caption = self.heats.get(&stem)?.as_ref();
        let with_text = |caption| (self.drawn(&heat_file(&stem)), caption);
        Some(caption.map(String::as_str).map_err(String::as_str).map(with_text))
    }

    /// Returns picture and caption of each episode, or why it could not be drawn.
    pub(crate) fn episodes(&self) -> impl Iterator<Item = Result<(&str, &str), &str>> {
        self.episodes.iter().map(|episode| match episode {
            Ok((name, caption)) => Ok((self.drawn(name), caption.as_str())),
            Err(reason) => Err(reason.as_str()),
        })
    }

    fn text(&self, name: &str) -> Option<&str> {
        self.files.get(name).map(String::as_str)
    }

    fn drawn(&self, name: &str) -> &str {
        self.text(name).expect("a caption is kept together with its file")
    }

    fn draw_learning(
        &mut self,
        stem: &str,
        panel: &MeasuredPanel,
        palette: &Palette,
    ) -> Result<()> {
        if panel.curves.iter().all(|curve| curve.runs.is_empty()) {
            return Ok(());
        }
        for (against, size) in [(Against::Steps, SIZE), (Against::Time, SMALL_SIZE)] {
            let drawn = chart::draw(&[learning::chart(panel, palette, against)], size)?;
            self.files.insert(learning_file(stem, against), drawn);
        }
        Ok(())
    }

    fn draw_heat(&mut self, stem: String, panel: &MeasuredPanel, programs: &dyn ReportPrograms) {
        let Some(classes) = Classes::of(&panel.task) else { return };
        let Some(run) = asked(panel).into_iter().next() else { return };
        let drawn = heat(run, &classes, programs).map(|drawn| {
            self.files.insert(heat_file(&stem), drawn);
            format!(
                "Proximity and uncertainty that the trained ensemble of {} has for the agent on \
                 every free cell. The ring marks the goal, whose own cell may be beyond the scale.",
                run.name()
            )
        });
        self.heats.insert(stem, drawn.map_err(|error| format!("{error:#}")));
    }

    fn draw_episode(&mut self, run: &Measured, programs: &dyn ReportPrograms) {
        let drawn = episode::along(&run.folder, &run.config, programs).map(|along| {
            let name = format!("episode-{}.svg", run.config.task);
            self.files.insert(name.clone(), along.picture);
            (name, format!("{}, {}: {}", run.config.task, run.name(), along.caption))
        });
        self.episodes.push(drawn.map_err(|error| format!("{}: {error:#}", run.name())));
    }
}

/// Returns the finished runs of a panel whose proximity function can be queried.
fn asked(panel: &MeasuredPanel) -> Vec<&Measured> {
    let runs = panel.curves.iter().flat_map(|curve| &curve.runs);
    runs.filter(|run| run.is_finished() && estimate::has_proximity(&run.config)).collect()
}

fn heat(run: &Measured, classes: &Classes, programs: &dyn ReportPrograms) -> Result<String> {
    let episodes = estimate::episodes(&run.folder, &run.config, programs)?;
    let bytes = run.config.task.spec().observation.bytes();
    let first = episodes.first().map(|episode| &episode.trajectory.observations()[..bytes]);
    let everywhere = Everywhere::of(first.unwrap_or(&[]), classes);
    let estimates = programs.estimate(&run.folder, &everywhere.observations())?;
    Ok(everywhere.picture(&estimates).into_string())
}

/// Returns the stem of the names of a panel's files. Neither part has a `+`, so files of different panels of a figure
/// have different names.
fn stem(figure: &str, panel: &str) -> String {
    format!("{}+{panel}", plain(figure))
}

/// Returns a name with `-` for each character that file names and addresses may not have.
pub(crate) fn plain(name: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    name.chars().map(|letter| if is_plain(letter) { letter } else { '-' }).collect()
}

fn learning_file(stem: &str, against: Against) -> String {
    match against {
        Against::Steps => format!("{stem}.svg"),
        Against::Time => format!("{stem}+time.svg"),
    }
}

fn heat_file(stem: &str) -> String {
    format!("{stem}+proximity.svg")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_two_panels_have_two_names() {
        let files = |panel: &str| {
            let stem = stem("figure 1", panel);
            let learning = [Against::Steps, Against::Time].map(|axis| learning_file(&stem, axis));
            [learning.to_vec(), vec![heat_file(&stem)]].concat()
        };
        let panels = ["half", "half-time", "half-proximity", "a_1", "a-1", "a.1"];
        let names: Vec<String> = panels.into_iter().flat_map(files).collect();
        let different: std::collections::BTreeSet<&String> = names.iter().collect();
        assert_eq!(different.len(), 18, "{names:?}");
        assert_eq!(names[0], "figure-1+half.svg");
    }
}
