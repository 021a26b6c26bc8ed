//! In/out-sphere training with normalisation: thesis 2.2.4.

use super::Contact;
use super::gpis::Error;
use crate::space::{Point, centroid};

/// Points known to lie outside and inside, on two spheres (circles) about the contacts.
///
/// The thesis moves the contacts' mean to the origin and divides by the distance of the farthest
/// contact from it, the *extent*; adds points on an enclosing sphere with value +1 and on one within
/// the object with value −1; and gives the contacts the value 0. Here no point moves: the kernel's
/// lengths and amplitude, and all numbers below, are multiples of the extent, which is the same,
/// and the field comes out in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spheres {
    /// Radius of the enclosing sphere, in extents.
    pub outside: f64,
    /// Radius of the sphere within, in extents: it must lie inside the object.
    pub inside: f64,
    /// Points on the enclosing sphere.
    pub outside_points: usize,
    /// Points on the sphere within.
    pub inside_points: usize,
    /// Where given, contacts with normals also teach the values ±offset at p ± offset·n (thesis
    /// 2.2.2), in extents.
    pub offset: Option<f64>,
}

/// The thesis' normalisation: q = (p − centre)/extent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalisation {
    /// Mean of the contacts, metres.
    pub centre: Point,
    /// Distance of the farthest contact from it, metres; at least three times the largest point
    /// deviation, so that a single contact has one too.
    pub extent: f64,
    /// Largest point deviation of the contacts, metres: the points of the spheres have it too.
    pub deviation: f64,
}

impl Normalisation {
    /// That of these contacts; `None` without any.
    pub fn of(contacts: &[Contact]) -> Option<Self> {
        if contacts.is_empty() {
            return None;
        }
        let centre = centroid(contacts.iter().map(|c| c.point));
        let deviation = contacts.iter().map(|c| c.point_deviation).fold(0.0, f64::max);
        let farthest = contacts.iter().map(|c| (c.point - centre).norm());
        Some(Normalisation { centre, extent: farthest.fold(3.0 * deviation, f64::max), deviation })
    }
}

impl Spheres {
    /// Twenty points outside and eight inside, for an object up to four times as long as thick.
    pub const FEW: Self = Spheres {
        outside: 1.5,
        inside: 0.2,
        outside_points: 20,
        inside_points: 8,
        offset: Some(0.1),
    };

    /// The points of both spheres with their values, metres.
    pub fn points(
        &self,
        dimension: usize,
        normalisation: &Normalisation,
    ) -> impl Iterator<Item = (Point, f64)> + use<> {
        let Normalisation { centre, extent, .. } = *normalisation;
        let spheres =
            [(self.outside, self.outside_points, 1.0), (self.inside, self.inside_points, -1.0)];
        spheres.into_iter().flat_map(move |(radius, count, value)| {
            spread(dimension, count)
                .map(move |unit| (centre + unit * (radius * extent), value * extent))
        })
    }

    /// Refuses numbers that make no spheres.
    ///
    /// # Errors
    /// [`Error::Parameter`] names it.
    pub fn check(&self) -> Result<(), Error> {
        let offset = self.offset.map(|offset| ("off-surface distance", offset));
        let radii = [
            ("radius of the enclosing sphere", self.outside),
            ("radius of the sphere within", self.inside),
        ];
        for (name, value) in radii.into_iter().chain(offset) {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::Parameter { name, value });
            }
        }
        Ok(())
    }
}

/// Unit vectors spread evenly: equal angles in the plane, a golden-angle spiral in space.
fn spread(dimension: usize, count: usize) -> impl Iterator<Item = Point> {
    let golden = 2.0 / (1.0 + 5f64.sqrt());
    (0..count).map(move |i| {
        let part = (2 * i + 1) as f64 / count as f64;
        if dimension == 2 {
            let (sin, cos) = (std::f64::consts::PI * part).sin_cos();
            return Point::new(cos, sin, 0.0);
        }
        let (sin, cos) = (std::f64::consts::TAU * (golden * i as f64).fract()).sin_cos();
        let height = 1.0 - part;
        let ring = (1.0 - height * height).sqrt();
        Point::new(ring * cos, ring * sin, height)
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::super::{Gpis, Kernel, Prior, Training};
    use super::*;
    use crate::shape::Field;

    /// Contacts on a box of 120 × 60 × 60 mm (a rectangle), off the origin.
    fn boxed(dimension: usize, count: usize) -> Vec<Contact> {
        let half = Point::new(0.06, 0.03, 0.03);
        spread(dimension, count)
            .map(|unit| {
                let reach = unit.component_div(&half).map(f64::abs);
                let face = reach.imax();
                let mut normal = Point::zeros();
                normal[face] = unit[face].signum();
                Contact {
                    point: unit / reach.max()
                        + Point::new(0.2, -0.1, if dimension == 3 { 0.4 } else { 0.0 }),
                    normal: Some(normal),
                    point_deviation: 1e-3,
                    normal_deviation: 0.0873,
                }
            })
            .collect()
    }

    #[test]
    fn same_as_the_thesis_in_its_own_coordinates() {
        // Normalised coordinates, values 0 and ±1, zero mean, as 2.2.4 has it, by plain inversion.
        for (dimension, kernel) in [
            (3, Kernel::ThinPlate { amplitude: 1.0, range: 6.5 }),
            (2, Kernel::SquaredExponential { amplitude: 0.8, lengthscale: 0.6 }),
        ] {
            let contacts = boxed(dimension, 25);
            let spheres = Spheres { offset: None, ..Spheres::FEW };
            let n = Normalisation::of(&contacts).unwrap();
            let mut rows: Vec<(Point, f64)> =
                contacts.iter().map(|c| ((c.point - n.centre) / n.extent, 0.0)).collect();
            assert!((rows.iter().map(|r| r.0.norm()).fold(0.0, f64::max) - 1.0).abs() < 1e-12);
            rows.extend(spread(dimension, 20).map(|unit| (unit * 1.5, 1.0)));
            rows.extend(spread(dimension, 8).map(|unit| (unit * 0.2, -1.0)));
            let k = |a: &Point, b: &Point| kernel.radial((a - b).norm()).value;
            let noise = (1e-3 / n.extent).powi(2);
            let matrix = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
                k(&rows[i].0, &rows[j].0) + if i == j { noise } else { 0.0 }
            });
            let targets = DVector::from_iterator(rows.len(), rows.iter().map(|r| r.1));
            let weights = matrix.try_inverse().unwrap() * targets;
            let training = Training::Spheres(spheres);
            let ours =
                Gpis::fit(dimension, kernel, Prior::Constant(0.0), training, &contacts).unwrap();
            assert_eq!(ours.rows(), 25 + 28);
            for q in spread(dimension, 12) {
                let q = q * 0.7;
                let thesis: f64 = rows.iter().zip(&weights).map(|(r, w)| w * k(&q, &r.0)).sum();
                let value = ours.values(&[n.centre + q * n.extent])[0];
                assert!((value - thesis * n.extent).abs() < 1e-7, "{value} {thesis}");
            }
        }
    }

    #[test]
    fn knows_outside_from_inside_at_any_scale() {
        for scale in [0.01, 1.0, 100.0] {
            let contacts: Vec<Contact> = boxed(3, 40)
                .iter()
                .map(|c| Contact { point: c.point * scale, point_deviation: 1e-3 * scale, ..*c })
                .collect();
            let n = Normalisation::of(&contacts).unwrap();
            let kernel = Kernel::ThinPlate { amplitude: 1.0, range: 6.5 };
            let training = Training::Spheres(Spheres::FEW);
            let field = Gpis::fit(3, kernel, Prior::Constant(0.0), training, &contacts).unwrap();
            let at = |q: Point| field.values(&[n.centre + q * n.extent])[0];
            assert!(at(Point::zeros()) < 0.0 && at(Point::new(1.3, 0.0, 0.0)) > 0.0);
            assert!(at(Point::new(0.0, 0.8, 0.0)) > 0.0 && at(Point::new(0.6, 0.0, 0.0)) < 0.0);
        }
    }

    #[test]
    fn few_contacts_and_bad_numbers() {
        let kernel = Kernel::ThinPlate { amplitude: 1.0, range: 6.5 };
        let fit = |spheres, contacts: &[Contact]| {
            Gpis::fit(3, kernel, Prior::Constant(0.0), Training::Spheres(spheres), contacts)
        };
        assert_eq!(fit(Spheres::FEW, &[]).unwrap().rows(), 0);
        let one = fit(Spheres::FEW, &boxed(3, 1)).unwrap();
        assert_eq!(one.rows(), 3 + 28);
        let p = [boxed(3, 1)[0].point + Point::new(0.0, 0.0, 0.003)];
        assert!(one.values(&p)[0].is_finite() && one.deviations(&p)[0].is_finite());
        let bad = Spheres { inside: f64::NAN, ..Spheres::FEW };
        assert!(fit(bad, &boxed(3, 5)).unwrap_err().to_string().contains("sphere within"));
        let bad = Spheres { offset: Some(0.0), ..Spheres::FEW };
        assert!(matches!(fit(bad, &[]), Err(Error::Parameter { value: 0.0, .. })));
        let many = Spheres { outside_points: Gpis::MOST_ROWS + 1, ..Spheres::FEW };
        assert!(matches!(fit(many, &boxed(3, 5)), Err(Error::TooLarge { .. })));
    }
}
