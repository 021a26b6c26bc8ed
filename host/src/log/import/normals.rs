//! Normals of planar contacts that came without: from the direction of the force, or from the line
//! through neighbouring contacts.

use crate::space::Point;

/// A contact as it is known before it has a normal, in the frame of the object.
#[derive(Clone, Copy, Debug)]
pub struct Bare {
    /// Where, metres.
    pub point: Point,
    /// Unit direction against the force on the object, so that it points out of it; `None` where
    /// the force was too weak to have a direction.
    pub outward: Option<Point>,
}

/// A normal and how good it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normal {
    /// Unit, out of the object.
    pub direction: Point,
    /// Standard deviation, radians.
    pub deviation: f64,
}

/// How neighbouring contacts make a line.
#[derive(Clone, Copy, Debug)]
pub struct LineFit {
    /// Standard deviation of a contact across the line, metres.
    pub point_deviation: f64,
    /// How far a neighbour may be, metres.
    pub reach: f64,
    /// How far off the line a contact of the line may be, metres.
    pub tolerance: f64,
    /// Fewest contacts on the line, the one in question included.
    pub contacts: usize,
    /// Largest angle between the line's normal and a contact's outward force: no friction cone is
    /// wider. Radians.
    pub cone: f64,
    /// Least deviation ever claimed, radians: a surface is never quite a line.
    pub floor: f64,
    /// Lines whose direction is less certain than this are not good, radians.
    pub worst: f64,
}

impl LineFit {
    /// For contacts this far apart (standard deviation across the surface, metres), on an object of
    /// a hand's size. Two deviations belong to the line; with four contacts a line has two to
    /// spare, so that it can be wrong and be seen to be; a friction cone of 45° is a coefficient
    /// of 1.
    pub fn new(point_deviation: f64) -> Self {
        LineFit {
            point_deviation,
            reach: 0.03,
            tolerance: 2.0 * point_deviation,
            contacts: 4,
            cone: 45f64.to_radians(),
            floor: 3f64.to_radians(),
            worst: 4f64.to_radians(),
        }
    }

    /// The normal of contact `index`, where its neighbours allow one: the line through it that
    /// holds most of them is fitted by least squares, and is refused when it holds too few, is too
    /// uncertain, points away from the force, or has contacts well outside of it, as an edge of
    /// the object cannot.
    pub fn normal(&self, contacts: &[Bare], index: usize) -> Option<Normal> {
        let here = contacts.get(index)?;
        let outward = here.outward?;
        let near: Vec<&Bare> =
            contacts.iter().filter(|c| (c.point - here.point).norm() <= self.reach).collect();
        let agrees = |c: &Bare, n: &Point| c.outward.is_some_and(|o| o.dot(n) >= self.cone.cos());
        let facing = |along: Point| {
            let n = Point::new(-along.y, along.x, 0.0);
            if n.dot(&outward) < 0.0 { -n } else { n }
        };
        let mut line: Vec<&Bare> = Vec::new();
        for other in &near {
            let along = other.point - here.point;
            // Two contacts closer than this do not say which way the line runs.
            if along.norm() < 2.0 * self.tolerance {
                continue;
            }
            let n = facing(along.normalize());
            if !agrees(here, &n) {
                continue;
            }
            let on = |c: &&&Bare| {
                n.dot(&(c.point - here.point)).abs() <= self.tolerance && agrees(c, &n)
            };
            let candidate: Vec<&Bare> = near.iter().filter(on).copied().collect();
            if candidate.len() > line.len() {
                line = candidate;
            }
        }
        if line.len() < self.contacts {
            return None;
        }
        let count = line.len() as f64;
        let centre = line.iter().map(|c| c.point).sum::<Point>() / count;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for c in &line {
            let d = c.point - centre;
            xx += d.x * d.x;
            xy += d.x * d.y;
            yy += d.y * d.y;
        }
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let along = Point::new(angle.cos(), angle.sin(), 0.0);
        let direction = facing(along);
        let spread = line.iter().map(|c| along.dot(&(c.point - centre)).powi(2)).sum::<f64>();
        let off = line.iter().map(|c| direction.dot(&(c.point - centre)).powi(2)).sum::<f64>();
        let across = (off / (count - 2.0).max(1.0)).sqrt().max(self.point_deviation);
        let deviation = across / spread.sqrt();
        let outside =
            near.iter().any(|c| direction.dot(&(c.point - centre)) > 2.0 * self.tolerance);
        let good = deviation <= self.worst && agrees(here, &direction) && !outside;
        good.then(|| Normal { direction, deviation: deviation.max(self.floor) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit() -> LineFit {
        LineFit::new(0.0005)
    }

    fn at(x: f64, y: f64, outward_deg: f64) -> Bare {
        let (sin, cos) = outward_deg.to_radians().sin_cos();
        Bare { point: Point::new(x, y, 0.0), outward: Some(Point::new(cos, sin, 0.0)) }
    }

    /// A straight edge along x facing up, friction pulling the force to alternate sides.
    fn edge() -> Vec<Bare> {
        (0..6)
            .map(|k| {
                at(
                    0.008 * k as f64,
                    1e-4 * (k % 2) as f64,
                    90.0 + if k % 2 == 0 { 25.0 } else { -25.0 },
                )
            })
            .collect()
    }

    #[test]
    fn neighbours_on_a_line_give_its_normal() {
        let normal = fit().normal(&edge(), 2).unwrap();
        let error = normal.direction.angle(&Point::y());
        assert!(error.to_degrees() < 1.0, "{error}");
        assert_eq!(normal.deviation, fit().floor, "the line is better than it may claim");
    }

    #[test]
    fn the_side_is_the_side_of_the_force() {
        let below: Vec<_> = (0..6).map(|k| at(0.008 * k as f64, 0.0, -80.0)).collect();
        assert!(fit().normal(&below, 3).unwrap().direction.y < -0.99);
    }

    #[test]
    fn lines_that_cannot_be_trusted_give_none() {
        let all = edge();
        assert!(fit().normal(&all[..3], 1).is_none(), "too few");
        assert!(fit().normal(&all, 99).is_none(), "no such contact");
        let mut silent = all.clone();
        silent[2].outward = None;
        assert!(fit().normal(&silent, 2).is_none(), "no force, no side");
        let mut outside = all.clone();
        outside.push(at(0.016, 0.006, 90.0));
        assert!(fit().normal(&outside, 2).is_none(), "a contact outside the edge");
        let close: Vec<_> = (0..6).map(|k| at(0.0012 * k as f64, 0.0, 90.0)).collect();
        assert!(fit().normal(&close, 2).is_none(), "too short to have a direction");
        let across: Vec<_> = (0..6).map(|k| at(0.008 * k as f64, 0.0, 10.0)).collect();
        assert!(fit().normal(&across, 2).is_none(), "the force says otherwise");
        let far: Vec<_> = (0..6).map(|k| at(0.04 * k as f64, 0.0, 90.0)).collect();
        assert!(fit().normal(&far, 2).is_none(), "no neighbour in reach");
    }

    #[test]
    fn a_corner_belongs_to_the_edge_its_force_says() {
        let mut all = edge();
        // The other edge runs down from the last contact and faces right.
        all.extend((1..5).map(|k| at(0.0402, -0.008 * k as f64, 0.0)));
        let up = fit().normal(&all, 4).unwrap().direction;
        let right = fit().normal(&all, 7).unwrap().direction;
        assert!(up.y > 0.99 && right.x > 0.99, "{up} {right}");
    }
}
