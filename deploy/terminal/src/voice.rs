//! How much `goalward` says, and whether in colors: the flags of every verb.

use std::sync::atomic::{AtomicBool, Ordering};

use anstream::ColorChoice;

static IS_QUIET: AtomicBool = AtomicBool::new(false);

/// Flags of every verb.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Voice {
    /// Says nothing but results and errors: no progress, no remarks.
    #[arg(short, long, global = true, help_heading = HEADING)]
    quiet: bool,
    /// Says which programs are started; twice, what the bus has to say, too.
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "quiet")]
    #[arg(help_heading = HEADING)]
    verbose: u8,
    /// Colors; by default on terminals that have them, unless NO_COLOR is set.
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto", help_heading = HEADING)]
    #[arg(hide_default_value = true)]
    color: Color,
}

/// What the flags stand under in help.
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
    /// Makes them hold for the process; gives the level of its diagnostics.
    pub fn begin(self) -> &'static str {
        IS_QUIET.store(self.quiet, Ordering::Relaxed);
        match self.color {
            // `anstream` would color it where CI is set.
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

/// Whether only results and errors are said.
pub(crate) fn is_quiet() -> bool {
    IS_QUIET.load(Ordering::Relaxed)
}
