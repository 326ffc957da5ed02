//! Pictures of grids: an observation, and heat maps of the proximity function with the agent on every cell (the paper's
//! Figure 4d). A task's labels name the classes of cells.

use maud::{Markup, html};
use plotters::style::colors::colormaps::ViridisRGB;
use protocol::task::{ObservationSpec, Task};

use crate::programs::Estimates;

/// The classes of cells in a grid in which the agent can be placed on any free cell.
pub struct Classes {
    width: usize,
    empty: u8,
    wall: u8,
    goal: u8,
    agent: u8,
}

impl Classes {
    /// Returns the classes of a task; `None` if it is not a grid or its labels do not name all four.
    pub fn of(task: &Task) -> Option<Classes> {
        let ObservationSpec::Cells { width, .. } = task.observation else { return None };
        let class = |name| task.labels.iter().position(|label| label == name);
        let [empty, wall, goal, agent] = ["empty", "wall", "goal", "agent"].map(class);
        let as_byte = |class: Option<usize>| u8::try_from(class?).ok();
        Some(Classes {
            width,
            empty: as_byte(empty)?,
            wall: as_byte(wall)?,
            goal: as_byte(goal)?,
            agent: as_byte(agent)?,
        })
    }
}

/// Side length of a cell, units.
const CELL: usize = 10;

/// Position on the color scale for a number that is the same everywhere.
const CONSTANT: f64 = 0.5;

const WALL_COLOR: &str = "#555B66";
const GOAL_COLOR: &str = "#009E73";
const AGENT_COLOR: &str = "#D55E00";
/// Number of different colors for classes without a fixed color.
const OTHER_CLASSES: u8 = 12;

const EMPTY_COLOR: &str = "#F4F6F8";

/// Observations with the agent on each free cell of an episode's grid, and these cells.
pub struct Everywhere {
    /// The grid without the agent.
    cells: Vec<u8>,
    /// Number of cells in a row.
    width: usize,
    /// The free cells, each by its index in the observation.
    free: Vec<usize>,
    goal: u8,
    agent: u8,
}

impl Everywhere {
    /// Makes them from the first observation of an episode, in which the agent does not cover the goal.
    pub fn of(observation: &[u8], classes: &Classes) -> Everywhere {
        let &Classes { width, empty, wall, goal, agent } = classes;
        let without_agent = |cell: &u8| if *cell == agent { empty } else { *cell };
        let cells: Vec<u8> = observation.iter().map(without_agent).collect();
        let free = (0..cells.len()).filter(|&place| cells[place] != wall).collect();
        Everywhere { cells, width, free, goal, agent }
    }

    /// Returns the cells that the agent is placed on, each by its index in the observation.
    pub fn places(&self) -> &[usize] {
        &self.free
    }

    /// Returns the observations, one after another.
    pub fn observations(&self) -> Vec<u8> {
        let with_agent = |&place: &usize| {
            let mut cells = self.cells.clone();
            cells[place] = self.agent;
            cells
        };
        self.free.iter().flat_map(with_agent).collect()
    }

    /// Draws proximity and uncertainty as two heat maps side by side.
    pub(crate) fn picture(&self, estimates: &Estimates) -> Markup {
        let side = self.width * CELL;
        let (width, height) = (2 * side + 130, side + 34);
        html! {
            svg xmlns="http://www.w3.org/2000/svg" width=(2 * width) height=(2 * height)
                viewBox=(format!("0 0 {width} {height}")) font-family="sans-serif" {
                rect width=(width) height=(height) fill="#FFFFFF" {}
                (self.map("proximity", &estimates.proximity, 4))
                (self.map("uncertainty", &estimates.uncertainty, side + 70))
            }
        }
    }

    /// Draws a heat map. The color scale leaves out the goal's own cell, whose proximity is far above its neighbors'.
    fn map(&self, name: &str, numbers: &[f64], left: usize) -> Markup {
        let others = self.free.iter().zip(numbers);
        let others = others.filter(|&(&place, _)| self.cells[place] != self.goal);
        let (low, high) = others
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, &one)| {
                (low.min(one), high.max(one))
            });
        let ends = ends(low, high);
        let shade = |number: f64| match ends {
            Some(_) => ((number - low) / (high - low)).clamp(0.0, 1.0),
            None => CONSTANT,
        };
        let side = self.width * CELL;
        html! {
            g transform=(format!("translate({left} 24)")) shape-rendering="crispEdges" {
                text x="0" y="-8" font-size="12" fill="#000000" { (name) }
                (background(side, self.cells.len() / self.width * CELL, WALL_COLOR))
                @for (&place, &number) in self.free.iter().zip(numbers) {
                    (self.cell(place, &color(shade(number))))
                }
                @for &place in self.free.iter().filter(|&&place| self.cells[place] == self.goal) {
                    (ring(place % self.width, place / self.width))
                }
                (legend(side + 8, low, ends.as_ref()))
            }
        }
    }

    fn cell(&self, place: usize, color: &str) -> Markup {
        square(place % self.width, place / self.width, color)
    }
}

/// Draws an observation; `labels` name the classes.
pub(crate) fn frame(observation: &[u8], width: usize, labels: &[String]) -> Markup {
    let place = |&(place, _): &(usize, &u8)| (place % width, place / width);
    let [sides, heights] = [width * CELL, observation.len() / width * CELL];
    html! {
        svg x="0" y="0" width="100%" height="100%" viewBox=(format!("0 0 {sides} {heights}"))
            shape-rendering="crispEdges" {
            (background(sides, heights, WALL_COLOR))
            @for cell in observation.iter().enumerate() {
                @let (x, y) = place(&cell);
                @let label = labels.get(usize::from(*cell.1)).map(String::as_str);
                @match label {
                    Some("wall") => {}
                    Some("goal") => { (square(x, y, GOAL_COLOR)) }
                    Some("agent") => { (square(x, y, AGENT_COLOR)) }
                    Some("empty") => { (square(x, y, EMPTY_COLOR)) }
                    _ => { (square(x, y, &color(f64::from(*cell.1 % OTHER_CLASSES) / f64::from(OTHER_CLASSES)))) }
                }
            }
        }
    }
}

fn background(width: usize, height: usize, color: &str) -> Markup {
    html! { rect width=(width) height=(height) fill=(color) {} }
}

fn square(x: usize, y: usize, color: &str) -> Markup {
    html! { rect x=(x * CELL) y=(y * CELL) width=(CELL) height=(CELL) fill=(color) {} }
}

/// Draws the mark of the goal.
fn ring(x: usize, y: usize) -> Markup {
    let [x, y] = [x, y].map(|place| place * CELL + CELL / 2);
    html! { circle cx=(x) cy=(y) r="3" fill="none" stroke=(AGENT_COLOR) stroke-width="2"
    shape-rendering="auto" {} }
}

/// Formats the smallest and the largest number with as many digits as they need to differ; returns `None` if they look
/// equal even with six decimal places.
fn ends(low: f64, high: f64) -> Option<[String; 2]> {
    let short = [low, high].map(terminal::numbers::number);
    let long = || (4..=6).map(|digits| [low, high].map(|number| format!("{number:.digits$}")));
    std::iter::once(short).chain(long()).find(|[low, high]| low != high)
}

/// Draws the color scale with the numbers at its ends, or the single color with its number.
fn legend(left: usize, low: f64, ends: Option<&[String; 2]>) -> Markup {
    let steps = 24;
    html! {
        g transform=(format!("translate({left} 0)")) {
            @if let Some([low, high]) = ends {
                @for step in 0..steps {
                    @let share = 1.0 - (step as f64 + 0.5) / f64::from(steps);
                    rect y=(step * 5) width="8" height="5" fill=(color(share)) {}
                }
                (number(9, high))
                (number(steps * 5, low))
            } @else {
                rect width="8" height="8" fill=(color(CONSTANT)) {}
                (number(8, &terminal::numbers::number(low)))
                (number(19, "constant"))
            }
        }
    }
}

fn number(y: i32, text: &str) -> Markup {
    html! { text x="12" y=(y) font-size="9" fill="#000000" { (text) } }
}

/// Returns the color for `share` in [0, 1]: viridis, lighter for larger values.
fn color(share: f64) -> String {
    let color = ViridisRGB::get_color(share);
    format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLASSES: Classes = Classes { width: 2, empty: 0, wall: 1, goal: 2, agent: 3 };

    #[test]
    fn classes_are_known_by_their_labels() {
        let mut task = run::tasks::configuration("navigation", None, &[]).unwrap().task;
        let found = Classes::of(&task).unwrap();
        assert_eq!((found.width, found.wall, found.agent), (19, 1, 3));
        task.labels.clear();
        assert!(Classes::of(&task).is_none());
    }

    #[test]
    fn the_agent_is_put_on_every_free_cell() {
        let everywhere = Everywhere::of(&[1, 3, 2, 0], &CLASSES);
        assert_eq!(everywhere.observations(), [1, 3, 2, 0, 1, 0, 3, 0, 1, 0, 2, 3]);
    }

    #[test]
    fn the_lightest_cell_is_the_nearest() {
        let everywhere = Everywhere::of(&[1, 3, 2, 0], &CLASSES);
        let estimates =
            Estimates { proximity: vec![0.1, 0.9, 0.5], uncertainty: vec![0.0, 0.0, 0.0] };
        let picture = everywhere.picture(&estimates).into_string();
        let lightest =
            format!(r#"<rect x="0" y="10" width="10" height="10" fill="{}">"#, color(1.0));
        assert!(picture.contains(&lightest), "{picture}");
        assert!(!picture.contains("NaN"), "{picture}");
    }

    #[test]
    fn numbers_that_are_the_same_everywhere_have_one_color_and_one_number() {
        let everywhere = Everywhere::of(&[1, 3, 2, 0], &CLASSES);
        let picture = |proximity: Vec<f64>| {
            let estimates = Estimates { proximity, uncertainty: vec![0.1, 0.2, 0.3] };
            everywhere.picture(&estimates).into_string()
        };
        let constant = picture(vec![0.371, 0.9, 0.371_000_01]);
        assert_eq!(constant.matches(">0.371<").count(), 1, "{constant}");
        assert!(constant.contains(">constant<"), "{constant}");
        // Numbers that differ only in later digits are shown with more digits.
        let close = picture(vec![0.3711, 0.9, 0.3713]);
        assert!(close.contains(">0.3711<") && close.contains(">0.3713<"), "{close}");
    }
}
