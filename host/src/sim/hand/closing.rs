//! Bringing a hand somewhere and closing it: what it runs into, what its fingertips feel, and how the
//! object gives way.

use nalgebra::{Point3, Translation3, UnitQuaternion};

use super::articulated::{Articulated, Finger};
use super::collision::{Near, Surroundings, links_near};
use crate::shape::Mesh;
use crate::space::{Point, Pose};

/// Steps of a closing at most. Fingers that still move then, along something they never touch, stay
/// where they are.
const MOST_STEPS: usize = 4000;

/// A link that is further from the object than this by the ball around it is not looked at more closely,
/// metres.
const APART: f64 = 5e-3;

/// How far a hand comes straight from, metres.
pub const APPROACH: f64 = 0.1;

/// The radius of an object's support that resists turning as all of it resists shifting, in the radius of
/// the object: an evenly pressed disc has about this.
const SUPPORT: f64 = 0.6;

/// Why a hand cannot be where it is asked to be.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unreachable {
    /// The arm is too short.
    #[error("the palm would be {:.0} mm from the shoulder, and the arm reaches {:.0} mm", 1e3 * distance, 1e3 * reach)]
    OutOfReach {
        /// From the shoulder, metres.
        distance: f64,
        /// Of the arm, metres.
        reach: f64,
    },
    /// A part of the palm meets the object on the way or at its end.
    #[error("the palm ({link}) meets the object")]
    PalmMeetsObject {
        /// Which part.
        link: String,
    },
    /// An open finger does.
    #[error("the open finger {finger} meets the object")]
    FingerMeetsObject {
        /// Which finger.
        finger: String,
    },
    /// A part of the hand meets the table.
    #[error("{link} meets the table")]
    MeetsTable {
        /// Which part.
        link: String,
    },
    /// The belief says that no fingertip would touch anything.
    #[error("no fingertip would touch anything")]
    NothingFelt,
    /// The place is no number.
    #[error("the pose of the palm is not finite")]
    NotFinite,
}

/// What one fingertip felt, object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touched {
    /// Index of the hand's finger.
    pub finger: usize,
    /// On the object's surface, metres.
    pub point: Point,
    /// Out of the object, unit.
    pub normal: Point,
}

/// A hand that has closed.
#[derive(Clone, Debug, PartialEq)]
pub struct Closed {
    /// What the fingertips feel.
    pub touched: Vec<Touched>,
    /// Fingers that feel nothing, and where their fingertips are, world frame, metres: stopped by their
    /// own limits, by another link, by the table or another finger.
    pub free: Vec<(usize, Point)>,
    /// Where the object is afterwards, object to world.
    pub object: Option<Pose>,
    /// Values of the coordinates.
    pub joints: Vec<f64>,
}

impl Articulated {
    /// The pose of the root (root to world) for a pose of the grasp frame.
    pub fn root(&self, grasp: &Pose) -> Pose {
        grasp * self.grasp().inverse()
    }

    /// How far the open hand can go from `grasp` along a unit direction (world frame) before it touches
    /// something, at most `length` metres, and what stops it.
    pub fn advance(
        &self,
        grasp: &Pose,
        spread: f64,
        direction: &Point,
        length: f64,
        around: &Surroundings,
    ) -> (f64, Option<Unreachable>) {
        let (links, touching) = (&self.model().links, around.touching);
        let root = self.root(grasp);
        let poses = self.model().forward(&self.joints(spread, &[]));
        let poses: Vec<Pose> = poses.iter().map(|p| root * p).collect();
        // Up to where each link is known to meet nothing: the one that is known the least far is looked at.
        let mut clear = vec![0f64; links.len()];
        loop {
            let least = (0..links.len()).min_by(|a, b| clear[*a].total_cmp(&clear[*b]));
            let Some(l) = least.filter(|l| clear[*l] < length) else { return (length, None) };
            let (link, along) = (&links[l], clear[l]);
            let pose = Translation3::from(along * direction) * poses[l];
            let above = self.sinking(around.above_table(link, &pose), direction);
            if above <= touching {
                return (along, Some(Unreachable::MeetsTable { link: link.name.clone() }));
            }
            let mut distance = around.apart(link, &pose);
            if distance <= APART {
                let near = around.object_near(link, &pose, APART + touching);
                distance = near.map_or(APART, |n| n.distance);
            }
            if distance <= touching || along == 0.0 && around.inside_object(link, &pose) {
                return (along, Some(self.meeting(l)));
            }
            clear[l] = along + above.min(distance - 0.25 * touching).max(0.25 * touching);
        }
    }

    /// How far a link may go before it meets the table it is so far above.
    fn sinking(&self, above: f64, direction: &Point) -> f64 {
        if above <= 0.0 || direction.z >= -1e-9 {
            // Going up or along, only a link that is in the table already meets it.
            return if above <= 0.0 { above } else { f64::INFINITY };
        }
        above / -direction.z
    }

    fn meeting(&self, link: usize) -> Unreachable {
        match self.owner(link) {
            Some(finger) => {
                Unreachable::FingerMeetsObject { finger: self.fingers()[finger].name.clone() }
            }
            None => Unreachable::PalmMeetsObject { link: self.model().links[link].name.clone() },
        }
    }

    /// How far above the height `table` the lowest point of the open hand at `grasp` is, metres; below zero
    /// where it is in the table.
    pub fn above(&self, grasp: &Pose, spread: f64, table: f64) -> f64 {
        let root = self.root(grasp);
        let around = Surroundings::new(None, Some(table));
        let poses = self.model().forward(&self.joints(spread, &[]));
        let links = self.model().links.iter().zip(poses);
        links
            .map(|(link, pose)| around.above_table(link, &(root * pose)))
            .fold(f64::INFINITY, f64::min)
    }

    /// Whether the arm is long enough for a pose of the grasp frame.
    ///
    /// # Errors
    /// When it is not, or the pose is not finite.
    pub fn within_reach(&self, grasp: &Pose) -> Result<(), Unreachable> {
        let root = self.root(grasp);
        if !root.translation.vector.iter().chain(root.rotation.coords.iter()).all(|x| x.is_finite())
        {
            return Err(Unreachable::NotFinite);
        }
        let distance = (root.translation.vector - self.arm.shoulder).norm();
        if distance > self.arm.reach {
            return Err(Unreachable::OutOfReach { distance, reach: self.arm.reach });
        }
        Ok(())
    }

    /// Whether the open hand can be brought to `grasp` (grasp frame to world): within the arm's reach, and
    /// straight from [`APPROACH`] behind without meeting the object or the table.
    ///
    /// # Errors
    /// What is in the way.
    pub fn fits(
        &self,
        grasp: &Pose,
        spread: f64,
        around: &Surroundings,
    ) -> Result<(), Unreachable> {
        self.within_reach(grasp)?;
        let back = grasp.rotation * Point::z();
        let from = Translation3::from(APPROACH * back) * grasp;
        match self.advance(&from, spread, &-back, APPROACH, around) {
            (_, Some(unreachable)) => Err(unreachable),
            (_, None) => Ok(()),
        }
    }

    /// Brings the open hand to `grasp` (grasp frame to world) and closes it. Every joint goes on until a
    /// link beyond it meets the object, the table, or another part of the hand; a finger's outer joints
    /// go on where an inner link has met something. Only what the fingertips themselves meet is felt.
    ///
    /// With `give` above zero the object yields: a finger feels its contact only after it has gone on for
    /// `give` metres (its reaction time), and it takes the object along unless fingers that touched
    /// before hold against it, in proportion to how straight they oppose. The object then shifts and
    /// turns as a body on a support with friction does when pushed slowly at one point, its limit
    /// surface an ellipsoid (Howe and Cutkosky 1996); on a table it stays upright and on the table.
    ///
    /// # Errors
    /// When the hand cannot get there; nothing has moved then.
    pub fn close(
        &self,
        grasp: &Pose,
        spread: f64,
        around: &Surroundings,
        give: f64,
    ) -> Result<Closed, Unreachable> {
        self.fits(grasp, spread, around)?;
        let mut closing = Closing {
            hand: self,
            root: self.root(grasp),
            spread,
            around: *around,
            stopped: vec![None; self.roles().len()],
            touched: Vec::new(),
            pushes: Vec::new(),
            done: vec![false; self.model().links.len()],
            share: 1.0,
        };
        closing.run(give);
        Ok(closing.finish())
    }
}

/// A hand that is closing.
struct Closing<'a> {
    hand: &'a Articulated,
    root: Pose,
    spread: f64,
    around: Surroundings<'a>,
    /// Where each coordinate stopped, as a share of its way.
    stopped: Vec<Option<f64>>,
    touched: Vec<Touched>,
    /// Directions in which links push, world frame.
    pushes: Vec<Point>,
    /// Links that have met something.
    done: Vec<bool>,
    /// How far what never stopped is closed.
    share: f64,
}

/// What a link met.
enum Met {
    Object(Near),
    Other,
}

impl Closing<'_> {
    fn run(&mut self, give: f64) {
        let mut share = 0.0f64;
        for _ in 0..MOST_STEPS {
            let poses = self.poses(share);
            let speeds: Vec<f64> = (0..poses.len()).map(|l| self.speed(l)).collect();
            if speeds.iter().all(|s| *s == 0.0) {
                return;
            }
            let mut step = 1.0 - share;
            let mut met = None;
            for link in (0..poses.len()).filter(|l| speeds[*l] > 0.0 && !self.done[*l]) {
                match self.look(link, &poses, &speeds, step) {
                    Ok(safe) => step = step.min(safe),
                    Err(what) => {
                        met = Some((link, what));
                        break;
                    }
                }
            }
            match met {
                Some((link, what)) => self.stop(link, what, share, give),
                None if share >= 1.0 => return,
                None => share = (share + step).min(1.0),
            }
        }
        // Out of steps: whatever still moves stays where it is.
        self.share = share;
    }

    /// Values of the coordinates after a share of the closing.
    fn joints(&self, share: f64) -> Vec<f64> {
        let shares: Vec<f64> = self.stopped.iter().map(|s| s.unwrap_or(share)).collect();
        self.hand.joints(self.spread, &shares)
    }

    /// Links to world.
    fn poses(&self, share: f64) -> Vec<Pose> {
        let poses = self.hand.model().forward(&self.joints(share));
        poses.iter().map(|p| self.root * p).collect()
    }

    /// Metres per whole closing that a point of the link moves at most.
    fn speed(&self, link: usize) -> f64 {
        let free = (0..self.stopped.len()).filter(|c| self.stopped[*c].is_none());
        free.map(|c| self.hand.speed(link, c)).sum()
    }

    /// How much further the closing may go before the link can meet anything, at most `most`; or what it
    /// has met.
    fn look(&self, link: usize, poses: &[Pose], speeds: &[f64], most: f64) -> Result<f64, Met> {
        let links = &self.hand.model().links;
        let (body, pose, speed) = (&links[link], &poses[link], speeds[link]);
        let touching = self.around.touching;
        let mut safe = most;
        let mut within = |distance: f64, speed: f64| {
            safe = safe.min((distance - 0.25 * touching) / speed);
            distance <= touching
        };
        if let Some(near) = self.around.object_near(body, pose, most * speed + touching)
            && within(near.distance, speed)
        {
            return Err(Met::Object(near));
        }
        let above = self.around.above_table(body, pose);
        if above.is_finite() && within(above, speed) {
            return Err(Met::Other);
        }
        for other in 0..links.len() {
            if other == link || links[other].solids.is_empty() || self.hand.together(link, other) {
                continue;
            }
            let both = speed + speeds[other];
            let near =
                links_near((body, pose), (&links[other], &poses[other]), most * both + touching);
            if near.is_some_and(|distance| within(distance, both)) {
                return Err(Met::Other);
            }
        }
        Ok(safe)
    }

    /// Stops the joints that move the link, and lets the object give way.
    fn stop(&mut self, link: usize, met: Met, share: f64, give: f64) {
        self.done[link] = true;
        for c in 0..self.stopped.len() {
            if self.hand.speed(link, c) > 0.0 && self.stopped[c].is_none() {
                self.stopped[c] = Some(share);
            }
        }
        let (Met::Object(near), Some((mesh, object))) = (met, self.around.object) else { return };
        if let Some(finger) = self.hand.owner(link)
            && self.hand.fingers()[finger].tip == link
        {
            self.touched.push(Touched { finger, point: near.point, normal: near.normal });
        }
        let push = -(object.rotation * near.normal);
        let held: f64 = self.pushes.iter().map(|p| (-p.dot(&push)).max(0.0)).sum();
        self.pushes.push(push);
        let go = give * (1.0 - held).max(0.0);
        if go > 0.0 {
            let at = (object * Point3::from(near.point)).coords;
            let moved = give_way(mesh, &object, &at, &push, go, self.around.table.is_some());
            self.around.object = Some((mesh, moved));
        }
    }

    fn finish(self) -> Closed {
        let joints = self.joints(self.share);
        let poses = self.hand.model().forward(&joints);
        let felt = |finger: usize| self.touched.iter().any(|t| t.finger == finger);
        let free = self.hand.fingers().iter().enumerate().filter(|(i, _)| !felt(*i));
        let tip = |(i, f): (usize, &Finger)| {
            (i, (self.root * poses[f.tip] * Point3::from(f.pad.0)).coords)
        };
        Closed {
            free: free.map(tip).collect(),
            touched: self.touched,
            object: self.around.object.map(|(_, pose)| pose),
            joints,
        }
    }
}

/// Where the object is after it was pushed at one of its points (world frame) for `go` metres along a
/// unit direction.
pub(super) fn give_way(
    mesh: &Mesh,
    object: &Pose,
    at: &Point,
    push: &Point,
    go: f64,
    upright: bool,
) -> Pose {
    let (low, high) = mesh.bounds();
    let support = SUPPORT * ((high - low) / 2.0).norm();
    let middle = (object * Point3::from(mesh.centroid())).coords;
    let mut push = *push;
    let mut turning = (at - middle).cross(&push);
    if upright {
        // The table takes what presses down or topples.
        push.z = 0.0;
        turning = Point::new(0.0, 0.0, ((at - middle).cross(&push)).z);
    }
    // What the pushed point moves along the push for a unit of it.
    let yielding = push.norm_squared() + turning.norm_squared() / (support * support);
    if !(support > 0.0) || yielding < 1e-6 {
        return *object;
    }
    let scale = go / yielding;
    let rotation = UnitQuaternion::from_scaled_axis(turning * (scale / (support * support)));
    let about = middle + scale * push - rotation * middle;
    Pose::from_parts(Translation3::from(about), rotation) * object
}
