//! Single grasps at other poses.
//!
//! Surface and poses in turns end wherever a grasp's contacts suit the others' surface, which may be at the
//! wrong place of it. So every grasp is tried as far off as motions err, on the surface that the others make;
//! and with it all after it, which followed where one grasp was mistaken.

use std::ops::Range;

use rayon::prelude::*;

use super::touch::{cost, normal};
use super::{Fitted, placed, settle, without, worth};
use crate::graph::joint::lone::{Between, least};
use crate::graph::joint::problem::Problem;
use crate::graph::joint::round::spread;
use crate::graph::joint::tangent::{SAME, are_near};
use crate::reference::Contact;
use crate::space::Pose;

/// How often all grasps are tried, each time on the surfaces that the last time left.
const ROUNDS: usize = 3;

/// Other poses of a grasp that are weighed with all contacts: those that suit the others' surface best.
const TRIED: usize = 3;

/// Contacts that choose those where all later grasps move along: the first so many.
const CHOOSING: usize = 12;

/// Nats that another pose must gain, and that a round must for another to be worth while.
const GAIN: f64 = 1.0;

/// With grasps at other poses where all contacts together are likelier so.
pub(super) fn revised<const D: usize>(problem: &Problem, mut best: Fitted<D>) -> Fitted<D> {
    for _ in 0..ROUNDS {
        let Some(next) = once(problem, &best).filter(|next| next.cost < best.cost) else { break };
        let gained = best.cost - next.cost;
        best = next;
        if gained < GAIN {
            break;
        }
    }
    best
}

/// The same with every grasp tried once; `None` where none is likelier elsewhere.
fn once<const D: usize>(problem: &Problem, known: &Fitted<D>) -> Option<Fitted<D>> {
    let mut poses = known.poses.clone();
    let first = worth(problem, known, &poses)?;
    let (mut least, count) = (first, poses.len());
    for grasp in 1..count {
        let with_later = (grasp + 1 < count).then_some(grasp..count);
        for moving in std::iter::once(grasp..grasp + 1).chain(with_later) {
            if let Some((lower, better)) = likelier(problem, known, &poses, moving, least - GAIN) {
                (least, poses) = (lower, better);
            }
        }
    }
    (least < first).then(|| settle(problem, poses))?
}

/// The poses with these grasps moved together, where that costs less than `most`.
fn likelier<const D: usize>(
    problem: &Problem,
    known: &Fitted<D>,
    poses: &[Pose],
    moving: Range<usize>,
    most: f64,
) -> Option<(f64, Vec<Pose>)> {
    elsewhere(problem, known, poses, moving.clone()).into_iter().find_map(|pose| {
        let by = poses[moving.start].inverse() * pose;
        let mut moved = poses.to_vec();
        for pose in &mut moved[moving.clone()] {
            *pose *= by;
            pose.rotation.renormalize();
        }
        let lower = worth(problem, known, &moved)?;
        (lower < most).then_some((lower, moved))
    })
}

/// Other poses of the first of these grasps, all of them moved with it, at which they suit the surface of
/// all others and the motions best.
fn elsewhere<const D: usize>(
    problem: &Problem,
    known: &Fitted<D>,
    poses: &[Pose],
    moving: Range<usize>,
) -> Vec<Pose> {
    let (grasp, later) = (moving.start, moving.len() > 1);
    let own = problem.starts[grasp]..problem.starts[moving.end];
    // As if all of them had been felt at the first one's pose.
    let carried = |i: usize| problem.placed(poses, i).transformed(&poses[grasp]);
    let trusted = own.clone().filter(|i| known.trusted[*i]);
    let felt: Vec<Contact> = trusted.take(CHOOSING).map(carried).collect();
    let surface = without(problem, known, &placed(problem, poses), own);
    let Some((surface, between)) = surface.zip(Between::new(problem, poses, grasp)) else {
        return Vec::new();
    };
    let between = if later { between.without_later() } else { between };
    let (motion, middle) = (&problem.motions[grasp], problem.middle(poses));
    let about = |pose: &Pose| spread::<D>(pose, &middle, motion.deviations);
    let mut starts = about(&(motion.pose * poses[grasp - 1]));
    starts.extend(about(&poses[grasp]));
    let all = |pose: &Pose| cost(problem, &surface, &felt, pose) + between.cost(pose);
    let slopes = |pose: &Pose| {
        let (touched, moved) = (normal(problem, &surface, &felt, pose), between.normal(pose));
        (touched.0 + moved.0, touched.1 + moved.1)
    };
    let found = starts.into_par_iter().filter_map(|start| least::<D>(start, all, slopes));
    let mut found: Vec<(f64, Pose)> = found.collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut apart = vec![poses[grasp]];
    for (_, pose) in found {
        if apart.len() <= TRIED && !apart.iter().any(|other| are_near(other, &pose, SAME)) {
            apart.push(pose);
        }
    }
    apart.split_off(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::joint::tangent::local;
    use crate::quantity::Deviation;
    use crate::sim::{Options, simulate};
    use crate::slam::track;
    use crate::space::Point;

    #[test]
    fn a_grasp_at_the_wrong_place_of_the_surface_is_found_again() {
        let options = Options {
            grasps: Some(10),
            motion_noise: Deviation { length: 8e-3, angle: 0.3 },
            seed: 3,
            ..Options::new("ellipse:0.12x0.07".parse().unwrap())
        };
        let log = simulate(&options).unwrap().log;
        let problem = Problem::new(&log);
        let truth: Vec<Pose> = track::truth(&log).unwrap().iter().map(|s| s.pose).collect();
        // One grasp and all after it turned, and another one more: one and a half deviations of a slip each.
        let (wrong, alone) = (4, 7);
        let off = Pose::rotation(Point::new(0.0, 0.0, 0.45));
        let mut poses = truth.clone();
        poses[wrong..].iter_mut().for_each(|pose| *pose *= off);
        poses[alone] *= off;
        let turned = |poses: &[Pose]| {
            let off = truth.iter().zip(poses).map(|(t, p)| local(t, p)[5].abs());
            off.fold(0.0, f64::max)
        };
        let settled = settle::<3>(&problem, poses).unwrap();
        let before = (settled.cost, turned(&settled.poses));
        let found = revised(&problem, settled);
        let after = (found.cost, turned(&found.poses));
        assert!(before.1 > 0.3 && after.1 < 0.15, "{before:?} {after:?}");
        assert!(after.0 < before.0 - 20.0, "{before:?} {after:?}");
        // From the truth there is nothing to be found that is far likelier.
        let at_best = settle::<3>(&problem, truth.clone()).unwrap();
        assert!(after.0 < at_best.cost + 5.0, "{after:?} {}", at_best.cost);
    }
}
