//! Figure 3.12: reconstruction error against the noise of the object's motion.

use rayon::prelude::*;

use crate::experiment::{Row, Table, evaluate};
use crate::quantity::Deviation;
use crate::sim::{ObjectSpec, Options, SimError, simulate};
use crate::slam::choose::Choice;
use crate::slam::track;

const OBJECTS: [&str; 2] = ["rectangle:0.10x0.06", "hexagon:0.045"];

/// Parts of the thesis' 100 %: 10 mm and 20°.
const NOISE: [f64; 3] = [0.25, 0.5, 1.0];

/// Tracks both objects through 16 five-finger grasps with the bootstrap filter.
///
/// # Errors
/// When an object cannot be simulated.
pub fn run(seeds: u64) -> Result<Table, SimError> {
    let mut rows = Vec::new();
    for object in OBJECTS {
        let spec: ObjectSpec = object.parse()?;
        for part in NOISE {
            let motion_noise = Deviation { length: 0.01 * part, angle: (20.0 * part).to_radians() };
            let options = Options { motion_noise, ..Options::new(spec.clone()) };
            let reports: Vec<_> = (0..seeds)
                .into_par_iter()
                .filter_map(|seed| {
                    let simulation = simulate(&Options { seed, ..options.clone() }).ok()?;
                    let steps =
                        track::bootstrap(&simulation.log, &track::settings(&simulation.log, seed));
                    evaluate(
                        &simulation.log,
                        Some(&simulation.geometry),
                        steps,
                        "bootstrap",
                        Choice::Auto,
                    )
                })
                .collect();
            let mut row =
                Row::of(format!("{object}, motion noise {:.0} %", 100.0 * part), &reports, seeds);
            row.reference = "thesis: < 9 mm with 10 000 particles".into();
            rows.push(row);
        }
    }
    Ok(Table {
        title: "Figure 3.12: tracking with the bootstrap filter, 16 grasps, 10 000 particles"
            .into(),
        rows,
    })
}
