//! Gives the linker the memory map of the chosen board.

use std::error::Error;
use std::path::PathBuf;
use std::{env, fs};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=memory");
    println!("cargo:rerun-if-env-changed=TACTILE_HSE_HZ");
    println!("cargo:rerun-if-env-changed=TACTILE_BAUD");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return Ok(());
    }
    let chosen = |name: &str| env::var_os(format!("CARGO_FEATURE_{name}")).is_some();
    let board = match (chosen("STM32F405"), chosen("MPS2_AN386")) {
        (true, false) => "stm32f405",
        (false, true) => "mps2-an386",
        _ => return Err("choose one board: feature stm32f405 or mps2-an386".into()),
    };
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
    fs::copy(format!("memory/{board}.x"), out.join("memory.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    Ok(())
}
