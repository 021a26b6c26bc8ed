//! How well each contact agrees with all others (Rasmussen and Williams 2006, section 5.4.2).

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::Gpis;

/// What a surface would say of each of its contacts if it had not been given that one.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// K⁻¹ of those that are left; zero in the rows of others.
    inverse: DMatrix<f64>,
    /// K⁻¹ y.
    weights: DVector<f64>,
    /// The rows of each contact; none of one that was removed.
    rows: Vec<Range<usize>>,
}

impl Gpis {
    /// What the surface would say of each of its contacts if it had not been given that one.
    pub fn left_out(&self) -> LeftOut {
        let n = self.observations.len();
        let targets = DVector::from_iterator(n, self.observations.iter().map(|o| o.target));
        let mut rows = vec![0..0; self.touched.len()];
        for (row, observation) in self.observations.iter().enumerate() {
            if let Some(own) = rows.get_mut(observation.contact) {
                *own = if own.end == 0 { row } else { own.start }..row + 1;
            }
        }
        LeftOut { inverse: self.cholesky.inverse(), weights: self.cholesky.solve(&targets), rows }
    }
}

impl LeftOut {
    /// ln of the density of what a contact measured, given all others that are left; `None` where it is not left
    /// itself, or rounding hides it.
    pub fn density(&self, contact: usize) -> Option<f64> {
        let (_, own, root) = self.block(contact)?;
        let half = root.solve_lower_triangular(&own)?;
        let determinant: f64 = root.diagonal().iter().map(|d| d.ln()).sum();
        let n = own.len() as f64;
        Some(determinant - 0.5 * (half.norm_squared() + n * std::f64::consts::TAU.ln()))
    }

    /// Removes a contact, in time that grows with the square of the rows.
    pub fn remove(&mut self, contact: usize) {
        let Some((rows, own, root)) = self.block(contact) else { return };
        let mut across = self.inverse.rows_range(rows.clone()).into_owned();
        // Of the same size as the block: it has an inverse.
        if !root.solve_lower_triangular_mut(&mut across) {
            return;
        }
        let Some(half) = root.solve_lower_triangular(&own) else { return };
        self.inverse.gemm_tr(-1.0, &across, &across, 1.0);
        self.weights.gemv_tr(-1.0, &across, &half, 1.0);
        self.inverse.rows_range_mut(rows.clone()).fill(0.0);
        self.inverse.columns_range_mut(rows.clone()).fill(0.0);
        self.weights.rows_range_mut(rows).fill(0.0);
        self.rows[contact] = 0..0;
    }

    /// Its rows, their weights, and the root of their part of K⁻¹.
    fn block(&self, contact: usize) -> Option<(Range<usize>, DVector<f64>, DMatrix<f64>)> {
        let rows = self.rows.get(contact).filter(|rows| rows.start < rows.end)?.clone();
        let part = self.inverse.view((rows.start, rows.start), (rows.len(), rows.len()));
        let root = part.into_owned().cholesky()?.l();
        Some((rows.clone(), self.weights.rows_range(rows).into_owned(), root))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{Contact, Kernel, Prior, Training};
    use crate::space::Point;

    /// Contacts about an oval, of which the third has no normal and the last lies off.
    fn contacts() -> Vec<Contact> {
        let one = |i: u32| {
            let angle = f64::from(i) * 0.7;
            let out = Point::new(angle.cos(), angle.sin(), 0.0);
            Contact {
                point: out * (0.04 + 0.005 * (2.0 * angle).cos() + if i == 8 { 0.01 } else { 0.0 }),
                normal: (i != 2).then_some(out),
                point_deviation: 1e-3,
                normal_deviation: 0.09,
            }
        };
        (0..9).map(one).collect()
    }

    fn surface(contacts: &[Contact]) -> Gpis {
        let kernel = Kernel::Matern32 { amplitude: 0.02, lengthscale: 0.08 };
        let prior = Prior::Ball { centre: Point::zeros(), radius: 0.04 };
        Gpis::fit(2, kernel, prior, Training::Derivative, contacts).unwrap()
    }

    /// The contacts without some.
    fn without(gone: &[usize]) -> Vec<Contact> {
        let all = contacts().into_iter().enumerate();
        all.filter(|(i, _)| !gone.contains(i)).map(|(_, contact)| contact).collect()
    }

    #[test]
    fn the_density_of_a_contact_is_what_the_evidence_loses_without_it() {
        let all = surface(&contacts());
        let left = all.left_out();
        for i in 0..9 {
            let lost =
                all.log_marginal_likelihood() - surface(&without(&[i])).log_marginal_likelihood();
            let density = left.density(i).unwrap();
            assert!((density - lost).abs() < 1e-6, "{i}: {density} {lost}");
        }
        assert_eq!(left.density(9), None);
        let strangest = (0..9).min_by(|a, b| {
            let [a, b] = [a, b].map(|i| left.density(*i).unwrap());
            a.total_cmp(&b)
        });
        assert_eq!(strangest, Some(8));
    }

    #[test]
    fn what_was_removed_is_as_if_it_had_never_been_given() {
        let mut left = surface(&contacts()).left_out();
        for gone in [8, 2, 2, 20] {
            left.remove(gone);
        }
        let direct = surface(&without(&[2, 8])).left_out();
        assert_eq!([left.density(2), left.density(8)], [None; 2]);
        for (number, i) in [0, 1, 3, 4, 5, 6, 7].into_iter().enumerate() {
            let [after, before] = [left.density(i), direct.density(number)].map(Option::unwrap);
            assert!((after - before).abs() < 1e-6, "{i}: {after} {before}");
        }
    }
}
