//! Styles of curves: the same in all pictures of a report, and different within a picture as far as styles last.

use std::collections::{BTreeMap, BTreeSet};

use crate::chart::{COLORS, Marker, Style};

/// The name of the curve that has the first style in every report.
const OURS: &str = "goal-proximity";

/// Styles of curves by their names.
pub(crate) struct Palette {
    styles: BTreeMap<String, Style>,
}

impl Palette {
    /// Assigns a style to every curve name; `panels` has the names of each panel's curves. Earlier names get plainer
    /// styles. Names in the same panel get different colors as long as there are enough.
    pub(crate) fn of(panels: &[Vec<&str>]) -> Palette {
        let all = Marker::ALL
            .into_iter()
            .flat_map(|marker| COLORS.into_iter().map(move |color| Style { color, marker }));
        let all: Vec<Style> = all.collect();
        let mut styles: BTreeMap<String, Style> = BTreeMap::new();
        for name in std::iter::once(&OURS).chain(panels.iter().flatten()) {
            if styles.contains_key(*name) {
                continue;
            }
            let beside: BTreeSet<&str> = panels
                .iter()
                .filter(|panel| panel.contains(name))
                .flat_map(|panel| panel.iter().copied())
                .collect();
            let met: Vec<Style> =
                beside.iter().filter_map(|other| styles.get(*other).copied()).collect();
            let is_unused = |style: &&Style| styles.values().all(|used| used != *style);
            let other_color = |style: &&Style| met.iter().all(|used| used.color != style.color);
            let other_style = |style: &&Style| met.iter().all(|used| used != *style);
            let chosen = all
                .iter()
                .find(|style| is_unused(style) && other_color(style))
                .or_else(|| all.iter().find(|style| other_color(style)))
                .or_else(|| all.iter().find(other_style))
                .unwrap_or(&all[0]);
            styles.insert((*name).to_owned(), *chosen);
        }
        Palette { styles }
    }

    /// Returns the style of a curve.
    pub(crate) fn style(&self, name: &str) -> Style {
        let plain = Style { color: COLORS[0], marker: Marker::None };
        self.styles.get(name).copied().unwrap_or(plain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_of_a_panel_differ() {
        let sweep: Vec<String> = (0..9).map(|number| format!("lambda {number}")).collect();
        let mut last = vec![OURS];
        last.extend(sweep.iter().map(String::as_str));
        let panels = [vec!["gail", OURS], vec![OURS, "bc", "linear"], last.clone()];
        let palette = Palette::of(&panels);
        for panel in &panels {
            let styles: Vec<Style> = panel.iter().map(|name| palette.style(name)).collect();
            for (place, style) in styles.iter().enumerate() {
                assert!(!styles[..place].contains(style), "{panel:?}: {styles:?}");
            }
        }
        // As long as there are enough colors, no two curves share one.
        let colors = last[..7].iter().map(|name| palette.style(name).color);
        assert!(
            colors
                .clone()
                .enumerate()
                .all(|(place, color)| { colors.clone().take(place).all(|before| before != color) })
        );
        assert_eq!(palette.style(OURS), Style { color: COLORS[0], marker: Marker::None });
    }
}
