//! How well the last pose is known, and would be after a grasp: against a tolerance, given the shape and
//! the doubt about it.
//!
//! An object that slips at every grasp is nowhere known better than by the last one. Whoever needs its
//! pose in the end needs a last grasp that feels all of it, which the shape alone never asks for.

use nalgebra::{DMatrix, Matrix3, Matrix6, Point3, Vector6};

use super::belief::Belief;
use super::criterion::{root, row};
use super::placement::Placement;
use super::prediction::{Expected, predict};
use super::turning::Turning;
use crate::graph::joint::tangent::{local, retract};
use crate::log::GraspLog;
use crate::quantity::Deviation;
use crate::sim::random::Random;
use crate::space::{Point, Pose};

/// Draws from the normal distribution of a pose that say how likely it is within a tolerance.
const DRAWS: usize = 256;

/// Slips over which a grasp is expected to localise, and how many of the grasps that are best without
/// a slip are looked at with them.
const SLIPS: usize = 8;
const LOOKED_AT: usize = 24;

/// The probability that the pose is within `tolerance` of the believed one, all contacts of the last
/// grasp taken: against the shape as it was known `before` that grasp, which its own contacts cannot
/// have made more certain than they are. Poses the tracker holds possible besides count by their weight.
pub fn known(before: &Belief, now: &Belief, log: &GraspLog, tolerance: &Deviation) -> f64 {
    let to_object = now.pose.inverse();
    let contacts = log.grasps.last().into_iter().flat_map(|grasp| &grasp.contacts);
    let felt = contacts.enumerate().filter_map(|(i, c)| {
        let normal = to_object.rotation * c.normal?;
        let point = (to_object * Point3::from(c.point)).coords;
        Some(Expected { finger: c.finger.unwrap_or(i), point, normal, chance: 1.0 })
    });
    let [covariance] = &after(before, &[felt.collect()])[..] else { return 0.0 };
    let total: f64 = now.modes.iter().map(|m| m.1).sum();
    let near: f64 = now
        .modes
        .iter()
        .filter(|(pose, _)| is_within(&local(&now.pose, pose), &now.centre, tolerance))
        .map(|m| m.1)
        .sum();
    let share = if total > 0.0 { near / total } else { 1.0 };
    share * within(covariance, &normals(DRAWS), &now.centre, tolerance)
}

/// The probability that the pose is within `tolerance` after each grasp, the slip before it and where
/// the fingers land then taken into account. Grasps that would not do even if the object stayed are
/// looked at no further.
pub fn expected(belief: &Belief, placements: &[Placement], tolerance: &Deviation) -> Vec<f64> {
    let draws = normals(DRAWS);
    let chance = |contacts: &[Vec<Expected>]| -> Vec<f64> {
        let covariances = after(belief, contacts);
        covariances.iter().map(|c| within(c, &draws, &belief.centre, tolerance)).collect()
    };
    let mut chances = chance(&predict(belief, placements));
    let mut order: Vec<usize> = (0..placements.len()).collect();
    order.sort_by(|a, b| chances[*b].total_cmp(&chances[*a]));
    let Some(root) = root(&belief.covariance) else { return chances };
    let slips: Vec<Pose> =
        normals(SLIPS).iter().map(|z| retract(&Pose::identity(), &(root * z)).inverse()).collect();
    let (looked_at, rest) = order.split_at(order.len().min(LOOKED_AT));
    // Of the others it is known that they are no better than the last one looked at.
    let bound = rest.first().map_or(0.0, |i| chances[*i]);
    let slipped: Vec<Placement> = looked_at
        .iter()
        .flat_map(|i| {
            slips
                .iter()
                .map(|slip| Placement { hand: slip * placements[*i].hand, ..placements[*i] })
        })
        .collect();
    let all = chance(&predict(belief, &slipped));
    for (i, each) in looked_at.iter().zip(all.chunks_exact(SLIPS)) {
        chances[*i] = each.iter().sum::<f64>() / SLIPS as f64;
    }
    let least = looked_at.iter().map(|i| chances[*i]).fold(bound, f64::min);
    rest.iter().for_each(|i| chances[*i] = chances[*i].min(least));
    chances
}

/// Covariance of the pose after each grasp from the belief, if it gives these contacts: a Kalman update
/// whose measurements are distances to the surface, in doubt as the surface is, jointly, and normals.
fn after(belief: &Belief, grasps: &[Vec<Expected>]) -> Vec<Matrix6<f64>> {
    let groups: Vec<Vec<Point>> =
        grasps.iter().map(|g| g.iter().map(|e| e.point).collect()).collect();
    let joint = belief.surface.joint_each(&groups);
    let all = groups.concat();
    let slopes = belief.surface.gradient_variances(&all);
    let faces: Vec<(f64, Matrix3<f64>)> = slopes.into_iter().zip(belief.bends(&all)).collect();
    let mut faces = &faces[..];
    let one = |(contacts, shape): (&Vec<Expected>, DMatrix<f64>)| {
        let (own, others) = faces.split_at(contacts.len());
        faces = others;
        update(belief, contacts, &shape, own)
    };
    grasps.iter().zip(joint).map(one).collect()
}

/// Where each contact's direction has this variance, and its surface bends so.
fn update(
    belief: &Belief,
    contacts: &[Expected],
    shape: &DMatrix<f64>,
    faces: &[(f64, Matrix3<f64>)],
) -> Matrix6<f64> {
    let prior = belief.covariance;
    let (point, normal) = belief.noise;
    let turnings = contacts.iter().zip(faces).enumerate().flat_map(|(i, (e, (_, bend)))| {
        let all = Turning::of(belief.dimension, &e.point, &e.normal, bend);
        all.into_iter().map(move |turning| (i, turning))
    });
    let turns: Vec<(usize, Turning)> = turnings.collect();
    let n = contacts.len();
    let rows: Vec<Vector6<f64>> =
        contacts.iter().map(row).chain(turns.iter().map(|(_, turning)| turning.row)).collect();
    let size = rows.len();
    if size == 0 {
        return prior;
    }
    // A contact that comes with probability p is worth one of 1/p times the variance.
    let seldom = |i: usize| 1.0 / contacts[i].chance.max(1e-6);
    let innovation = DMatrix::from_fn(size, size, |a, b| {
        let moved = (rows[a].transpose() * prior * rows[b])[0];
        let doubt = match (a < n, b < n) {
            (true, true) => shape[(a, b)] + if a == b { point * point * seldom(a) } else { 0.0 },
            (false, false) => {
                // What is wrong with the direction of a face is wrong for all contacts on it.
                let ((i, u), (j, v)) = (&turns[a - n], &turns[b - n]);
                let (i, j) = (*i, *j);
                let alike =
                    contacts[i].normal.dot(&contacts[j].normal).powi(2) * u.axis.dot(&v.axis);
                let common = (faces[i].0 * faces[j].0).max(0.0).sqrt() * alike;
                common + if a == b { normal * normal * seldom(i) } else { 0.0 }
            }
            _ => 0.0,
        };
        moved + doubt
    });
    let Some(factor) = innovation.cholesky() else { return prior };
    let cross = DMatrix::from_fn(size, 6, |a, j| (rows[a].transpose() * prior)[j]);
    let explained = cross.transpose() * factor.solve(&cross);
    let left = prior - Matrix6::from_fn(|i, j| explained[(i, j)]);
    (left + left.transpose()) * 0.5
}

/// Share of the normal distribution with this covariance, of which there are some `draws`, that is within
/// the tolerance at `centre`.
fn within(
    covariance: &Matrix6<f64>,
    draws: &[Vector6<f64>],
    centre: &Point,
    tolerance: &Deviation,
) -> f64 {
    // The decomposition of what is not finite need not end.
    let finite = covariance.iter().all(|v| v.is_finite());
    let Some(root) = finite.then(|| root(covariance)).flatten() else { return 0.0 };
    let good = draws.iter().filter(|z| is_within(&(root * *z), centre, tolerance)).count();
    good as f64 / draws.len() as f64
}

/// Whether a small motion of the object moves its `centre` and turns it no more than `tolerance`.
fn is_within(motion: &Vector6<f64>, centre: &Point, tolerance: &Deviation) -> bool {
    let turn: Point = motion.fixed_rows::<3>(3).into_owned();
    let shift = motion.fixed_rows::<3>(0) + turn.cross(centre);
    shift.norm() <= tolerance.length && turn.norm() <= tolerance.angle
}

/// The same standard normal numbers every time, in pairs of opposites.
fn normals(count: usize) -> Vec<Vector6<f64>> {
    let [mut random] = Random::streams(1);
    let half = count.div_ceil(2);
    let drawn = (0..half).map(|_| {
        let (a, b) = (random.normal3(), random.normal3());
        Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
    });
    drawn.flat_map(|z| [z, -z]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explore::belief::beside_each_other;
    use crate::explore::placement::fixed;
    use crate::sim::{Options, simulate};
    use crate::slam::track;

    const TOLERANCE: Deviation = Deviation { length: 3e-3, angle: 0.052_36 };

    fn belief(grasps: usize) -> Belief {
        let spec = "rectangle:0.1x0.06".parse().unwrap();
        let motion_noise = Deviation { length: 5e-3, angle: 0.1745 };
        let options = Options { grasps: Some(grasps), motion_noise, ..Options::new(spec) };
        let log = simulate(&options).unwrap().log;
        Belief::new(&log, &beside_each_other(&log, &track::truth(&log).unwrap(), None)).unwrap()
    }

    fn at(point: [f64; 2], normal: [f64; 2]) -> Expected {
        let [point, normal] = [point, normal].map(|[x, y]| Point::new(x, y, 0.0));
        Expected { finger: 0, point, normal, chance: 1.0 }
    }

    #[test]
    fn two_parallel_sides_leave_a_direction_open_and_a_third_closes_it() {
        let belief = belief(12);
        let mut pinch: Vec<Expected> = [-0.04, -0.015, 0.015, 0.04]
            .map(|x| at([x, 0.03], [0.0, 1.0]))
            .into_iter()
            .chain([at([0.0, -0.03], [0.0, -1.0])])
            .collect();
        let chance = |contacts: &Vec<Expected>| {
            let [covariance] = after(&belief, std::slice::from_ref(contacts))[..] else { panic!() };
            // No finger makes anything less certain.
            assert!((belief.covariance - covariance).symmetric_eigenvalues().min() > -1e-9);
            (
                covariance[(0, 0)].sqrt(),
                within(&covariance, &normals(DRAWS), &belief.centre, &TOLERANCE),
            )
        };
        let (along, open) = chance(&pinch);
        assert!(along > 3e-3 && open < 0.6, "{along} {open}");
        pinch.push(at([0.05, 0.01], [1.0, 0.0]));
        let (along, closed) = chance(&pinch);
        assert!(along < 1.5e-3 && closed > open + 0.2, "{along} {closed}");
        let (_, nothing) = chance(&Vec::new());
        assert!(nothing < 0.2, "{nothing}");
    }

    #[test]
    fn no_touch_tells_how_a_round_object_is_turned() {
        let left = |object: &str, felt: Vec<Expected>| {
            let options = Options { grasps: Some(10), ..Options::new(object.parse().unwrap()) };
            let log = simulate(&options).unwrap().log;
            let steps = track::truth(&log).unwrap();
            let before = Belief::new(&log, &steps).unwrap();
            let steps = beside_each_other(&log, &steps, Some(&before));
            let belief = Belief::new(&log, &steps).unwrap();
            let [covariance] = after(&belief, &[felt])[..] else { panic!() };
            covariance[(5, 5)].sqrt() / belief.covariance[(5, 5)].sqrt()
        };
        // Of what was unknown of the turn before, a touch all around leaves nearly all, or a part.
        let around = (0..8).map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 8.0).sin_cos();
            at([0.04 * cos, 0.04 * sin], [cos, sin])
        });
        let sides = [[0.04, 0.01], [-0.04, 0.02], [0.04, -0.02], [-0.04, 0.0]];
        let sides = sides.map(|p| at(p, [p[0] / 0.04, 0.0]));
        let round = left("ellipse:0.08x0.08", around.collect());
        let square = left("rectangle:0.08x0.08", sides.to_vec());
        assert!(round > 0.8 && square < 0.5, "{round} {square}");
    }

    #[test]
    fn a_shape_in_doubt_localises_less() {
        let (known, unknown) = (belief(14), belief(1));
        let sum = |belief: &Belief| {
            let chances = expected(belief, &fixed(2, &belief.centre), &TOLERANCE);
            assert!(chances.iter().all(|p| (0.0..=1.0).contains(p)));
            chances.into_iter().fold(0.0, f64::max)
        };
        let (sure, unsure) = (sum(&known), sum(&unknown));
        assert!(sure > unsure + 0.1, "{sure} {unsure}");
    }

    #[test]
    fn what_is_certain_is_within_any_tolerance() {
        let draws = normals(DRAWS);
        let within = |deviation: f64| {
            let covariance = Matrix6::identity() * deviation.powi(2);
            within(&covariance, &draws, &Point::new(0.03, 0.0, 0.0), &TOLERANCE)
        };
        assert_eq!(within(0.0), 1.0);
        assert!(within(1e-4) > 0.99 && within(0.1) < 0.01);
        assert_eq!(within(f64::NAN), 0.0);
    }
}
