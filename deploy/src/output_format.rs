//! How a verb prints its results: as a table for people, or as JSON for programs.

use anyhow::Result;
use serde::Serialize;
use terminal::print::print_line;

/// The flag of every verb that prints figures.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(crate) struct Figures {
    /// Prints JSON for programs instead of a table for people.
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Figures {
    /// Returns whether figures are printed as JSON.
    pub(crate) fn are_json(self) -> bool {
        self.json
    }

    /// Prints figures as JSON, or as the text that `table` makes of them.
    ///
    /// # Errors
    /// When they cannot be written as JSON.
    pub(crate) fn print<T: Serialize>(
        self,
        figures: &T,
        table: impl FnOnce(&T) -> String,
    ) -> Result<()> {
        let text = if self.json { serde_json::to_string_pretty(figures)? } else { table(figures) };
        print_line(text.trim_end());
        Ok(())
    }
}
