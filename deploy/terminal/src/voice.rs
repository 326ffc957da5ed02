//! The flags of every verb: how much `goalward` prints, and whether in color.

use std::sync::atomic::{AtomicBool, Ordering};

use anstream::ColorChoice;

static IS_QUIET: AtomicBool = AtomicBool::new(false);

/// Flags of every verb.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Voice {
    /// Prints only results and errors, no progress or remarks.
    #[arg(short, long, global = true, help_heading = HEADING)]
    quiet: bool,
    /// Prints which programs are started; given twice, also prints messages about the bus.
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "quiet")]
    #[arg(help_heading = HEADING)]
    verbose: u8,
    /// Colors; by default on terminals that have them, unless NO_COLOR is set.
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto", help_heading = HEADING)]
    #[arg(hide_default_value = true)]
    color: Color,
}

/// Heading of the flags in help texts.
const HEADING: &str = "Output";

/// When there are colors.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Color {
    /// On a terminal.
    Auto,
    Always,
    Never,
}

impl Voice {
    /// Applies the flags to the process; returns the level of its diagnostics.
    pub fn begin(self) -> &'static str {
        IS_QUIET.store(self.quiet, Ordering::Relaxed);
        match self.color {
            // `anstream` would use colors there if the variable CI is set.
            Color::Auto if std::env::var_os("TERM").is_some_and(|term| term == "dumb") => {
                ColorChoice::Never.write_global();
            }
            Color::Auto => {}
            Color::Always => ColorChoice::Always.write_global(),
            Color::Never => ColorChoice::Never.write_global(),
        }
        match self.verbose {
            0 => "error",
            1 => "info",
            _ => "debug",
        }
    }
}

/// Returns whether only results and errors are printed.
pub fn is_quiet() -> bool {
    IS_QUIET.load(Ordering::Relaxed)
}
