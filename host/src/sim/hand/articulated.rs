//! A hand of links and joints, and how it closes: which joints curl its fingers, which spread them, and
//! the ways of its fingertips.

use std::path::Path;

use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion};
use parry3d_f64::math::Vector;

use super::collision::links_near;
use super::urdf::{HandError, Link, Model, Motion, Problem};
use super::{Arm, FingerPath};
use crate::space::{Point, Pose};

/// The hand that comes along.
const FIVE_FINGER: &str = include_str!("../../../assets/hand/five_finger.urdf");

/// Spreads of the postures that exploration chooses among, from fingers side by side to fingers apart.
pub const SPREADS: [f64; 3] = [0.0, 0.5, 1.0];

/// Points of a fingertip's way.
const WAY: usize = 24;

/// Fingers of a hand at most.
const MOST_FINGERS: usize = 32;

/// A range is symmetric, and its joint spreads, when its middle is this near to zero, in widths.
const SYMMETRIC: f64 = 0.1;

/// Links nearer than this when the hand is open are built that way, metres.
const BUILT: f64 = 1e-3;

/// A hand from a description, with the roles of its joints.
///
/// A URDF does not say which joints curl a finger. Here a joint that moves all fingers (a wrist) stays
/// still; a turning joint whose limits are symmetric about zero spreads; every other joint closes, from
/// its open value to the limit at which the fingertips are nearer to the middle of the finger bases. Open
/// is the value nearest to zero for joints that turn, the far limit for joints that slide. All joints
/// that close do so together, each over its whole range.
#[derive(Clone, Debug)]
pub struct Articulated {
    model: Model,
    fingers: Vec<Finger>,
    roles: Vec<Role>,
    /// The finger that each link belongs to; `None` for the palm's links.
    owner: Vec<Option<usize>>,
    /// Pairs of links that are never looked at, row by row.
    together: Vec<bool>,
    /// Metres per whole closing that a point of each link moves at most by each coordinate, row by row.
    speed: Vec<f64>,
    grasp: Pose,
    ways: Vec<Vec<FingerPath>>,
    /// What carries it.
    pub arm: Arm,
}

/// A finger.
#[derive(Clone, Debug)]
pub struct Finger {
    /// Its fingertip's link name.
    pub name: String,
    /// Its fingertip, an index of [`Model::links`].
    pub tip: usize,
    /// Middle of a ball at the end of the fingertip (link frame) and its radius, metres: the fingertip
    /// where its ways are concerned.
    pub pad: (Point, f64),
    /// All its links that joints of its own move.
    pub links: Vec<usize>,
}

/// What a coordinate is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Role {
    /// Stays at this value.
    Still(f64),
    /// From the middle by so much for a spread of 1.
    Spread(f64, f64),
    /// From the open value to the closed one.
    Close(f64, f64),
}

impl Articulated {
    /// The hand that comes along: five fingers in the proportions of the Shadow Dexterous Hand.
    ///
    /// # Errors
    /// None; the type says what a description can lack.
    ///
    /// ```
    /// let hand = tactile_host::sim::hand::Articulated::five_finger().unwrap();
    /// assert_eq!(hand.fingers().len(), 5);
    /// ```
    pub fn five_finger() -> Result<Articulated, HandError> {
        let file = "the five-finger hand";
        Articulated::new(Model::parse(FIVE_FINGER, file, None)?, &[], file)
    }

    /// Reads a description; `tips` names the fingertips, none to take every last link.
    ///
    /// # Errors
    /// When the file cannot be read or describes no hand.
    pub fn read(file: &Path, tips: &[String]) -> Result<Articulated, HandError> {
        Articulated::new(Model::read(file)?, tips, &file.display().to_string())
    }

    /// The hand of a model; `file` is its name in errors.
    ///
    /// # Errors
    /// When it has no fingertips.
    pub fn new(model: Model, tips: &[String], file: &str) -> Result<Articulated, HandError> {
        let refuse = |problem: Problem| HandError { file: file.into(), problem: problem.into() };
        let tips = model.tips(tips).map_err(refuse)?;
        if tips.len() > MOST_FINGERS {
            let problem = Problem::Many { what: "fingers", found: tips.len(), most: MOST_FINGERS };
            return Err(refuse(problem));
        }
        if let Some(twice) = (1..tips.len()).find(|i| tips[..*i].contains(&tips[*i])) {
            let name = model.links[tips[twice]].name.clone();
            return Err(refuse(Problem::Tip { name, problem: "it is named twice" }));
        }
        let owner = owners(&model, &tips);
        let finger = |(number, tip): (usize, &usize)| Finger {
            name: model.links[*tip].name.clone(),
            tip: *tip,
            pad: pad(&model.links[*tip]),
            links: (0..owner.len()).filter(|l| owner[*l] == Some(number)).collect(),
        };
        let fingers: Vec<Finger> = tips.iter().enumerate().map(finger).collect();
        let moved = moved(&model);
        let roles = roles(&model, &fingers, &owner, &moved);
        let mut hand = Articulated {
            speed: Vec::new(),
            together: Vec::new(),
            grasp: Pose::identity(),
            ways: Vec::new(),
            arm: Arm::default(),
            model,
            fingers,
            roles,
            owner,
        };
        hand.speed = hand.speeds(&moved);
        hand.together = hand.built_together();
        hand.grasp = hand.grasp_frame();
        hand.ways = SPREADS.iter().map(|spread| hand.sweep(*spread)).collect();
        Ok(hand)
    }

    /// Links and joints.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// In the order of the description.
    pub fn fingers(&self) -> &[Finger] {
        &self.fingers
    }

    /// One per coordinate.
    pub fn roles(&self) -> &[Role] {
        &self.roles
    }

    /// The finger that a link belongs to; `None` for the palm's links.
    pub fn owner(&self, link: usize) -> Option<usize> {
        self.owner.get(link).copied().flatten()
    }

    /// Values of the coordinates: spread by `spread` (0 side by side, 1 apart), every joint that closes
    /// at its share of the way (0 open, 1 closed), missing shares 0.
    pub fn joints(&self, spread: f64, shares: &[f64]) -> Vec<f64> {
        let one = |(index, role): (usize, &Role)| match role {
            Role::Still(value) => *value,
            Role::Spread(middle, reach) => middle + spread * reach,
            Role::Close(open, closed) => {
                open + shares.get(index).copied().unwrap_or(0.0) * (closed - open)
            }
        };
        self.roles.iter().enumerate().map(one).collect()
    }

    /// The grasp frame in the root's: origin in the middle of the half-closed fingertips, z from there
    /// back to the palm, x along the widest side of the finger bases. A placement is the pose of this
    /// frame.
    pub fn grasp(&self) -> &Pose {
        &self.grasp
    }

    /// The ways of the fingertips in the grasp frame, for the spread of [`SPREADS`] that is nearest.
    pub fn paths(&self, spread: f64) -> &[FingerPath] {
        let apart = |i: &usize| (SPREADS[*i] - spread).abs();
        let nearest = (0..SPREADS.len()).min_by(|a, b| apart(a).total_cmp(&apart(b)));
        nearest.and_then(|i| self.ways.get(i)).map_or(&[], Vec::as_slice)
    }

    /// Least and greatest extent of the open hand (spread 0) along each axis of the grasp frame, metres.
    pub fn extents(&self) -> (Point, Point) {
        let poses = self.model.forward(&self.joints(0.0, &[]));
        let back = self.grasp.inverse();
        let (mut low, mut high) = (Point::repeat(f64::INFINITY), Point::repeat(f64::NEG_INFINITY));
        for (link, pose) in self.model.links.iter().zip(&poses) {
            for solid in &link.solids {
                let at = back * pose * solid.origin;
                let bounds = solid.shape.compute_aabb(&crate::shape::mesh::parry(&at));
                let point = |v: Vector| Point::new(v.x, v.y, v.z);
                low = low.inf(&point(bounds.mins));
                high = high.sup(&point(bounds.maxs));
            }
        }
        (low, high)
    }

    /// Metres per whole closing that a point of `link` moves at most by coordinate `coordinate`.
    pub(super) fn speed(&self, link: usize, coordinate: usize) -> f64 {
        self.speed[link * self.roles.len() + coordinate]
    }

    /// Whether two links may be near each other because the hand is built that way.
    pub(super) fn together(&self, a: usize, b: usize) -> bool {
        self.together[a * self.model.links.len() + b]
    }

    fn tips(&self, joints: &[f64]) -> Vec<Point> {
        let poses = self.model.forward(joints);
        let tip = |f: &Finger| (poses[f.tip] * Point3::from(f.pad.0)).coords;
        self.fingers.iter().map(tip).collect()
    }

    fn sweep(&self, spread: f64) -> Vec<FingerPath> {
        let share = |k: usize| vec![k as f64 / (WAY - 1) as f64; self.roles.len()];
        let back = self.grasp.inverse();
        let tips: Vec<Vec<Point>> =
            (0..WAY).map(|k| self.tips(&self.joints(spread, &share(k)))).collect();
        let path = |(finger, f): (usize, &Finger)| FingerPath {
            finger,
            points: tips.iter().map(|t| (back * Point3::from(t[finger])).coords).collect(),
            radius: f.pad.1,
        };
        self.fingers.iter().enumerate().map(path).collect()
    }

    fn grasp_frame(&self) -> Pose {
        let half = self.joints(0.5, &vec![0.5; self.roles.len()]);
        let middle = mean(&self.tips(&half));
        let bases = bases(&self.model, &self.fingers, &half);
        let palm = mean(&bases);
        let back = (palm - middle).try_normalize(1e-6).unwrap_or_else(Point::z);
        let across: Vec<Point> =
            bases.iter().map(|b| (b - palm) - back * back.dot(&(b - palm))).collect();
        let widest = across.iter().copied().max_by(|a, b| a.norm().total_cmp(&b.norm()));
        let least = Point::ith(back.iamin(), 1.0);
        let x = widest
            .and_then(|w| w.try_normalize(1e-4))
            .unwrap_or_else(|| back.cross(&least).normalize());
        let rotation = Rotation3::from_basis_unchecked(&[x, back.cross(&x), back]);
        Pose::from_parts(
            Translation3::from(middle),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    fn speeds(&self, moved: &[Vec<usize>]) -> Vec<f64> {
        let count = self.roles.len();
        let mut speed = vec![0.0; self.model.links.len() * count];
        for (l, link) in self.model.links.iter().enumerate() {
            let mut lever = link
                .solids
                .iter()
                .map(|s| s.origin.translation.vector.norm() + s.radius)
                .fold(0.0, f64::max);
            // From the link back to the root, ever farther from the joints.
            for at in self.model.chain(l).into_iter().rev() {
                let Some(joint) = &self.model.links[at].joint else { continue };
                let (drive, per_unit, slide) = match joint.motion {
                    Motion::Fixed => (None, 0.0, 0.0),
                    Motion::Turn(_, drive) => (Some(drive), lever, 0.0),
                    Motion::Slide(_, drive) => {
                        let c = &self.model.coordinates[drive.coordinate];
                        let farthest =
                            [c.lower, c.upper].map(|v| (drive.factor * v + drive.offset).abs());
                        (Some(drive), 1.0, farthest[0].max(farthest[1]))
                    }
                };
                if let Some(drive) = drive
                    && let Role::Close(open, closed) = self.roles[drive.coordinate]
                {
                    debug_assert!(moved[drive.coordinate].contains(&l));
                    speed[l * count + drive.coordinate] +=
                        per_unit * (drive.factor * (closed - open)).abs();
                }
                lever += joint.origin.translation.vector.norm() + slide;
            }
        }
        speed
    }

    fn built_together(&self) -> Vec<bool> {
        let count = self.model.links.len();
        let mut together = vec![false; count * count];
        for spread in SPREADS {
            let poses = self.model.forward(&self.joints(spread, &[]));
            for a in 0..count {
                for b in 0..count {
                    let same = self.owner[a] == self.owner[b];
                    let touch = || {
                        let links = [a, b].map(|l| (&self.model.links[l], &poses[l]));
                        links_near(links[0], links[1], BUILT).is_some()
                    };
                    together[a * count + b] |= same || touch();
                }
            }
        }
        together
    }
}

fn mean(points: &[Point]) -> Point {
    points.iter().sum::<Point>() / points.len().max(1) as f64
}

/// Where the own part of each finger begins, root frame.
fn bases(model: &Model, fingers: &[Finger], joints: &[f64]) -> Vec<Point> {
    let poses = model.forward(joints);
    let first = |f: &Finger| f.links.first().map(|l| poses[*l].translation.vector);
    fingers.iter().filter_map(first).collect()
}

/// The links that each coordinate moves.
fn moved(model: &Model) -> Vec<Vec<usize>> {
    let mut moved = vec![Vec::new(); model.coordinates.len()];
    for link in 0..model.links.len() {
        for l in model.chain(link) {
            let joint = model.links[l].joint.as_ref().map(|j| j.motion);
            if let Some(Motion::Turn(_, drive) | Motion::Slide(_, drive)) = joint
                && !moved[drive.coordinate].contains(&link)
            {
                moved[drive.coordinate].push(link);
            }
        }
    }
    moved
}

/// The finger of each link: what carries one fingertip alone from the first joint that moves on, and what
/// hangs on that.
fn owners(model: &Model, tips: &[usize]) -> Vec<Option<usize>> {
    let mut carried: Vec<Vec<usize>> = vec![Vec::new(); model.links.len()];
    for (finger, tip) in tips.iter().enumerate() {
        for link in model.chain(*tip) {
            carried[link].push(finger);
        }
    }
    let mut owner: Vec<Option<usize>> = vec![None; model.links.len()];
    for (index, link) in model.links.iter().enumerate() {
        let Some(joint) = &link.joint else { continue };
        owner[index] = match carried[index][..] {
            [finger] if joint.motion != Motion::Fixed || owner[joint.parent].is_some() => {
                Some(finger)
            }
            [] => owner[joint.parent],
            _ => None,
        };
    }
    owner
}

/// A ball at the far end of the link's last solid.
fn pad(link: &Link) -> (Point, f64) {
    let end = |solid: &super::urdf::Solid| {
        let bounds = solid.shape.compute_local_aabb();
        let (half, middle) = (bounds.half_extents(), bounds.center());
        let half = Point::new(half.x, half.y, half.z);
        let radius = half.min();
        let long = half.imax();
        let shift = Point::ith(long, half[long] - radius);
        let middle = Point::new(middle.x, middle.y, middle.z);
        let ends =
            [middle + shift, middle - shift].map(|e| (solid.origin * Point3::from(e)).coords);
        let farther = if ends[0].norm() >= ends[1].norm() { ends[0] } else { ends[1] };
        (farther, radius)
    };
    let farthest = link.solids.iter().map(end);
    farthest.max_by(|a, b| a.0.norm().total_cmp(&b.0.norm())).unwrap_or((Point::zeros(), 0.0))
}

fn roles(
    model: &Model,
    fingers: &[Finger],
    owner: &[Option<usize>],
    moved: &[Vec<usize>],
) -> Vec<Role> {
    let nearest = |i: usize| 0f64.clamp(model.coordinates[i].lower, model.coordinates[i].upper);
    let middle = |i: usize| (model.coordinates[i].lower + model.coordinates[i].upper) / 2.0;
    let count = model.coordinates.len();
    let slides = |i: usize| {
        model.links.iter().any(|l| {
            matches!(&l.joint, Some(j) if matches!(j.motion, Motion::Slide(_, d) if d.coordinate == i))
        })
    };
    let width = |i: usize| model.coordinates[i].upper - model.coordinates[i].lower;
    let still = |i: usize| {
        let turns_on = width(i) >= 2.0 * std::f64::consts::PI - 1e-9 && !slides(i);
        width(i) < 1e-9 || turns_on || moved[i].iter().any(|l| owner[*l].is_none())
    };
    let spreads = |i: usize| !slides(i) && middle(i).abs() <= SYMMETRIC * width(i);
    let at_middle: Vec<f64> =
        (0..count).map(|i| if still(i) || spreads(i) { nearest(i) } else { middle(i) }).collect();
    let palm = mean(&bases(model, fingers, &at_middle));
    let tips_at = |joints: &[f64]| -> Vec<Point> {
        let poses = model.forward(joints);
        fingers.iter().map(|f| (poses[f.tip] * Point3::from(f.pad.0)).coords).collect()
    };
    // How far the fingertips that coordinate i moves are from a place when it has this value.
    let far = |joints: &[f64], i: usize, value: f64, from: &Point| {
        let mut joints = joints.to_vec();
        joints[i] = value;
        let tips = tips_at(&joints);
        let mine = fingers.iter().zip(tips).filter(|(f, _)| moved[i].contains(&f.tip));
        mine.map(|(_, tip)| (tip - from).norm()).sum::<f64>()
    };
    let mut roles: Vec<Role> = (0..count)
        .map(|i| {
            if still(i) {
                return Role::Still(nearest(i));
            }
            let (lower, upper) = (model.coordinates[i].lower, model.coordinates[i].upper);
            if spreads(i) {
                return Role::Spread(middle(i), width(i) / 2.0);
            }
            let ends = [lower, upper].map(|v| far(&at_middle, i, v, &palm));
            let (closed, other) = if ends[0] < ends[1] { (lower, upper) } else { (upper, lower) };
            let open = if slides(i) || nearest(i) == closed { other } else { nearest(i) };
            Role::Close(open, closed)
        })
        .collect();
    // Spreading moves a fingertip away from the others, with the fingers a little curled.
    let value = |role: &Role| match role {
        Role::Still(value) | Role::Spread(value, _) => *value,
        Role::Close(open, closed) => open + 0.25 * (closed - open),
    };
    let curled: Vec<f64> = roles.iter().map(value).collect();
    let all = mean(&tips_at(&curled));
    for (i, role) in roles.iter_mut().enumerate() {
        if let Role::Spread(middle, reach) = role
            && far(&curled, i, *middle + *reach, &all) < far(&curled, i, *middle - *reach, &all)
        {
            *reach = -*reach;
        }
    }
    roles
}
