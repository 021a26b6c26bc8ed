//! What the joint graph makes of a tracker's poses.

use std::time::Instant;

use rayon::prelude::*;

use crate::experiment::{Row, Table, evaluate};
use crate::graph::planes::{Effort, planes};
use crate::quantity::Deviation;
use crate::sim::{ObjectSpec, Options, SimError, simulate};
use crate::slam::choose::Choice;
use crate::slam::track;
use crate::view::report::Report;

/// What is tracked, and the part of the thesis' 100 % (10 mm and 20°) by which it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// Objects as in simulate.
    pub objects: Vec<String>,
    /// Parts of the thesis' noise.
    pub noise: Vec<f64>,
    /// How many seeds, from `first_seed` on.
    pub seeds: u64,
    /// The first seed.
    pub first_seed: u64,
}

impl Selection {
    /// What the published table shows.
    pub fn usual(seeds: u64) -> Selection {
        let objects = ["rectangle:0.10x0.06", "hexagon:0.045"];
        Selection {
            objects: objects.map(String::from).to_vec(),
            noise: vec![1.0],
            seeds,
            first_seed: 0,
        }
    }
}

/// Follows every object with the bootstrap filter, with and without the graph behind it.
///
/// # Errors
/// When an object cannot be simulated.
pub fn run(selection: &Selection) -> Result<Table, SimError> {
    let mut rows = Vec::new();
    for object in &selection.objects {
        let spec: ObjectSpec = object.parse()?;
        for part in &selection.noise {
            let motion_noise = Deviation { length: 0.01 * part, angle: (20.0 * part).to_radians() };
            let options = Options { motion_noise, ..Options::new(spec.clone()) };
            let seeds = selection.first_seed..selection.first_seed + selection.seeds;
            let runs: Vec<Vec<Option<Report>>> = seeds
                .into_par_iter()
                .filter_map(|seed| both(&Options { seed, ..options.clone() }))
                .collect();
            for (way, name) in
                ["tracker", "graph", "graph, no retrack", "retrack alone"].into_iter().enumerate()
            {
                let reports: Vec<Report> = runs.iter().filter_map(|r| r[way].clone()).collect();
                let case = format!("{object}, {:.0} %, {name}", 100.0 * part);
                rows.push(Row::of(case, &reports, selection.seeds));
            }
        }
    }
    Ok(Table { title: "Joint graph".into(), rows })
}

fn both(options: &Options) -> Option<Vec<Option<Report>>> {
    let simulation = simulate(options).ok()?;
    let log = &simulation.log;
    let start = Instant::now();
    let steps = track::Kind::Bootstrap.follow(log, options.seed);
    let tracked = start.elapsed().as_secs_f64();
    let judge = |steps| evaluate(log, Some(&simulation.geometry), steps, "bootstrap", Choice::Auto);
    let mut out = vec![judge(steps.clone())];
    let mut line = format!(
        "{} seed {} track {tracked:.2}s H {:.1}",
        options.object,
        options.seed,
        out[0].as_ref().and_then(|r| r.surface.hausdorff_aligned_mm).unwrap_or(f64::NAN)
    );
    let plain = Effort { retrack: false, ..Effort::default() };
    let cases: [(&[&[track::Step]], Effort); 3] =
        [(&[&steps], Effort::default()), (&[&steps], plain), (&[], Effort::default())];
    for (given, effort) in cases {
        let start = Instant::now();
        let corrected = planes(log, given, effort);
        let seconds = start.elapsed().as_secs_f64();
        let report = corrected.as_ref().and_then(|c| judge(c.relative()));
        if let (Some(c), Some(r)) = (&corrected, &report) {
            line += &format!(
                " | cost {:.1} faces {} x {:.2} chi {:.2} H {:.1} pose {:.1}/{:.1} {seconds:.3}s",
                c.cost,
                c.faces.len(),
                c.explained(),
                c.per_degree,
                r.surface.hausdorff_aligned_mm.unwrap_or(f64::NAN),
                r.pose.rms_translation_mm.unwrap_or(f64::NAN),
                r.pose.rms_rotation_deg.unwrap_or(f64::NAN)
            );
        }
        out.push(report);
    }
    let truth = track::truth(log).ok()?;
    let c = planes(log, &[&truth], plain)?;
    line += &format!(" | true {:.1} faces {}", c.cost, c.faces.len());
    eprintln!("{line}");
    Some(out)
}
