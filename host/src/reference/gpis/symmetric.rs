//! How probable contacts are on a surface that is its own mirror image.

use super::observe::Rows;
use super::{Error, Gpis, Training, observed, solve};
use crate::dense::Functional;
use crate::model::mirror::{Image, Mirror, images};
use crate::reference::mean::Local;
use crate::reference::{Contact, Kernel, Mean};
use crate::space::Point;

impl Gpis {
    /// log p(contacts) where the object is its own image in all of these `mirrors`, square to each other: of
    /// the process with covariance Σ k(x, gx') over their images g, the first of which is x' itself, and the mean
    /// of `prior` over them (Ginsbourger, Roustant and Durrande, Journal of Statistical Planning and Inference 170,
    /// 2016). Without mirrors it is the [likelihood](Gpis::log_marginal_likelihood) of any surface.
    ///
    /// # Errors
    /// As [`fit`](Gpis::fit).
    pub fn symmetric_evidence(
        dimension: usize,
        kernel: Kernel,
        prior: &dyn Mean,
        mirrors: &[Mirror],
        contacts: &[Contact],
    ) -> Result<f64, Error> {
        if !(2..=3).contains(&dimension) {
            return Err(Error::Dimension(dimension));
        }
        kernel.check()?;
        prior.check()?;
        let images = images(mirrors);
        let prior = Mirrored { mean: prior, images: &images };
        let rows = Rows::of(dimension, &prior, Training::Derivative, contacts, &[])?;
        if rows.observations.len() > Self::MOST_ROWS {
            return Err(Error::TooLarge { rows: rows.observations.len() });
        }
        let (sites, modes, observations) = (rows.sites(), rows.modes(), rows.observations);
        let mut field = sites.covariance(&kernel);
        for image in &images[1..] {
            let seen = |f: &Functional| Functional {
                point: image.point(&f.point),
                slopes: image.direction(&f.slopes),
                ..*f
            };
            field += sites.covariance_with(&kernel, seen);
        }
        Ok(solve(observed(field, &modes, &observations), &observations)?.log_marginal_likelihood)
    }
}

/// The mean of a field over images.
#[derive(Debug)]
struct Mirrored<'a> {
    mean: &'a dyn Mean,
    images: &'a [Image],
}

impl Mirrored<'_> {
    /// The mean of fields that are such `locals` at each image.
    fn shared(&self, locals: impl Fn(&Image) -> Vec<Local>) -> Vec<Local> {
        let share = 1.0 / self.images.len() as f64;
        let mut sums = vec![];
        for image in self.images {
            let locals = locals(image);
            sums.resize(locals.len(), (0.0, Point::zeros()));
            for (sum, (value, slope)) in sums.iter_mut().zip(locals) {
                sum.0 += share * value;
                sum.1 += image.back(&slope) * share;
            }
        }
        sums
    }

    /// The same of one gradient. There is an image, if only that in no mirror ([`images`]), so there is a mean.
    fn slope(&self, slope: impl Fn(&Image) -> Point) -> Point {
        self.shared(|image| vec![(0.0, slope(image))])[0].1
    }
}

impl Mean for Mirrored<'_> {
    fn value(&self, p: &Point) -> f64 {
        let sum: f64 = self.images.iter().map(|image| self.mean.value(&image.point(p))).sum();
        sum / self.images.len() as f64
    }

    fn gradient(&self, p: &Point) -> Point {
        self.slope(|image| self.mean.gradient(&image.point(p)))
    }

    fn felt(&self, contact: &Contact) -> Point {
        self.slope(|image| self.mean.felt(&image.contact(contact)))
    }

    fn modes(&self, p: &Point) -> Vec<Local> {
        self.shared(|image| self.mean.modes(&image.point(p)))
    }

    fn felt_modes(&self, contact: &Contact) -> Vec<Local> {
        self.shared(|image| self.mean.felt_modes(&image.contact(contact)))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;
    use crate::model::body::Body;
    use crate::reference::Prior;
    use crate::reference::cholesky::Cholesky;

    const KERNEL: Kernel = Kernel::Matern32 { amplitude: 0.03, lengthscale: 0.06 };

    /// Touches of a ball of 50 mm, shifted and turned a little.
    fn touches(dimension: usize, draws: &[[f64; 5]]) -> Vec<Contact> {
        let touch = |[x, y, z, shift, turn]: &[f64; 5]| {
            let flat = |v: Point| if dimension == 2 { Point::new(v.x, v.y, 0.0) } else { v };
            let out = flat(Point::new(*x, *y, *z)).try_normalize(1e-2)?;
            let normal = flat(out + Point::new(*turn, -*turn, 0.5 * turn)).try_normalize(1e-2)?;
            let point = out * (0.05 + 0.1 * shift);
            Some(Contact {
                point,
                normal: Some(normal),
                point_deviation: 1e-3,
                normal_deviation: 0.09,
            })
        };
        draws.iter().filter_map(touch).collect()
    }

    fn drawn() -> impl Strategy<Value = (usize, Vec<[f64; 5]>, f64, f64)> {
        let draws = prop::collection::vec(prop::array::uniform5(-0.1..0.1), 1..8);
        (2..=3usize, draws, 0.0..3.0, -0.02..0.02)
    }

    fn mirrors(dimension: usize, turn: f64, offset: f64) -> Vec<Mirror> {
        let tilt = if dimension == 2 { 0.0 } else { 0.4 };
        let turn = nalgebra::Rotation3::from_euler_angles(tilt, 0.0, turn);
        let mirror =
            |i| Mirror { normal: turn * Point::ith(i, 1.0), offset: offset * (1.0 + i as f64) };
        (0..2).map(mirror).collect()
    }

    proptest! {
        #[test]
        fn a_contact_says_the_same_as_its_images((dimension, draws, turn, offset) in drawn()) {
            let contacts = touches(dimension, &draws);
            let Some(body) = Body::doubtful_ball(dimension, &contacts) else { return Ok(()) };
            let mirrors = mirrors(dimension, turn, offset);
            let evidence = |contacts: &[Contact]| {
                Gpis::symmetric_evidence(dimension, KERNEL, &body, &mirrors, contacts).unwrap()
            };
            let images = images(&mirrors);
            let moved = |(i, c): (usize, &Contact)| images[i % images.len()].contact(c);
            let others: Vec<Contact> = contacts.iter().enumerate().map(moved).collect();
            let (here, there) = (evidence(&contacts), evidence(&others));
            prop_assert!((here - there).abs() < 1e-6 * here.abs().max(1.0), "{} {}", here, there);
        }

        #[test]
        fn without_mirrors_it_is_that_of_any_surface((dimension, draws, ..) in drawn()) {
            let contacts = touches(dimension, &draws);
            let Some(body) = Body::doubtful_ball(dimension, &contacts) else { return Ok(()) };
            let alone = Gpis::symmetric_evidence(dimension, KERNEL, &body, &[], &contacts).unwrap();
            let fitted = Gpis::fit(dimension, KERNEL, body, Training::Derivative, &contacts).unwrap();
            prop_assert!((alone - fitted.log_marginal_likelihood()).abs() < 1e-9);
        }

        #[test]
        fn values_vary_together_with_those_of_their_images((dimension, draws, turn, offset) in drawn()) {
            let touched = touches(dimension, &draws);
            let contacts: Vec<Contact> = touched.iter().map(|c| Contact { normal: None, ..*c }).collect();
            let mirrors = &mirrors(dimension, turn, offset)[..1];
            let prior = Prior::Constant(0.01);
            let evidence =
                Gpis::symmetric_evidence(dimension, KERNEL, &prior, mirrors, &contacts).unwrap();
            let n = contacts.len();
            let covariance = DMatrix::from_fn(n, n, |i, j| {
                let (here, there) = (contacts[i].point, contacts[j].point);
                let away = mirrors[0].normal.dot(&there) - mirrors[0].offset;
                let image = there - mirrors[0].normal * (2.0 * away);
                let noise = if i == j { 1e-6 } else { 0.0 };
                let k = |q: &Point| KERNEL.radial((here - q).norm()).value;
                k(&there) + k(&image) + noise
            });
            let factor = Cholesky::new(covariance).unwrap();
            let targets = DVector::from_element(n, -0.01);
            let squares = targets.dot(&factor.solve(&targets));
            let constant = n as f64 * std::f64::consts::TAU.ln();
            let plain = -0.5 * (squares + factor.log_determinant() + constant);
            prop_assert!((evidence - plain).abs() < 1e-6 * plain.abs().max(1.0));
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let contact = Contact {
            point: Point::x(),
            normal: None,
            point_deviation: f64::NAN,
            normal_deviation: 0.1,
        };
        let prior = Prior::Constant(0.0);
        let evidence = |dimension, contacts: &[Contact]| {
            Gpis::symmetric_evidence(dimension, KERNEL, &prior, &[], contacts)
        };
        assert_eq!(evidence(4, &[]), Err(Error::Dimension(4)));
        assert!(matches!(evidence(3, &[contact]), Err(Error::Contact { index: 0, .. })));
        assert_eq!(evidence(3, &[]), Ok(0.0));
    }
}
