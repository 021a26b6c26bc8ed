use super::*;
use crate::graph::joint::planes::{Effort, planes};
use crate::graph::joint::retrack::retrack;
use crate::quantity::Deviation;
use crate::sim::{Options, simulate};
use crate::slam::track;

#[test]
fn grasps_whose_contacts_hang_in_the_air_are_made_elsewhere() {
    let motion_noise = Deviation { length: 0.01, angle: 20f64.to_radians() };
    let (mut spared, mut mended) = (Vec::new(), 0);
    for seed in 510..518 {
        let object = "tshape:0.1x0.08x0.03".parse().unwrap();
        let options = Options { motion_noise, seed, grasps: Some(16), ..Options::new(object) };
        let log = simulate(&options).unwrap().log;
        let problem = Problem::new(&log);
        let found = retrack::<3>(&problem, log.grasps[0].truth).unwrap();
        let before = corrected(&problem, found.clone(), &[], &[]).unwrap();
        let after = seated(&problem, found, &[], &[]).unwrap();
        let (was, is) = (before.corrected.cost, after.corrected.cost);
        if before.is_sound() {
            assert_eq!(was, is);
            continue;
        }
        spared.push(was - is);
        // As good as from the true poses, which it was not.
        let effort = Effort { rounds: 3, restarts: false, retrack: false };
        let truth = track::truth(&log).unwrap();
        let known = planes(&log, &[&truth], effort).unwrap().cost + 5.0;
        mended += usize::from(was > known && is < known);
    }
    assert!(spared.iter().all(|nats| *nats >= 0.0), "{spared:?}");
    let mean = spared.iter().sum::<f64>() / spared.len() as f64;
    assert!(mean > 15.0 && mended >= 2, "{mean} {mended} {spared:?}");
}
