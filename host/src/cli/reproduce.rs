//! `tactile reproduce`: the thesis' figures and ours.

use clap::{Args, ValueEnum};

use crate::cli::{Error, say};
use crate::experiment::{Table, data, known_pose, memory, push, tracking};

/// Repeat an experiment: the thesis' number, or our goal, beside ours.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  tactile reproduce figure-2.7 --seeds 20")]
pub struct ReproduceArgs {
    /// Which
    #[arg(value_enum)]
    name: Name,
    /// How many seeds, from 0 on
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// Experiments on offer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Name {
    /// Shape error against the number of contacts at known poses
    #[value(name = "figure-2.7")]
    Figure2_7,
    /// Shape and pose error against motion noise, bootstrap filter
    #[value(name = "figure-3.12")]
    Figure3_12,
    /// Shape error on the recorded pushes with motion-captured poses
    Push,
    /// What bounded memory costs a board
    Memory,
    /// All of them
    All,
}

/// Runs the subcommand.
///
/// # Errors
/// Missing recordings.
pub fn run(args: &ReproduceArgs) -> Result<(), Error> {
    if args.name == Name::Memory {
        let table = memory::run(args.seeds).map_err(Error::failure)?;
        if args.json {
            say(serde_json::to_string_pretty(&table).map_err(Error::failure)?);
        } else {
            say(&table);
        }
        return Ok(());
    }
    let names = match args.name {
        Name::All => vec![Name::Figure2_7, Name::Figure3_12, Name::Push],
        one => vec![one],
    };
    let mut tables: Vec<Table> = Vec::new();
    for name in names {
        let table = match name {
            Name::Figure2_7 => known_pose::run(args.seeds).map_err(Error::failure)?,
            Name::Figure3_12 => tracking::run(args.seeds).map_err(Error::failure)?,
            Name::Push | Name::Memory | Name::All => {
                push::run(data().as_deref()).map_err(Error::input)?
            }
        };
        if !args.json {
            say(&table);
        }
        tables.push(table);
    }
    if args.json {
        say(serde_json::to_string_pretty(&tables).map_err(Error::failure)?);
    }
    Ok(())
}
