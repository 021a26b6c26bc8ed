//! Other people's data as grasp logs.

/// Where real recordings are: `$TACTILE_DATA/name`, or `../shared/data/name` beside the workspace.
/// Without them, says so and gives nothing, so that a test can skip.
#[cfg(test)]
pub(crate) fn data(name: &str) -> Option<std::path::PathBuf> {
    let workspace = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let root = std::env::var_os("TACTILE_DATA")
        .map_or_else(|| workspace.join("../shared/data"), std::path::PathBuf::from);
    let folder = root.join(name);
    if !folder.is_dir() {
        eprintln!("skipped: no real data in {} (set TACTILE_DATA)", folder.display());
        return None;
    }
    Some(folder)
}
