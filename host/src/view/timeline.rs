//! A timeline of bounded length: of a long recording, grasps that follow one another closely become
//! one.

use std::collections::VecDeque;

use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};

use super::scene::{Grasp, Seven};
use crate::space::Pose;

/// Entries at most.
pub const MOST_GRASPS: usize = 2_000;

/// Contacts, and free points, at most.
pub const MOST_CONTACTS: usize = 20_000;

/// Grasps in the order they came. Memory is bounded by [`MOST_GRASPS`] and [`MOST_CONTACTS`] however
/// many are added.
#[derive(Clone, Debug)]
pub struct Timeline {
    grasps: VecDeque<Grasp>,
    /// Grasps that an entry stands for.
    stride: u64,
    /// Contacts, and free points, of an entry at most.
    share: usize,
    /// Contacts and free points of all.
    held: usize,
}

impl Default for Timeline {
    fn default() -> Self {
        Timeline { grasps: VecDeque::new(), stride: 1, share: usize::MAX, held: 0 }
    }
}

impl Timeline {
    /// Appends a grasp.
    pub fn push(&mut self, mut grasp: Grasp) {
        thin(&mut grasp, self.share);
        self.held += size(&grasp);
        match self.grasps.back_mut() {
            Some(last) if last.merged < self.stride => {
                self.held -= size(last) + size(&grasp);
                join(last, grasp, self.share);
                self.held += size(last);
            }
            _ => self.grasps.push_back(grasp),
        }
        if self.grasps.len() > MOST_GRASPS {
            self.halve();
        }
        while self.held > MOST_CONTACTS && self.share > 1 {
            // Twice as many entries may yet come with as many contacts.
            let most = self.grasps.iter().map(size).max().unwrap_or(0);
            self.share = (self.share.min(most) / 2).max(1);
            self.grasps.iter_mut().for_each(|g| thin(g, self.share));
            self.held = self.grasps.iter().map(size).sum();
        }
    }

    /// Two entries become one.
    fn halve(&mut self) {
        self.stride *= 2;
        let mut all = std::mem::take(&mut self.grasps).into_iter();
        while let Some(mut first) = all.next() {
            if let Some(second) = all.next() {
                join(&mut first, second, self.share);
            }
            self.grasps.push_back(first);
        }
        self.held = self.grasps.iter().map(size).sum();
    }

    /// The entries.
    pub fn into_grasps(self) -> Vec<Grasp> {
        self.grasps.into()
    }

    /// Grasps that one entry stands for.
    pub fn stride(&self) -> u64 {
        self.stride
    }
}

/// Whether nobody knows where the object was. Several grasps that became one show that one of them was lost,
/// but nothing that it felt.
pub fn is_lost(grasp: &Grasp) -> bool {
    grasp.merged <= 1 && grasp.status == Some("lost")
}

/// Nothing felt, where it says nothing about the shape and would not be told from what does.
fn forget_lost(grasp: &mut Grasp) {
    if is_lost(grasp) {
        grasp.contacts.0.clear();
        grasp.fingers.0.clear();
        grasp.free.0.clear();
    }
}

fn size(grasp: &Grasp) -> usize {
    grasp.fingers.0.len() + grasp.free.0.len() / 3
}

/// Appends `second` to `first`. What `first` felt moves along with the object to where `second` has it.
fn join(first: &mut Grasp, mut second: Grasp, share: usize) {
    forget_lost(first);
    forget_lost(&mut second);
    let moved = match (&first.pose, &second.pose) {
        (Some(before), Some(after)) => pose(after).zip(pose(before)).map(|(a, b)| a * b.inverse()),
        _ => None,
    };
    if let Some(moved) = moved {
        for contact in first.contacts.0.chunks_exact_mut(6) {
            let [x, y, z, nx, ny, nz] = [0, 1, 2, 3, 4, 5].map(|i| f64::from(contact[i]));
            let point = moved * Point3::new(x, y, z);
            let normal = moved.rotation * nalgebra::Vector3::new(nx, ny, nz);
            for (place, value) in contact.iter_mut().zip(point.iter().chain(normal.iter())) {
                *place = *value as f32;
            }
        }
        for free in first.free.0.chunks_exact_mut(3) {
            let [x, y, z] = [0, 1, 2].map(|i| f64::from(free[i]));
            let point = moved * Point3::new(x, y, z);
            free.iter_mut().zip(point.iter()).for_each(|(place, value)| *place = *value as f32);
        }
    }
    first.contacts.0.extend(second.contacts.0);
    first.fingers.0.extend(second.fingers.0);
    first.free.0.extend(second.free.0);
    first.grasp = second.grasp;
    first.merged += second.merged;
    first.touched += second.touched;
    first.time = second.time.or(first.time);
    if second.pose.is_some() {
        first.pose = second.pose;
        first.modes = second.modes;
        first.deviations = second.deviations;
        first.entropy = second.entropy;
        first.particles = second.particles;
    }
    first.truth = second.truth.or(first.truth);
    first.status = worse(first.status, second.status);
    thin(first, share);
}

/// What is to be seen of two: trouble.
fn worse(a: Option<&'static str>, b: Option<&'static str>) -> Option<&'static str> {
    let trouble = |status: Option<&str>| match status {
        Some("lost") => 4,
        Some("ambiguous") => 3,
        Some("predicted") => 2,
        Some(_) => 1,
        None => 0,
    };
    if trouble(a) > trouble(b) { a } else { b }
}

fn pose(&[x, y, z, qx, qy, qz, qw]: &Seven) -> Option<Pose> {
    let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6)?;
    Some(Pose::from_parts(Translation3::new(x, y, z), rotation))
}

/// At most `share` contacts and as many free points, evenly.
fn thin(grasp: &mut Grasp, share: usize) {
    evenly(&mut grasp.contacts.0, 6, share);
    evenly(&mut grasp.fingers.0, 1, share);
    evenly(&mut grasp.free.0, 3, share);
}

fn evenly<T: Copy>(numbers: &mut Vec<T>, each: usize, most: usize) {
    let count = numbers.len() / each;
    if count <= most {
        return;
    }
    for kept in 0..most {
        let from = kept * count / most * each;
        numbers.copy_within(from..from + each, kept * each);
    }
    numbers.truncate(most * each);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::planar;
    use crate::view::scene::{Packed, seven};

    /// A grasp of an object that moves along x, whose contacts stay where they are on it.
    fn grasp(number: u64, contacts: usize) -> Grasp {
        let x = number as f64;
        let on_object = |i: usize| [x as f32 + i as f32, 2.0, 0.0, 0.0, 1.0, 0.0];
        Grasp {
            grasp: number,
            merged: 1,
            time: Some(0.005 * x),
            pose: Some(seven(&planar(x, 0.0, 0.0))),
            status: Some(if number % 20 == 3 { "lost" } else { "tracking" }),
            touched: contacts as u64,
            contacts: Packed((0..contacts).flat_map(on_object).collect()),
            fingers: Packed((0..contacts).map(|i| i as u8).collect()),
            ..Grasp::default()
        }
    }

    #[test]
    fn a_short_recording_stays_as_it_is() {
        let all: Vec<Grasp> = (0..MOST_GRASPS as u64).map(|k| grasp(k, 2)).collect();
        let mut timeline = Timeline::default();
        all.iter().for_each(|g| timeline.push(g.clone()));
        assert_eq!(timeline.stride(), 1);
        assert!(timeline.into_grasps() == all);
    }

    #[test]
    fn a_long_recording_becomes_bounded_and_nothing_is_lost_from_the_counts() {
        let mut timeline = Timeline::default();
        (0..50_001).for_each(|k| timeline.push(grasp(k, 5)));
        let grasps = timeline.into_grasps();
        assert!((MOST_GRASPS / 2..=MOST_GRASPS).contains(&grasps.len()), "{}", grasps.len());
        assert_eq!(grasps.iter().map(|g| g.merged).sum::<u64>(), 50_001);
        assert_eq!(grasps.iter().map(|g| g.touched).sum::<u64>(), 250_005);
        let held: usize = grasps.iter().map(|g| g.fingers.0.len()).sum();
        assert!((MOST_CONTACTS / 8..=MOST_CONTACTS).contains(&held), "{held}");
        assert!(grasps.is_sorted_by_key(|g| g.grasp));
        assert_eq!(grasps.last().map(|g| g.grasp), Some(50_000));
        // The one that was lost is still to be seen.
        assert_eq!(grasps[0].status, Some("lost"));
        for g in &grasps {
            // Of one that was lost, the others are.
            assert!(!g.contacts.0.is_empty() && !is_lost(g));
            assert_eq!(g.contacts.0.len(), 6 * g.fingers.0.len());
            let x = g.pose.unwrap()[0] as f32;
            for (contact, finger) in g.contacts.0.chunks(6).zip(&g.fingers.0) {
                // Where it was on the object.
                assert!((contact[0] - x - f32::from(*finger)).abs() < 0.02, "{contact:?} {x}");
            }
        }
    }

    #[test]
    fn few_grasps_with_very_many_contacts_are_thinned() {
        let mut timeline = Timeline::default();
        (0..200).for_each(|k| timeline.push(grasp(k, 250)));
        let grasps = timeline.into_grasps();
        assert_eq!(grasps.len(), 200);
        let held: usize = grasps.iter().map(|g| g.fingers.0.len()).sum();
        assert!((MOST_CONTACTS / 4..=MOST_CONTACTS).contains(&held), "{held}");
        assert!(grasps.iter().all(|g| !g.fingers.0.is_empty() && g.touched == 250));
    }
}
