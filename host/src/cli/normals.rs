//! Normals that look as if they pointed into the object.

use crate::log::{GraspLog, LoggedGrasp};
use crate::space::{Point, centroid};

/// Contacts on opposite sides of their grasp that suffice to tell.
const FEWEST: usize = 10;

/// The part of them that points inwards which no hollow of an object explains.
const MOST: f64 = 0.8;

/// A normal tells nothing where it is nearly across the way from the middle: cosine between them.
const ACROSS: f64 = 0.3;

/// What is to be said of a log most of whose normals point to the middle of their own grasp's contacts.
pub(super) fn doubt(log: &GraspLog) -> Option<String> {
    let outwards: Vec<f64> =
        log.grasps.iter().flat_map(cosines).filter(|cosine| cosine.abs() > ACROSS).collect();
    let (inward, all) = (outwards.iter().filter(|c| **c < 0.0).count(), outwards.len());
    (all >= FEWEST && inward as f64 >= MOST * all as f64).then(|| {
        format!(
            "{inward} of {all} normals point to the middle of what their grasp touched, expected them to point \
             out of the object: is their sign wrong?"
        )
    })
}

/// Between the normals of one grasp and the ways there from the middle of its contacts.
fn cosines(grasp: &LoggedGrasp) -> Vec<f64> {
    let felt: Vec<(Point, Point)> =
        grasp.contacts.iter().filter_map(|c| Some((c.point, c.normal?))).collect();
    let middle = centroid(felt.iter().map(|(p, _)| *p));
    // A lone contact is its own middle, and says nothing.
    let cosine = |(p, n): &(Point, Point)| (p - middle).try_normalize(1e-9).map(|way| way.dot(n));
    felt.iter().filter_map(cosine).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{ObjectSpec, Options, Touch, simulate};

    fn felt(object: &str, touch: Touch) -> GraspLog {
        let object: ObjectSpec = object.parse().unwrap();
        let options = Options { grasps: Some(8), touch, seed: 3, ..Options::new(object) };
        simulate(&options).unwrap().log
    }

    #[test]
    fn normals_that_point_inwards_raise_a_doubt() {
        let objects =
            ["rectangle:0.12x0.06", "tshape:0.09x0.09x0.03", "lshape:0.09x0.09x0.035x0.05"];
        for (object, touch) in objects.iter().flat_map(|o| [(o, Touch::Uniform), (o, Touch::Hand)])
        {
            let mut log = felt(object, touch);
            assert_eq!(doubt(&log), None, "{object}");
            let contacts = log.grasps.iter_mut().flat_map(|g| &mut g.contacts);
            contacts.filter_map(|c| c.normal.as_mut()).for_each(|n| *n = -*n);
            assert!(doubt(&log).is_some_and(|d| d.contains("out of the object")), "{object}");
        }
    }

    #[test]
    fn lone_contacts_say_nothing() {
        let mut log = felt("rectangle:0.12x0.06", Touch::Uniform);
        for grasp in &mut log.grasps {
            grasp.contacts.truncate(1);
            grasp.contacts.iter_mut().filter_map(|c| c.normal.as_mut()).for_each(|n| *n = -*n);
        }
        assert_eq!(doubt(&log), None);
    }
}
