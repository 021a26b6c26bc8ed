//! Figure 3.12: reconstruction error against the noise of the object's motion.

use rayon::prelude::*;
use tactile_core::track::{Gate, Settings};

use crate::experiment::{Row, Table, evaluate};
use crate::quantity::Deviation;
use crate::sim::{ObjectSpec, Options, SimError, simulate};
use crate::slam::choose::Choice;
use crate::slam::track;
use crate::view::report::Report;

const OBJECTS: [&str; 2] = ["rectangle:0.10x0.06", "hexagon:0.045"];

/// Parts of the thesis' 100 %: 10 mm and 20°.
const NOISE: [f64; 3] = [0.25, 0.5, 1.0];

/// With the calibrated likelihood alone, and with the thesis' gate on top.
const GATES: [(&str, Option<Gate>); 2] = [("", None), (", gate", Some(Gate::THESIS))];

/// Tracks both objects through 16 five-finger grasps with the bootstrap filter.
///
/// # Errors
/// When an object cannot be simulated.
pub fn run(seeds: u64) -> Result<Table, SimError> {
    let mut rows = Vec::new();
    for object in OBJECTS {
        let spec: ObjectSpec = object.parse()?;
        for part in NOISE {
            for (name, gate) in GATES {
                let motion_noise =
                    Deviation { length: 0.01 * part, angle: (20.0 * part).to_radians() };
                let options = Options { motion_noise, ..Options::new(spec.clone()) };
                let reports = (0..seeds).into_par_iter();
                let reports: Vec<_> = reports
                    .filter_map(|seed| track(&Options { seed, ..options.clone() }, gate))
                    .collect();
                let case = format!("{object}, noise {:.0} %{name}", 100.0 * part);
                let mut row = Row::of(case, &reports, seeds);
                row.reference = "thesis: < 9 mm with 10 000 particles".into();
                rows.push(row);
            }
        }
    }
    Ok(Table {
        title: "Figure 3.12: tracking with the bootstrap filter, 16 grasps, 10 000 particles; \
                turns of a hexagon by 60° count as errors"
            .into(),
        rows,
    })
}

/// One run; the filter's seed is the simulation's.
fn track(options: &Options, gate: Option<Gate>) -> Option<Report> {
    let simulation = simulate(options).ok()?;
    let settings = Settings { gate, ..track::settings(&simulation.log, options.seed) };
    let steps = track::bootstrap(&simulation.log, &settings);
    evaluate(&simulation.log, Some(&simulation.geometry), steps, "bootstrap", Choice::Auto)
}
