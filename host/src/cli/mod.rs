//! The command line: one file per subcommand, each a struct of arguments and a `run`.
//!
//! Exit codes: 0 done, 1 could not be done, 2 bad input (nothing was written).

mod browser;
pub mod bundled;
mod closed;
pub mod explore;
mod files;
pub mod import;
pub mod inspect;
mod level;
pub mod live;
pub mod localize;
mod normals;
pub mod optimize;
pub mod replay;
pub mod reproduce;
pub mod simulate;
pub mod slam;
mod terminal;
mod units;
pub mod view_address;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Tactile SLAM: the shape of an unknown object and its pose, from fingertip contacts alone.
#[derive(Debug, Parser)]
#[command(
    name = "tactile",
    version,
    propagate_version = true,
    arg_required_else_help = true,
    after_help = "Example: tactile slam   (the bundled recording; results in out/)"
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Say nothing but results asked for, warnings and errors
    #[arg(long, short, global = true)]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Slam(slam::SlamArgs),
    Simulate(simulate::SimulateArgs),
    Explore(explore::ExploreArgs),
    Import(import::ImportArgs),
    Live(live::LiveArgs),
    Localize(localize::LocalizeArgs),
    Optimize(optimize::OptimizeArgs),
    Replay(replay::ReplayArgs),
    Inspect(inspect::InspectArgs),
    Reproduce(reproduce::ReproduceArgs),
}

impl Cli {
    /// Runs the subcommand and prints what went wrong.
    pub fn run(&self) -> ExitCode {
        terminal::silence(self.quiet);
        let outcome = match &self.command {
            Command::Slam(args) => slam::run(args),
            Command::Simulate(args) => simulate::run(args),
            Command::Explore(args) => explore::run(args),
            Command::Import(args) => import::run(args),
            Command::Live(args) => live::run(args),
            Command::Localize(args) => localize::run(args),
            Command::Optimize(args) => optimize::run(args),
            Command::Replay(args) => replay::run(args),
            Command::Inspect(args) => inspect::run(args),
            Command::Reproduce(args) => reproduce::run(args),
        };
        match outcome {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                terminal::fail(&error);
                ExitCode::from(error.code())
            }
        }
    }
}

/// What a subcommand can end with.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The input is wrong: exit code 2.
    #[error("{0}")]
    Input(String),
    /// The input is right but the work could not be done: exit code 1.
    #[error("{0}")]
    Failure(String),
}

impl Error {
    /// Bad input, in the words of a library error.
    pub fn input(error: impl std::fmt::Display) -> Self {
        Error::Input(error.to_string())
    }

    /// Failed work, in the words of a library error.
    pub fn failure(error: impl std::fmt::Display) -> Self {
        Error::Failure(error.to_string())
    }

    /// The process' exit code.
    pub fn code(&self) -> u8 {
        match self {
            Error::Input(_) => 2,
            Error::Failure(_) => 1,
        }
    }
}
