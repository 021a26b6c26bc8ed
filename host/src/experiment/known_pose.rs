//! Figure 2.7: reconstruction error against the number of contacts at known poses, by the Gaussian
//! process alone and by the model that is chosen automatically.

use rayon::prelude::*;

use crate::experiment::{Row, Table, evaluate};
use crate::sim::{ObjectSpec, Options, SimError, Touch, simulate};
use crate::slam::choose::Choice;
use crate::slam::track;

/// Objects, numbers of contacts, and what to compare with (millimetres of Hausdorff distance).
const CASES: [(&str, &[(usize, &str)]); 6] = [
    (
        "rectangle:0.12x0.06",
        &[
            (10, "prototype's faces: 6.8"),
            (20, "prototype's faces: 2.0"),
            (40, "goal ≤ 6"),
            (60, "thesis' SE ±1: 4.3, faces: 1.8"),
        ],
    ),
    (
        "ellipse:0.12x0.06",
        &[(5, ""), (10, "thesis' SE ±1 in our prototype: 30"), (15, "goal ≤ 4"), (30, "")],
    ),
    ("hexagon:0.045", &[(10, ""), (20, ""), (40, "")]),
    ("triangle:0.06", &[(10, ""), (20, ""), (40, "")]),
    (
        "box:0.12x0.06x0.06",
        &[
            (20, ""),
            (40, "prototype's faces: 3.7"),
            (80, "thesis: “about 80 contacts”; faces: 2.1"),
            (120, ""),
        ],
    ),
    ("cylinder:0.06x0.1", &[(40, ""), (80, "")]),
];

/// Reconstructs the shapes from uniformly drawn contacts with 1 mm and 5° of noise.
///
/// # Errors
/// When an object cannot be simulated.
pub fn run(seeds: u64) -> Result<Table, SimError> {
    let mut rows = Vec::new();
    for (object, cases) in CASES {
        let spec: ObjectSpec = object.parse()?;
        for (contacts, reference) in cases {
            for (name, choice) in [("gp", Choice::Gp), ("auto", Choice::Auto)] {
                let mut row = one(&spec, *contacts, choice, seeds);
                row.case = format!("{object}, {contacts} contacts, {name}");
                row.reference = (*reference).into();
                rows.push(row);
            }
        }
    }
    Ok(Table {
        title: "Figure 2.7: shape at known poses, uniform contacts, 1 mm / 5°".into(),
        rows,
    })
}

/// One object from so many contacts, with each seed from 0 on.
pub fn one(spec: &ObjectSpec, contacts: usize, choice: Choice, seeds: u64) -> Row {
    let options =
        Options { grasps: Some(1), contacts, touch: Touch::Uniform, ..Options::new(spec.clone()) };
    let reports: Vec<_> = (0..seeds)
        .into_par_iter()
        .filter_map(|seed| {
            let simulation = simulate(&Options { seed, ..options.clone() }).ok()?;
            let steps = track::truth(&simulation.log).ok()?;
            evaluate(&simulation.log, Some(&simulation.geometry), steps, "truth", choice)
        })
        .collect();
    let mut row = Row::of(format!("{spec}, {contacts} contacts"), &reports, seeds);
    (row.pose_mm, row.pose_deg) = (None, None);
    row
}
