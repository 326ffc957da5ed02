//! How a verb prints its results: as a table for people, or as JSON for programs.

use anyhow::Result;
use serde::Serialize;
use terminal::print::print_line;

/// The flag of every verb that prints results.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(crate) struct OutputFormat {
    /// Prints JSON for programs instead of a table for people.
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl OutputFormat {
    /// Returns whether results are printed as JSON.
    pub(crate) fn is_json(self) -> bool {
        self.json
    }

    /// Prints results as JSON, or as the text that `table` makes of them.
    ///
    /// # Errors
    /// When they cannot be written as JSON.
    pub(crate) fn print<T: Serialize>(
        self,
        results: &T,
        table: impl FnOnce(&T) -> String,
    ) -> Result<()> {
        let text = if self.json { serde_json::to_string_pretty(results)? } else { table(results) };
        print_line(text.trim_end());
        Ok(())
    }
}
