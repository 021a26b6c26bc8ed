//! Where real recordings and meshes are. They are no part of the project: docs/data.md says what they
//! are, and who publishes them.

use std::path::{Path, PathBuf};

/// The folder of real data: `$TACTILE_DATA`, else `../shared/data` beside the workspace; `None` where
/// there is none.
pub fn folder() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let folder = std::env::var_os("TACTILE_DATA").map_or_else(beside, PathBuf::from);
    folder.is_dir().then_some(folder)
}

/// The part of it that a test needs; without it, says so, so that the test can skip.
#[cfg(test)]
pub(crate) fn for_test(part: &str) -> Option<PathBuf> {
    let found = folder().map(|folder| folder.join(part)).filter(|part| part.exists());
    if found.is_none() {
        eprintln!("skipped: no real data, $TACTILE_DATA/{part} is not there");
    }
    found
}
