//! The command line `tactile`.

use std::process::ExitCode;

use clap::Parser;
use tactile_host::cli::Cli;

fn main() -> ExitCode {
    Cli::parse().run()
}
