//! Figures 4.6 and 4.7: grasps imagined on an object whose pose is uncertain, by particles. The contacts
//! to be expected at the likeliest pose weigh the poses; the divergence of the posterior from the prior
//! says what the grasp would tell. Then each grasp is made, and what it told is compared.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
use std::fmt;

use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use super::{FigureError, touched};
use crate::experiment::Spread;
use crate::experiment::proportion::Proportion;
use crate::explore::entropy::{divergence, renyi};
use crate::explore::placement::Placement;
use crate::explore::prediction::predict;
use crate::explore::{Belief, Criterion};
use crate::shape::Geometry;
use crate::sim::random::Random;
use crate::sim::{Options, SimError, Touch};
use crate::space::{Point, Pose};
use crate::view::drawing::Drawing;
use crate::view::scatter::{self, Cloud, Scatter};
use crate::view::sheet::{self, Panel, Sheet};

const OBJECT: &str = "rectangle:0.10x0.06";

/// Contacts all around from which the shape is known.
const CONTACTS: usize = 30;

/// Doubt about the pose: metres per axis, radians.
const DOUBT: (f64, f64) = (5e-3, 10.0 * std::f64::consts::PI / 180.0);

/// Poses that stand for the distribution.
const PARTICLES: usize = 2000;

/// Slopes of the field below this do not make its value a distance.
const LEAST_SLOPE: f64 = 0.3;

/// What can be done: how far the hand is turned from the first grasp's side, and its posture.
const ACTIONS: [(&str, f64, f64); 3] = [
    ("A, on a long side", 0.0, 0.5),
    ("B, askew", FRAC_PI_4, 1.0),
    ("C, on a short side", FRAC_PI_2, 0.5),
];

/// What one action promised and gave.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Action {
    /// Which; the last row is whatever the divergence chose.
    pub action: String,
    /// Contacts to be expected.
    pub contacts: Option<Spread>,
    /// KL(posterior ‖ prior), nats (4.6); with equally likely poses also the fall of Shannon's entropy.
    pub divergence: Option<Spread>,
    /// KL(prior ‖ posterior), as printed, without the poses that became impossible.
    pub printed: Option<Spread>,
    /// Fall of the Rényi entropy, α = 2, nats (4.4).
    pub renyi: Option<Spread>,
    /// Fall of ½ log det Σ, nats (4.21).
    pub determinant: Option<Spread>,
    /// What [`Criterion::Kl`] promises, nats: 64 poses, linear contacts.
    pub promised: Option<Spread>,
    /// Runs in which the divergence was greatest.
    pub chosen: Proportion,
    /// Runs in which the pose was nearest to the truth after it was made.
    pub nearest: Proportion,
    /// Error of the mean pose after it was made: millimetres.
    pub error_mm: Option<Spread>,
    /// The same in degrees.
    pub error_deg: Option<Spread>,
}

/// An object whose shape is known and whose pose is not.
struct Subject {
    belief: Belief,
    truth: Geometry,
    /// x, y and turn, equally likely.
    poses: Vec<[f64; 3]>,
    random: Random,
}

/// What was felt, believed object frame.
type Felt = Vec<(Point, Point)>;

impl Subject {
    fn new(seed: u64) -> Result<Subject, FigureError> {
        let object = OBJECT.parse().map_err(SimError::from)?;
        let usual = Options::new(object);
        let options =
            Options { grasps: Some(1), contacts: CONTACTS, touch: Touch::Uniform, seed, ..usual };
        let (mut belief, truth) = touched(&options)?;
        let (shift, turn) = (DOUBT.0.powi(2), DOUBT.1.powi(2));
        belief.covariance =
            nalgebra::Matrix6::from_diagonal(&[shift, shift, 0.0, 0.0, 0.0, turn].into());
        let [mut draws, random] = Random::streams(seed ^ 0x47);
        let poses = (0..PARTICLES).map(|_| drawn(&mut draws)).collect();
        Ok(Subject { belief, truth, poses, random })
    }

    fn placements(&self) -> Vec<Placement> {
        // The first action faces +y of the object, which is a long side.
        let of = |(_, turn, spread): &(&str, f64, f64)| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *turn);
            Placement { hand: Pose::from_parts(self.belief.centre.into(), turn), spread: *spread }
        };
        ACTIONS.iter().map(of).collect()
    }

    fn reach(&self) -> f64 {
        self.belief.radius
    }

    /// What the fingers meet when the object is at `pose`, without noise.
    fn closed(&self, placement: &Placement, pose: &[f64; 3]) -> Felt {
        let moved = self.truth.transformed(&isometry(pose));
        let strokes = placement.strokes(2, self.reach());
        let one = |stroke: &crate::sim::touch::Stroke| {
            let start = (placement.hand * Point3::from(stroke.start)).coords;
            let direction = placement.hand.rotation * stroke.direction;
            let (along, normal) = moved.cast(&start, &direction, stroke.travel)?;
            Some((start + along * direction, normal))
        };
        strokes.iter().filter_map(one).collect()
    }

    /// The weights of the poses once this was felt: by the calibrated distance and the normal of each
    /// contact, the surface's own doubt about both being part of the noise.
    fn weigh(&self, felt: &Felt) -> Vec<f64> {
        let (point, turn) = self.belief.noise;
        let one = |pose: &[f64; 3]| -> f64 {
            let back = isometry(pose).inverse();
            let at: Vec<Point> =
                felt.iter().map(|(p, _)| (back * Point3::from(*p)).coords).collect();
            let mut sum = 0.0;
            for (field, (_, normal)) in self.belief.surface.evaluate(&at).iter().zip(felt) {
                let slope = field.gradient.norm().max(LEAST_SLOPE);
                let distance = point * point + field.variance / (slope * slope);
                let bend = turn * turn + field.gradient_variance / (slope * slope);
                let angle = field.gradient.angle(&(back.rotation * normal));
                sum += (field.value / slope).powi(2) / distance + distance.ln();
                sum += angle * angle / bend + bend.ln();
            }
            -0.5 * sum
        };
        let logs: Vec<f64> = self.poses.par_iter().map(one).collect();
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut weights: Vec<f64> = logs.iter().map(|l| (l - most).exp()).collect();
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
        weights
    }

    /// Contacts with noise.
    fn sensed(&mut self, felt: Felt) -> Felt {
        let (point, turn) = self.belief.noise;
        felt.into_iter()
            .map(|(p, n)| {
                let noise = self.random.normal3();
                let bent = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn * noise.z);
                (p + point * Point::new(noise.x, noise.y, 0.0), bent * n)
            })
            .collect()
    }
}

fn drawn(random: &mut Random) -> [f64; 3] {
    let noise = random.normal3();
    [DOUBT.0 * noise.x, DOUBT.0 * noise.y, DOUBT.1 * noise.z]
}

fn isometry([x, y, turn]: &[f64; 3]) -> Pose {
    Isometry3::new(Vector3::new(*x, *y, 0.0), Vector3::z() * *turn)
}

/// Weighted mean and ½ log det of the weighted covariance, turns as arcs at `radius` metres.
fn moments(poses: &[[f64; 3]], weights: &[f64], radius: f64) -> (Vector3<f64>, f64) {
    let scaled = |p: &[f64; 3]| Vector3::new(p[0], p[1], p[2] * radius);
    let mean: Vector3<f64> = poses.iter().zip(weights).map(|(p, w)| scaled(p) * *w).sum();
    let mut spread = Matrix3::identity() * 1e-10;
    for (p, w) in poses.iter().zip(weights) {
        let e = scaled(p) - mean;
        spread += e * e.transpose() * *w;
    }
    let log = 0.5 * spread.determinant().max(1e-30).ln();
    (Vector3::new(mean.x, mean.y, mean.z / radius), log)
}

/// Numbers of one action in one run.
#[derive(Clone, Copy)]
struct Told {
    contacts: f64,
    divergence: f64,
    printed: f64,
    renyi: f64,
    determinant: f64,
    promised: f64,
    /// Metres and radians.
    error: (f64, f64),
}

/// Imagines every action, then makes it from the same pose.
fn told(seed: u64) -> Result<[Told; 3], FigureError> {
    let mut subject = Subject::new(seed)?;
    let radius = subject.belief.radius;
    let uniform = vec![1.0 / PARTICLES as f64; PARTICLES];
    let placements = subject.placements();
    let expected = predict(&subject.belief, &placements);
    let promised = Criterion::Kl.scores(&subject.belief, &expected);
    let before = moments(&subject.poses, &uniform, radius).1;
    let true_pose = drawn(&mut subject.random);
    let mut all = Vec::with_capacity(ACTIONS.len());
    for (k, placement) in placements.iter().enumerate() {
        let felt: Felt = expected[k].iter().map(|e| (e.point, e.normal)).collect();
        let weights = subject.weigh(&felt);
        let possible: Vec<(f64, f64)> = uniform
            .iter()
            .copied()
            .zip(weights.iter().copied())
            .filter(|(_, w)| *w > 1e-300)
            .collect();
        let (prior, posterior): (Vec<f64>, Vec<f64>) = possible.into_iter().unzip();
        let made = subject.closed(placement, &true_pose);
        let made = subject.sensed(made);
        let (mean, _) = moments(&subject.poses, &subject.weigh(&made), radius);
        let off = (mean.xy() - Vector3::from(true_pose).xy()).norm();
        all.push(Told {
            contacts: felt.len() as f64,
            divergence: divergence(&weights, &uniform),
            printed: divergence(&prior, &posterior),
            renyi: renyi(&uniform, 2.0) - renyi(&weights, 2.0),
            determinant: before - moments(&subject.poses, &weights, radius).1,
            promised: promised[k],
            error: (off, (mean.z - true_pose[2]).abs()),
        });
    }
    Ok([all[0], all[1], all[2]])
}

/// One row for each action and one for what the divergence chose.
pub(super) fn judge(seeds: u64) -> Result<Vec<Action>, FigureError> {
    Subject::new(0)?;
    let runs: Vec<[Told; 3]> =
        (0..seeds).into_par_iter().filter_map(|seed| told(seed).ok()).collect();
    let by = |run: &[Told; 3], f: fn(&Told) -> f64| {
        (0..run.len()).max_by(|a, b| f(&run[*a]).total_cmp(&f(&run[*b]))).unwrap_or(0)
    };
    // Turns as arcs at 5 cm.
    let near = |t: &Told| -(t.error.0 + 0.05 * t.error.1);
    let line = |name: &str, pick: &dyn Fn(&[Told; 3]) -> usize| {
        let spread = |f: fn(&Told) -> f64| Spread::of(runs.iter().map(|r| f(&r[pick(r)])));
        Action {
            action: name.into(),
            contacts: spread(|t| t.contacts),
            divergence: spread(|t| t.divergence),
            printed: spread(|t| t.printed),
            renyi: spread(|t| t.renyi),
            determinant: spread(|t| t.determinant),
            promised: spread(|t| t.promised),
            chosen: Proportion::of(runs.iter().map(|r| by(r, |t| t.divergence) == pick(r))),
            nearest: Proportion::of(runs.iter().map(|r| by(r, near) == pick(r))),
            error_mm: spread(|t| 1e3 * t.error.0),
            error_deg: spread(|t| t.error.1.to_degrees()),
        }
    };
    let mut lines: Vec<Action> =
        ACTIONS.iter().enumerate().map(|(k, a)| line(a.0, &move |_| k)).collect();
    lines.push(line("as the divergence chooses", &|r| by(r, |t| t.divergence)));
    Ok(lines)
}

/// Figure 4.6 of seed 0.
pub(super) fn grasps(title: &str) -> Result<Drawing, FigureError> {
    let subject = Subject::new(0)?;
    let placements = subject.placements();
    let expected = predict(&subject.belief, &placements);
    let panel = |k: usize| {
        let strokes = placements[k].strokes(2, subject.reach());
        let start = |finger: usize| {
            let stroke = strokes.iter().find(|s| s.finger == finger)?;
            // The last 4 cm of its way.
            Some(placements[k].hand.rotation * stroke.direction * 0.04)
        };
        Panel {
            title: ACTIONS[k].0.into(),
            note: format!("{} contacts to be expected", expected[k].len()),
            truth: subject.truth.clone(),
            estimate: Some(subject.belief.geometry.clone()),
            deviations: Vec::new(),
            contacts: expected[k].iter().map(|e| (e.point, Some(e.normal))).collect(),
            groups: Vec::new(),
            links: expected[k]
                .iter()
                .filter_map(|e| Some([e.point - start(e.finger)?, e.point]))
                .collect(),
        }
    };
    let panels = (0..ACTIONS.len()).map(panel).collect();
    Ok(sheet::render(&Sheet { title: title.into(), columns: 3, panels })?)
}

/// Figure 4.7 of seed 0.
pub(super) fn poses(title: &str) -> Result<Drawing, FigureError> {
    let subject = Subject::new(0)?;
    let uniform = vec![1.0 / PARTICLES as f64; PARTICLES];
    let expected = predict(&subject.belief, &subject.placements());
    let cloud = |title: &str, note: String, weights: &[f64]| {
        let place = |p: &[f64; 3]| [1e3 * p[0], 1e3 * p[1]];
        let points = subject.poses.iter().zip(weights).map(|(p, w)| (place(p), *w)).collect();
        Cloud { title: title.into(), note, points, chosen: false }
    };
    let prior = format!(
        "deviations {:.0} mm, {:.0} mm, {:.0}°",
        1e3 * DOUBT.0,
        1e3 * DOUBT.0,
        DOUBT.1.to_degrees()
    );
    let mut clouds = vec![cloud("before", prior, &uniform)];
    let mut told = Vec::new();
    for (contacts, (name, ..)) in expected.iter().zip(ACTIONS) {
        let felt: Felt = contacts.iter().map(|e| (e.point, e.normal)).collect();
        let weights = subject.weigh(&felt);
        let deviation = |axis: usize| {
            let mean: f64 = subject.poses.iter().zip(&weights).map(|(p, w)| p[axis] * w).sum();
            let square = |(p, w): (&[f64; 3], &f64)| (p[axis] - mean).powi(2) * w;
            subject.poses.iter().zip(&weights).map(square).sum::<f64>().sqrt()
        };
        let kl = divergence(&weights, &uniform);
        let note = format!(
            "KL {kl:.1} nats; {:.1} mm, {:.1} mm, {:.1}°",
            1e3 * deviation(0),
            1e3 * deviation(1),
            deviation(2).to_degrees()
        );
        told.push(kl);
        clouds.push(cloud(name, note, &weights));
    }
    let best = (0..told.len()).max_by(|a, b| told[*a].total_cmp(&told[*b]));
    if let Some(cloud) = best.and_then(|k| clouds.get_mut(k + 1)) {
        cloud.chosen = true;
        cloud.title.push_str(": chosen");
    }
    let scatter = Scatter {
        title: title.into(),
        across: "x of the object, mm".into(),
        up: "y of the object, mm".into(),
        clouds,
        mark: [0.0, 0.0],
    };
    Ok(scatter::render(&scatter)?)
}

pub(super) fn show(f: &mut fmt::Formatter<'_>, lines: &[Action]) -> fmt::Result {
    writeln!(
        f,
        "  {:<28}{:<20}{:<20}{:<25}{:<20}{:<20}{:<20}{:<20}{:<20}{:<20}error °",
        "action",
        "KL nats",
        "promised",
        "KL as printed",
        "Rényi 2",
        "½ log det",
        "chosen",
        "nearest",
        "contacts",
        "error mm"
    )?;
    let show = |s: &Option<Spread>| s.map_or("–".to_owned(), |s| s.to_string());
    for line in lines {
        writeln!(
            f,
            "  {:<28}{:<20}{:<20}{:<25}{:<20}{:<20}{:<20}{:<20}{:<20}{:<20}{}",
            line.action,
            show(&line.divergence),
            show(&line.promised),
            show(&line.printed),
            show(&line.renyi),
            show(&line.determinant),
            line.chosen.to_string(),
            line.nearest.to_string(),
            show(&line.contacts),
            show(&line.error_mm),
            show(&line.error_deg)
        )?;
    }
    write!(
        f,
        "  {OBJECT} after {CONTACTS} contacts, its pose unknown by 5 mm per axis and 10°, {PARTICLES} poses; \
         median [quartiles], Wilson's 95 % intervals;\n  chosen: greatest KL before; nearest: least \
         error once made (turns as arcs at 5 cm)"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grasp_on_two_sides_tells_more_than_one_on_parallel_ones() {
        let lines = judge(3).unwrap();
        assert_eq!(lines.len(), 4);
        let kl = |k: usize| lines[k].divergence.unwrap().median;
        // The long sides leave the place along them to chance.
        assert!(kl(1) > kl(0) + 0.5, "{lines:?}");
        assert!(lines[3].divergence.unwrap().median >= kl(1) - 1e-9);
        assert_eq!(lines[3].chosen.successes, 3);
        assert!(lines[3].error_mm.unwrap().median < 4.0, "{lines:?}");
        for line in &lines {
            assert!(line.divergence.unwrap().low >= 0.0 && line.printed.unwrap().low >= 0.0);
        }
    }

    #[test]
    fn what_fits_every_pose_tells_nothing() {
        let subject = Subject::new(1).unwrap();
        let weights = subject.weigh(&Vec::new());
        let uniform = vec![1.0 / PARTICLES as f64; PARTICLES];
        assert!(divergence(&weights, &uniform).abs() < 1e-9);
        let (mean, _) = moments(&subject.poses, &weights, 0.05);
        assert!(mean.norm() < 0.01);
    }
}
