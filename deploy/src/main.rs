//! The command `goalward`.

use std::process::ExitCode;

fn main() -> ExitCode {
    deploy::main()
}
