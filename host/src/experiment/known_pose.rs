//! Figure 2.7: reconstruction error against the number of contacts at known poses.

use rayon::prelude::*;

use crate::experiment::{Row, Spread, Table, evaluate};
use crate::sim::{ObjectSpec, Options, Touch, simulate};
use crate::slam::track;

/// Objects, numbers of contacts, and what to compare with (millimetres of Hausdorff distance).
const CASES: [(&str, &[(usize, &str)]); 2] = [
    (
        "rectangle:0.12x0.06",
        &[(10, ""), (20, "thesis SE ±1 (our prototype): 25"), (40, "goal ≤ 6"), (60, "")],
    ),
    (
        "ellipse:0.12x0.06",
        &[(5, ""), (10, "thesis SE ±1 (our prototype): 30"), (15, "goal ≤ 4"), (30, "")],
    ),
];

/// Reconstructs both shapes from uniformly drawn contacts with 1 mm and 5° of noise.
pub fn run(seeds: u64) -> Table {
    let mut rows = Vec::new();
    for (object, counts) in CASES {
        for &(contacts, reference) in counts {
            let options = |seed| Options {
                object: object.parse::<ObjectSpec>().ok()?.into(),
                seed,
                ..Options::default()
            };
            let _ = (options, Touch::Uniform, contacts, simulate);
            let reports: Vec<_> = (0..seeds)
                .into_par_iter()
                .filter_map(|seed| {
                    let simulation = known_pose(object, contacts, seed)?;
                    let steps = track::truth(&simulation.0).ok()?;
                    evaluate(&simulation.0, Some(&simulation.1), steps, "truth")
                })
                .collect();
            let of = |f: &dyn Fn(&crate::view::report::Report) -> Option<f64>| {
                Spread::of(reports.iter().filter_map(f))
            };
            rows.push(Row {
                case: format!("{object}, {contacts} contacts"),
                runs: (reports.len(), seeds as usize),
                hausdorff_mm: of(&|r| r.surface.hausdorff_aligned_mm),
                mean_mm: of(&|r| r.surface.mean_mm),
                pose_mm: None,
                pose_deg: None,
                success: None,
                reference: reference.into(),
            });
        }
    }
    Table { title: "Figure 2.7: shape at known poses, uniform contacts, 1 mm / 5°".into(), rows }
}
