//! Bare contact points as OFF files have them: the word `OFF`, a line of counts, and x y z of each
//! point.

use std::path::Path;

use super::super::{GraspLog, LogError, LoggedContact, LoggedGrasp, MAX_CONTACTS, MAX_COORDINATE};
use super::tokens::Tokens;
use super::{Options, text, too_many};
use crate::space::Point;

/// Reads contact points; all of them are one grasp, without normals.
///
/// # Errors
/// Naming the file, line and column and what was expected there; a mesh (a file with faces) is
/// refused, and so are more than [`MAX_CONTACTS`] points.
pub fn import(path: &Path, options: &Options) -> Result<GraspLog, LogError> {
    parse(&text(path)?, path, options)
}

fn parse(text: &str, path: &Path, options: &Options) -> Result<GraspLog, LogError> {
    let mut tokens = Tokens::new(path, text);
    let (word, column) = tokens.word("the word OFF")?;
    if word != "OFF" {
        return Err(tokens.wrong(Some(column), format!("expected the word OFF, found {word:?}")));
    }
    let count = tokens.count("the number of points")?;
    let faces = tokens.count("the number of faces")?;
    tokens.count("the number of edges")?;
    if faces > 0 {
        let problem = format!("expected contact points only, found a mesh of {faces} faces");
        return Err(tokens.wrong(None, problem));
    }
    if count == 0 {
        return Err(tokens.wrong(None, "expected at least one point"));
    }
    if count > MAX_CONTACTS {
        return Err(tokens.wrong(None, too_many(count)));
    }
    let mut contacts = Vec::with_capacity(count);
    for k in 0..count {
        let mut point = Point::zeros();
        for (x, axis) in point.iter_mut().zip(["x", "y", "z"]) {
            *x = options.unit * tokens.number(format_args!("{axis} of point {k} of {count}"))?;
        }
        if point.amax() > MAX_COORDINATE {
            let problem = format!("expected coordinates within ±{MAX_COORDINATE} m");
            return Err(tokens.wrong(None, problem));
        }
        contacts.push(LoggedContact { point, ..LoggedContact::default() });
    }
    tokens.end(format_args!("{count} points"))?;
    let grasp = LoggedGrasp { contacts, ..LoggedGrasp::default() };
    Ok(options.log(3, Vec::new(), vec![grasp]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn off(text: &str) -> Result<GraspLog, LogError> {
        parse(text, Path::new("some.off"), &Options::default())
    }

    #[test]
    fn points_become_one_grasp() {
        let log = off("OFF  \n# a comment\n 2.00000\t0.0 0\n1 2 3 \n-4e-3 5 6 # here\n\n").unwrap();
        assert_eq!((log.dimension, log.grasps.len()), (3, 1));
        let points: Vec<_> = log.grasps[0].contacts.iter().map(|c| c.point).collect();
        assert_eq!(points, [Point::new(1.0, 2.0, 3.0), Point::new(-0.004, 5.0, 6.0)]);
        let options = Options { unit: 1e-3, fixed: true, ..Options::default() };
        let log = parse("OFF 1 0 0 1 2 3", Path::new("x"), &options).unwrap();
        assert_eq!(log.grasps[0].contacts[0].point, Point::new(1e-3, 2e-3, 3e-3));
        assert_eq!(log.grasps[0].truth, Some(crate::space::Pose::identity()));
    }

    #[test]
    fn wrong_files_are_refused_with_their_place() {
        let refused = |text: &str, expected: &str| {
            let error = off(text).unwrap_err().to_string();
            assert!(error.starts_with("some.off, line ") && error.contains(expected), "{error}");
        };
        refused("", "line 1: expected the word OFF, found the end of the file");
        refused("PLY\n", "line 1: column 1: expected the word OFF, found \"PLY\"");
        refused("OFF\n2.5 0 0\n", "line 2: column 1: expected the number of points");
        refused("OFF\n-1 0 0\n", "line 2: column 1: expected the number of points");
        refused("OFF\n0 0 0\n", "expected at least one point");
        refused("OFF\n4 4 6\n", "found a mesh of 4 faces");
        refused("OFF\n5000 0 0\n", "at most 1024 contacts in one grasp, found 5000");
        refused("OFF\n2 0 0\n1 2 3\n4 5", "line 4: expected z of point 1 of 2, found the end");
        refused("OFF\n1 0 0\n1 2  x\n", "line 3: column 6: expected z of point 0 of 1 (a finite");
        refused("OFF\n1 0 0\n1 2 inf\n", "found \"inf\"");
        refused("OFF\n1 0 0\n1 2 1e300\n", "within ±10000 m");
        refused("OFF\n1 0 0\n1 2 3\n4", "line 4: column 1: expected the end of the file after 1");
    }

    #[test]
    fn real_fingertip_contacts_are_read() {
        let Some(folder) = crate::data::for_test("touch/measurements") else { return };
        for (name, count) in [("measCleaner_exp.off", 75), ("measTetra30_sim.off", 30)] {
            let log = import(&folder.join(name), &Options::default()).unwrap();
            assert_eq!(log.grasps[0].contacts.len(), count);
        }
    }
}
