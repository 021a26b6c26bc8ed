//! How things went from the first grasp to the last, one line each.

use crate::cli::terminal::{SPARK, sparkline};
use crate::log::GraspLog;
use crate::log::replayed::{RecordedEstimate, Replayed};

/// One line: a name, the course of the values, and the greatest. `None` where nothing is known, or
/// there is but one grasp.
fn course(name: &str, values: &[f64], unit: &str) -> Option<String> {
    let greatest = values.iter().copied().filter(|v| v.is_finite()).reduce(f64::max)?;
    let spark = sparkline(values, SPARK);
    // As many decimals as the value needs to be told from its neighbours.
    let decimals = if unit.is_empty() { 0 } else { 2 };
    let line = format!("{name:<15} {spark}  up to {greatest:.decimals$} {unit}");
    (values.len() > 1).then(|| line.trim_end().to_owned())
}

/// Of a grasp log: contacts, force, motion.
pub(super) fn of_log(log: &GraspLog) -> Vec<String> {
    let grasps = &log.grasps;
    let contacts: Vec<f64> = grasps.iter().map(|g| g.contacts.len() as f64).collect();
    let force = |g: &crate::log::LoggedGrasp| {
        g.contacts.iter().filter_map(|c| c.force).reduce(f64::max).unwrap_or(f64::NAN)
    };
    let forces: Vec<f64> = grasps.iter().map(force).collect();
    let turn = |g: &crate::log::LoggedGrasp| {
        g.motion.map_or(f64::NAN, |m| m.rotation.angle().to_degrees())
    };
    let turns: Vec<f64> = grasps.iter().map(turn).collect();
    let pauses: Vec<f64> = grasps
        .windows(2)
        .map(|pair| {
            pair[1].time.zip(pair[0].time).map_or(f64::NAN, |(after, before)| after - before)
        })
        .collect();
    [
        course("contacts", &contacts, ""),
        course("force", &forces, "N"),
        course("turn", &turns, "°"),
        course("pause", &pauses, "s"),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Of a recording: contacts, what the estimates are worth, how certain they are.
pub(super) fn of_recording(replayed: &Replayed) -> Vec<String> {
    let estimates = &replayed.estimates;
    let contacts: Vec<f64> = replayed.log.grasps.iter().map(|g| g.contacts.len() as f64).collect();
    let half = if replayed.log.dimension == 2 { 2 } else { 3 };
    let greatest = |deviations: &[f32]| {
        deviations.iter().map(|d| f64::from(*d)).reduce(f64::max).unwrap_or(f64::NAN)
    };
    let place =
        |e: &RecordedEstimate| greatest(&e.deviations[..half.min(e.deviations.len())]) * 1e3;
    let turn =
        |e: &RecordedEstimate| greatest(&e.deviations[half.min(e.deviations.len())..]).to_degrees();
    let places: Vec<f64> = estimates.iter().map(place).collect();
    let turns: Vec<f64> = estimates.iter().map(turn).collect();
    let mut lines: Vec<String> = [
        course("contacts", &contacts, ""),
        course("sd position", &places, "mm"),
        course("sd rotation", &turns, "°"),
    ]
    .into_iter()
    .flatten()
    .collect();
    let mut kinds: Vec<(&str, usize)> = Vec::new();
    for name in estimates.iter().map(|e| e.status.name()) {
        match kinds.iter_mut().find(|(known, _)| *known == name) {
            Some((_, count)) => *count += 1,
            None => kinds.push((name, 1)),
        }
    }
    if !kinds.is_empty() {
        let kinds: Vec<String> = kinds.iter().map(|(name, n)| format!("{n} {name}")).collect();
        lines.push(format!("{:<15} {}", "status", kinds.join(", ")));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{LoggedContact, LoggedGrasp};
    use crate::space::planar;

    #[test]
    fn a_log_has_a_line_for_each_thing_it_knows() {
        let grasp = |index: u64, contacts: usize| LoggedGrasp {
            index,
            motion: (index > 0).then(|| planar(0.0, 0.0, 0.1 * index as f64)),
            contacts: vec![LoggedContact::default(); contacts],
            ..LoggedGrasp::default()
        };
        let log = GraspLog {
            dimension: 2,
            description: String::new(),
            fingers: Vec::new(),
            noise: Default::default(),
            shape: None,
            grasps: vec![grasp(0, 1), grasp(1, 8), grasp(2, 4)],
            unknown: Default::default(),
        };
        let lines = of_log(&log);
        assert_eq!(
            lines,
            ["contacts        ▂█▅  up to 8", "turn            ·▅█  up to 11.46 °"],
            "neither force nor time"
        );
        let one = GraspLog { grasps: vec![grasp(0, 5)], ..log };
        assert!(of_log(&one).is_empty());
    }
}
