//! Figure 2.7: reconstruction error against the number of contacts at known poses.

use rayon::prelude::*;

use crate::experiment::{Row, Table, evaluate};
use crate::sim::{ObjectSpec, Options, SimError, Touch, simulate};
use crate::slam::track;

/// Objects, numbers of contacts, and what to compare with (millimetres of Hausdorff distance).
const CASES: [(&str, [(usize, &str); 4]); 3] = [
    (
        "rectangle:0.12x0.06",
        [(10, ""), (20, ""), (40, "goal ≤ 6"), (60, "thesis' SE ±1 in our prototype: 4.3")],
    ),
    (
        "ellipse:0.12x0.06",
        [(5, ""), (10, "thesis' SE ±1 in our prototype: 30"), (15, "goal ≤ 4"), (30, "")],
    ),
    ("box:0.12x0.06x0.06", [(20, ""), (40, ""), (80, "thesis: “about 80 contacts”"), (120, "")]),
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
            let options = Options {
                grasps: Some(1),
                contacts,
                touch: Touch::Uniform,
                ..Options::new(spec.clone())
            };
            let reports: Vec<_> = (0..seeds)
                .into_par_iter()
                .filter_map(|seed| {
                    let simulation = simulate(&Options { seed, ..options.clone() }).ok()?;
                    let steps = track::truth(&simulation.log).ok()?;
                    evaluate(&simulation.log, Some(&simulation.geometry), steps, "truth")
                })
                .collect();
            let mut row = Row::of(format!("{object}, {contacts} contacts"), &reports, seeds);
            (row.pose_mm, row.pose_deg) = (None, None);
            row.reference = reference.into();
            rows.push(row);
        }
    }
    Ok(Table {
        title: "Figure 2.7: shape at known poses, uniform contacts, 1 mm / 5°".into(),
        rows,
    })
}
