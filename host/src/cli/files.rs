//! What a command reads it does not write over.

use std::path::Path;

use super::Error;
use crate::log::write::is_same_file;
use crate::log::{GraspLog, TrueShape};
use crate::sim::ObjectSpec;
use crate::slam::output::RESULTS;

/// Refuses an output that is the file it is made from.
pub(super) fn apart(input: &Path, output: &Path, option: &str) -> Result<(), Error> {
    if is_same_file(input, output) {
        let name = output.display();
        return Err(Error::Input(format!(
            "{option}: {name} is read and would be replaced; expected another place"
        )));
    }
    Ok(())
}

/// Refuses an output that is the true mesh of a log that is read.
pub(super) fn apart_from_truth(log: &GraspLog, output: &Path, option: &str) -> Result<(), Error> {
    match &log.shape {
        Some(TrueShape::Mesh { file, .. }) => apart(file, output, option),
        _ => Ok(()),
    }
}

/// Refuses a folder of results one of which would replace `input`.
pub(super) fn spare(input: &Path, folder: &Path) -> Result<(), Error> {
    RESULTS.iter().try_for_each(|name| apart(input, &folder.join(name), "--out"))
}

/// Refuses an output that one of the results in `folder` would replace, whether they are there yet or not.
pub(super) fn beside(output: &Path, option: &str, folder: &Path) -> Result<(), Error> {
    let place =
        |path: &Path| std::fs::canonicalize(path).or_else(|_| std::path::absolute(path)).ok();
    if place(output).is_some_and(|file| Some(file) == place(folder)) {
        let name = output.display();
        return Err(Error::Input(format!(
            "{option}: {name} is the folder of the results; expected another place"
        )));
    }
    let named = output.file_name().is_some_and(|name| RESULTS.iter().any(|result| name == *result));
    let above = output.parent().filter(|p| *p != Path::new("")).unwrap_or(Path::new("."));
    if named && place(above) == place(folder) {
        let name = output.display();
        return Err(Error::Input(format!(
            "{option}: {name} is where one of the results goes; expected another place"
        )));
    }
    Ok(())
}

/// The file that an object is from.
pub(super) fn of(object: &ObjectSpec) -> Option<&Path> {
    match object {
        ObjectSpec::Mesh(file) | ObjectSpec::Polygon(file) => Some(file),
        ObjectSpec::Prism { base, .. } | ObjectSpec::Pyramid { base, .. } => of(base),
        _ => None,
    }
}
