//! `cargo fw build|run|count|cycles|size IMAGE [--board stm32f405|mps2-an386]` and `cargo fw clippy`: firmware with whatever toolchain
//! there is, in QEMU, always under a time limit.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 77 something has to be installed first (1 when
//! `TACTILE_REQUIRE_FIRMWARE` is 1).

use std::process::ExitCode;
use std::time::Duration;

use tactile_core::space::{Planar, Spatial};
use tactile_core::wire::WireSpace;
use tactile_host::link::firmware::{self, FirmwareError, Machine};
use tactile_host::link::qemu::{self, Qemu};
use tactile_host::link::{Patience, Session, cycles};

const USAGE: &str =
    "usage: cargo fw build|run|count|cycles|size IMAGE [--board stm32f405|mps2-an386]
       cargo fw clippy
  clippy check core and firmware for the target of every board
  build  compile the image and print its path
  run    start it in QEMU and ask who is there
  count  run `bench`, `bench-map` or `bench-sensing` in QEMU and print how many instructions the core takes
  cycles trace `bench-map` or `bench-sensing` in QEMU and print instructions and modelled cycles of a
         Cortex-M4, of the map beside the least that the arithmetic takes
  size   print flash, static memory and, after a few grasps in QEMU, the deepest stack";
const LIMIT: Duration = Duration::from_secs(300);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (verb, image, board) = match words[..] {
        ["clippy"] => return finish(clippy()),
        [verb, image] => (verb, image, None),
        [verb, image, "--board", board] => (verb, image, Some(board)),
        _ => return usage(),
    };
    let bench = firmware::BENCHES.contains(&image);
    let machine = match (image, board) {
        (_, None | Some("mps2-an386")) if bench => Machine::Mps2An386,
        _ if bench => return usage(),
        (_, None | Some("stm32f405")) => Machine::Stm32f405,
        (_, Some("mps2-an386")) => Machine::Mps2An386,
        _ => return usage(),
    };
    let dimension = firmware::IMAGES.iter().find(|i| i.0 == image).map(|i| i.1);
    finish(match (verb, dimension) {
        ("build", Some(_)) => build(image, machine),
        ("build", None) if bench => build(image, machine),
        ("run" | "count", None) if bench => count(image, machine, verb == "count"),
        ("cycles", None) if bench => cycles(image, machine),
        ("run" | "size", Some(2)) => talk::<Planar>(image, machine, verb == "size"),
        ("run" | "size", Some(_)) => talk::<Spatial>(image, machine, verb == "size"),
        _ => return usage(),
    })
}

/// The exit code, and what went wrong.
fn finish(outcome: Outcome) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            let missing = error.downcast_ref::<FirmwareError>().is_some_and(|e| e.is_missing());
            let skip = missing && !tactile_tests::firmware_is_required();
            ExitCode::from(if skip { 77 } else { 1 })
        }
    }
}

type Outcome = Result<(), Box<dyn std::error::Error>>;

fn usage() -> ExitCode {
    let images: Vec<&str> = firmware::IMAGES.iter().map(|i| i.0).collect();
    eprintln!("{USAGE}\nimages: {}, {}", images.join(", "), firmware::BENCHES.join(", "));
    ExitCode::from(2)
}

fn clippy() -> Outcome {
    for machine in [Machine::Stm32f405, Machine::Mps2An386] {
        firmware::clippy(machine)?;
        println!("{}: nothing to complain about", machine.feature());
    }
    Ok(())
}

fn build(image: &str, machine: Machine) -> Outcome {
    println!("{}", firmware::build(image, machine)?.display());
    Ok(())
}

fn count(image: &str, machine: Machine, exactly: bool) -> Outcome {
    let elf = firmware::build(image, machine)?;
    print!("{}", qemu::run(&elf, machine, exactly, LIMIT)?);
    Ok(())
}

fn cycles(image: &str, machine: Machine) -> Outcome {
    let elf = firmware::build(image, machine)?;
    print!("{}", cycles::run(&elf, machine, LIMIT)?);
    Ok(())
}

fn talk<S: WireSpace + tactile_tests::Sample>(
    image: &str,
    machine: Machine,
    size: bool,
) -> Outcome {
    let elf = firmware::build(image, machine)?;
    let footprint = firmware::footprint(&elf)?;
    let board = Qemu::start(&elf, machine, LIMIT)?;
    let mut session = Session::<S, _>::open(board, Patience::default())?;
    if let Some(hello) = session.hello() {
        println!("{hello:?}");
    }
    if !size {
        return Ok(());
    }
    let log = S::log(12);
    let settings = tactile_host::link::session::settings_for(&log, 1);
    session.configure(settings)?;
    let mut stack = (0, 0);
    session
        .run(&log, settings, |_, grasp| stack = (grasp.health.peak_stack, grasp.health.stack))?;
    println!("flash         {:>8} B", footprint.flash);
    println!(
        "static memory {:>8} B, of which {} B initialised",
        footprint.ram, footprint.initialised
    );
    println!("deepest stack {:>8} B of {} B", stack.0, stack.1);
    Ok(())
}
