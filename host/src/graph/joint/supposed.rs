//! Normals that nobody felt, for faces to begin with.
//!
//! Faces are founded by normals, and at poses that are still wrong the surface of all contacts says little about
//! them. But the contacts of one grasp are where they are to each other, and in the plane a closed curve through
//! them faces roughly as the object does.

use crate::log::GraspLog;
use crate::model::bare;
use crate::reference::Contact;
use crate::slam::deviations;

/// Least standard deviation of such a normal, radians: a few contacts say little of what lies between them. (Of
/// 0.3, 0.5 and 0.8, four logs of an L each.)
const DOUBTFUL: f64 = 0.5;

/// The log with normals where none were felt, as each grasp's own contacts suggest them. `None` in space, where these
/// were not found to help, and where most contacts felt theirs.
pub(super) fn supposed(log: &GraspLog) -> Option<GraspLog> {
    let contacts = || log.grasps.iter().flat_map(|grasp| &grasp.contacts);
    let felt = contacts().filter(|c| c.normal.is_some()).count();
    if log.dimension != 2 || 2 * felt > contacts().count() {
        return None;
    }
    let mut log = log.clone();
    let mut are_any = false;
    for grasp in &mut log.grasps {
        let own = grasp.contacts.iter().map(|c| {
            let (point_deviation, normal_deviation) = deviations(c, &log.noise);
            Contact { point: c.point, normal: c.normal, point_deviation, normal_deviation }
        });
        let Some(guessed) = bare::guessed(log.dimension, &own.collect::<Vec<_>>()) else {
            continue;
        };
        for (contact, guess) in grasp.contacts.iter_mut().zip(guessed) {
            if contact.normal.is_none() && guess.normal.is_some() {
                contact.normal = guess.normal;
                contact.normal_noise = Some(guess.normal_deviation.max(DOUBTFUL));
                are_any = true;
            }
        }
    }
    are_any.then_some(log)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::joint::correct;
    use crate::quantity::Deviation;
    use crate::sim::{Options, simulate};
    use crate::slam::trackers::Kind;

    /// Of a hand, and the same without normals.
    fn logs(object: &str, seed: u64) -> [GraspLog; 2] {
        let motion_noise = Deviation { length: 5e-3, angle: 10f64.to_radians() };
        let options = Options { motion_noise, seed, ..Options::new(object.parse().unwrap()) };
        let felt = simulate(&options).unwrap().log;
        let mut bare = felt.clone();
        bare.grasps.iter_mut().flat_map(|g| &mut g.contacts).for_each(|c| c.normal = None);
        [felt, bare]
    }

    #[test]
    fn a_grasp_suggests_where_its_contacts_face() {
        let [felt, mut bare] = logs("tshape:0.1x0.08x0.03", 1);
        assert!(supposed(&felt).is_none());
        bare.grasps[2].contacts[1].normal = felt.grasps[2].contacts[1].normal;
        bare.grasps[3].contacts.truncate(2);
        let told = supposed(&bare).unwrap();
        assert_eq!(told.grasps[2].contacts[1], bare.grasps[2].contacts[1]);
        assert_eq!(told.grasps[3], bare.grasps[3]);
        let both = felt.grasps.iter().zip(&told.grasps);
        let both = both.flat_map(|(felt, told)| felt.contacts.iter().zip(&told.contacts));
        let mut off: Vec<f64> = Vec::new();
        for (felt, told) in both {
            assert_eq!(felt.point, told.point);
            assert!(told.normal_noise.is_none_or(|noise| noise >= DOUBTFUL));
            off.extend(told.normal.map(|n| n.angle(&felt.normal.unwrap())));
        }
        off.sort_by(f64::total_cmp);
        assert!(off.len() > 70 && off[off.len() / 2] < 0.6, "{off:?}");
        let [_, bare] = logs("box:0.1x0.06x0.05", 1);
        assert!(supposed(&bare).is_none());
    }

    #[test]
    fn poses_are_found_without_normals() {
        let [_, bare] = logs("triangle:0.06", 5);
        let steps = Kind::Automatic.follow(&bare, 0);
        let corrected = correct(&bare, &steps).unwrap();
        let off = |steps: &[crate::slam::track::Step]| {
            let truth = bare.grasps.iter().map(|g| g.truth.unwrap());
            let gauge = truth.clone().next().unwrap().inverse() * steps[0].pose;
            let each = truth.zip(steps).map(|(truth, step)| {
                (step.pose.inverse() * truth * gauge).translation.vector.norm_squared()
            });
            (each.sum::<f64>() / steps.len() as f64).sqrt()
        };
        let [before, after] = [off(&steps), off(&corrected.steps)];
        assert!(before > 0.01 && after < 5e-3, "{before} {after}");
    }
}
