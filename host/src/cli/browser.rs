//! A page in the browser of whoever sits here.

use std::path::Path;
use std::process::{Command, Stdio};

use super::terminal::{note, warn};

/// Opens a page with the program that `BROWSER` names, else with the system's own opener; without either
/// it says where the page is. Does not wait for the browser to end.
pub(super) fn show(page: &Path) {
    let page = std::path::absolute(page).unwrap_or_else(|_| page.to_owned());
    note(format_args!("opening {}", page.display()));
    if let Err(error) =
        opener().arg(&page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()
    {
        warn(format_args!("no browser could be started ({error}); the page is {}", page.display()));
    }
}

fn opener() -> Command {
    let named = std::env::var_os("BROWSER").filter(|name| !name.is_empty());
    if let Some(name) = named {
        return Command::new(name);
    }
    if cfg!(target_os = "macos") {
        return Command::new("open");
    }
    if cfg!(windows) {
        return Command::new("explorer");
    }
    Command::new("xdg-open")
}
