//! What the hand felt lately, as it felt it: in the world frame, so that it can be placed anew.

use crate::contact::{Contact, GraspView};
use crate::matrix::Coordinates;
use crate::space::{Pose, Space};

/// A contact in the world frame. (Not a [`Contact`], so that empty memory is all zero bits.)
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch<S: Space> {
    pub point: S::Vector,
    pub normal: S::Vector,
    pub felt: bool,
    pub point_deviation: f32,
    pub normal_deviation: f32,
}

impl<S: Space> Touch<S> {
    const UNSET: Self = Touch {
        point: S::Vector::ZERO,
        normal: S::Vector::ZERO,
        felt: false,
        point_deviation: 0.0,
        normal_deviation: 0.0,
    };

    fn new(contact: &Contact<S>) -> Self {
        Touch {
            point: contact.point,
            normal: contact.normal.unwrap_or(S::Vector::ZERO),
            felt: contact.normal.is_some(),
            point_deviation: contact.point_deviation,
            normal_deviation: contact.normal_deviation,
        }
    }

    /// Unit normal, world axes.
    pub fn direction(&self) -> Option<S::Vector> {
        self.felt.then_some(self.normal)
    }

    /// As a contact in the object frame at `pose`.
    pub fn seen_from(&self, pose: &S::Pose) -> Contact<S> {
        Contact {
            point: pose.untransform(self.point),
            normal: self.direction().map(|n| pose.unrotate(n)),
            point_deviation: self.point_deviation,
            normal_deviation: self.normal_deviation,
            finger: 0,
        }
    }
}

/// How far the object may have moved beyond what the hand meant: variances per axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drift {
    /// Square metres.
    pub translation: f32,
    /// Square radians.
    pub rotation: f32,
}

impl Drift {
    pub const NONE: Self = Drift { translation: 0.0, rotation: 0.0 };

    /// The variance of a tangent's axis.
    pub fn along<S: Space>(&self, axis: usize) -> f32 {
        if axis < S::DIMENSION { self.translation } else { self.rotation }
    }
}

/// What led from the remembered grasp before to this one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Move<S: Space> {
    /// World to world.
    pub motion: S::Pose,
    pub drift: Drift,
}

/// One grasp.
#[derive(Clone, Copy, Debug)]
pub(super) struct Remembered<S: Space> {
    /// As numbered in estimates.
    pub number: u32,
    pub moved: Move<S>,
    first: u16,
    count: u16,
}

impl<S: Space> Remembered<S> {
    const UNSET: Self = Remembered {
        number: 0,
        moved: Move { motion: S::Pose::UNSET, drift: Drift::NONE },
        first: 0,
        count: 0,
    };

    /// Where its contacts are.
    pub fn touches(&self) -> core::ops::Range<usize> {
        usize::from(self.first)..usize::from(self.first + self.count)
    }
}

/// The latest grasps, oldest first.
#[derive(Clone, Debug)]
pub(super) struct Memory<S: Space, const GRASPS: usize, const CONTACTS: usize> {
    grasps: [Remembered<S>; GRASPS],
    touches: [Touch<S>; CONTACTS],
    count: usize,
    touched: usize,
}

impl<S: Space, const GRASPS: usize, const CONTACTS: usize> Memory<S, GRASPS, CONTACTS> {
    const SIZES_FIT: () = assert!(GRASPS > 1 && CONTACTS > 1 && CONTACTS < u16::MAX as usize);

    /// Contacts of one grasp at most.
    const MOST: usize = CONTACTS / 2;

    pub const fn new() -> Self {
        let () = Self::SIZES_FIT;
        Memory {
            grasps: [Remembered::UNSET; GRASPS],
            touches: [Touch::UNSET; CONTACTS],
            count: 0,
            touched: 0,
        }
    }

    pub fn clear(&mut self) {
        (self.count, self.touched) = (0, 0);
    }

    pub fn grasps(&self) -> &[Remembered<S>] {
        &self.grasps[..self.count]
    }

    pub fn touches(&self) -> &[Touch<S>] {
        &self.touches[..self.touched]
    }

    /// The touches of one grasp.
    pub fn touches_in(&self, grasp: usize) -> &[Touch<S>] {
        self.grasps().get(grasp).map_or(&[], |grasp| &self.touches[grasp.touches()])
    }

    /// How many contacts the first `grasps` grasps have.
    pub fn touches_of(&self, grasps: usize) -> usize {
        self.grasps()[..grasps.min(self.count)].last().map_or(0, |grasp| grasp.touches().end)
    }

    /// Whether a grasp of this many contacts finds room, or as many of it as are remembered.
    pub fn has_room(&self, contacts: usize) -> bool {
        self.count < GRASPS && self.touched + contacts.min(Self::MOST) <= CONTACTS
    }

    /// Remembers the usable contacts of a grasp, as many as there is room for, and no more than
    /// leave room for another; how many were left out.
    #[inline(never)]
    pub fn push(&mut self, number: u32, moved: Move<S>, grasp: &GraspView<'_, S>) -> u16 {
        let Some(place) = self.grasps.get_mut(self.count) else { return 0 };
        let (mut count, mut left) = (0, 0u16);
        for contact in grasp.usable() {
            match self.touches.get_mut(self.touched + usize::from(count)) {
                Some(touch) if usize::from(count) < Self::MOST => {
                    *touch = Touch::new(&contact);
                    count += 1;
                }
                _ => left = left.saturating_add(1),
            }
        }
        *place = Remembered { number, moved, first: self.touched as u16, count };
        self.count += 1;
        self.touched += usize::from(count);
        left
    }

    /// Forgets the latest grasp.
    pub fn pop(&mut self) {
        if let Some(last) = self.grasps().last() {
            self.touched -= usize::from(last.count);
            self.count -= 1;
        }
    }

    /// Forgets the oldest grasp; how many contacts it had.
    pub fn forget_oldest(&mut self) -> usize {
        let Some(oldest) = self.grasps().first() else { return 0 };
        let gone = oldest.count;
        self.touches.copy_within(usize::from(gone)..self.touched, 0);
        self.grasps.copy_within(1..self.count, 0);
        self.count -= 1;
        self.touched -= usize::from(gone);
        for grasp in &mut self.grasps[..self.count] {
            grasp.first -= gone;
        }
        usize::from(gone)
    }
}
