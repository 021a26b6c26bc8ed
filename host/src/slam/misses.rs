//! How far contacts lie from the shape that was made of them: some may be wild, or of a grasp at a wrong pose, and
//! who reads the results should know.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::log::GraspLog;
use crate::shape::{Geometry, metrics};
use crate::slam::place::Placed;
use crate::view::report::Unexplained;

/// Deviations, and times the usual distance, from which on a shape does not explain a contact: real surfaces are less
/// exact than sensors may be.
const FAR: f64 = 5.0;

/// Contacts of a grasp from which on it says something of them that the shape explains none.
const SEVERAL: usize = 2;

/// One contact beside the shape.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Miss {
    /// Position in the log of the grasp that felt it.
    grasp: usize,
    /// To the surface, metres.
    distance: f64,
    /// Its own with the doubt about the pose, metres.
    deviation: f64,
}

/// All contacts beside the shape.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Misses(Vec<Miss>);

impl Misses {
    /// Of contacts and surface in one frame; none of an empty surface.
    pub fn of(contacts: &[Placed], surface: &Geometry) -> Misses {
        if metrics::is_empty(surface) {
            return Misses::default();
        }
        let miss = |p: &Placed| Miss {
            grasp: p.grasp,
            distance: surface.distance(&p.contact.point),
            deviation: p.contact.point_deviation,
        };
        Misses(contacts.par_iter().map(miss).collect())
    }

    /// Median distance, metres; zero without contacts.
    pub fn usual(&self) -> f64 {
        let mut all: Vec<f64> = self.0.iter().map(|miss| miss.distance).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(0.0)
    }

    /// The contacts that the shape does not explain.
    pub fn unexplained(&self, log: &GraspLog) -> Unexplained {
        let usual = self.usual();
        // Of each grasp how many, and how many of these.
        let mut counts: BTreeMap<usize, [usize; 2]> = BTreeMap::new();
        for miss in &self.0 {
            let count = counts.entry(miss.grasp).or_default();
            count[0] += 1;
            count[1] += usize::from(miss.distance > FAR * miss.deviation.max(usual));
        }
        let with = |is_one: &dyn Fn(&[usize; 2]) -> bool| {
            let grasps = counts.iter().filter(|(_, count)| is_one(count));
            grasps.filter_map(|(grasp, _)| Some(log.grasps.get(*grasp)?.index)).collect()
        };
        Unexplained {
            contacts: counts.values().map(|count| count[1]).sum(),
            grasps: with(&|[_, missed]| *missed > 0),
            wholly: with(&|[all, missed]| *all >= SEVERAL && missed == all),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Contact;
    use crate::shape::Outline;
    use crate::sim::{Options, simulate};
    use crate::space::Point;

    fn square() -> Geometry {
        Geometry::Outline(Outline {
            loops: vec![vec![[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]],
        })
    }

    /// A contact so far above the square's upper side.
    fn above(grasp: usize, height: f64, deviation: f64) -> Placed {
        let point = Point::new(0.01, 0.05 + height, 0.0);
        let contact =
            Contact { point, normal: None, point_deviation: deviation, normal_deviation: 0.1 };
        Placed { contact, grasp }
    }

    #[test]
    fn what_lies_far_off_is_counted_and_whose_it_is_said() {
        let mut log = simulate(&Options::new("triangle:0.06".parse().unwrap())).unwrap().log;
        log.grasps.iter_mut().for_each(|grasp| grasp.index += 10);
        // The doubt about its pose explains where the last lies.
        let placed = [
            above(0, 5e-4, 1e-3),
            above(0, -5e-4, 1e-3),
            above(0, 0.02, 1e-3),
            above(1, 0.02, 1e-3),
            above(1, -0.03, 1e-3),
            above(2, 0.02, 1e-3),
            above(3, 5e-4, 1e-3),
            above(3, 5e-4, 1e-3),
            above(3, 1e-4, 1e-3),
            above(3, 0.02, 1e-2),
            above(3, 1e-4, 1e-3),
        ];
        let misses = Misses::of(&placed, &square());
        let found = misses.unexplained(&log);
        assert_eq!(found.contacts, 4);
        assert_eq!(found.grasps, [10, 11, 12]);
        assert_eq!(found.wholly, [11]);
        assert!((misses.usual() - 5e-4).abs() < 1e-9);
    }

    #[test]
    fn where_all_lie_off_none_is_strange() {
        let log = simulate(&Options::new("triangle:0.06".parse().unwrap())).unwrap().log;
        let placed: Vec<Placed> = (0..8).map(|i| above(i / 4, 0.02, 1e-3)).collect();
        let misses = Misses::of(&placed, &square());
        assert_eq!(misses.unexplained(&log), Unexplained::default());
        assert!((misses.usual() - 0.02).abs() < 1e-9);
        let nothing = Geometry::Outline(Outline { loops: vec![] });
        for none in [Misses::of(&placed, &nothing), Misses::of(&[], &square())] {
            assert_eq!(none.usual(), 0.0);
            assert_eq!(none.unexplained(&log), Unexplained::default());
        }
    }
}
