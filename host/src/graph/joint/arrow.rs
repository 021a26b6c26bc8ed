//! A linear system whose matrix is an arrow: a chain of poses, each coupled to the next, and a border
//! of faces that any pose may be coupled to.
//!
//! ```text
//! H = ⎡ T   B ⎤   T block tridiagonal (poses), C small (faces)
//!     ⎣ Bᵀ  C ⎦
//! ```
//!
//! T is factored block by block, the faces are solved from the Schur complement C − BᵀT⁻¹B, and the
//! blocks of the inverse that covariances need come from the backward recursion of Takahashi et al.
//! (1973): everything is linear in the number of poses.

use nalgebra::{Cholesky, Const, DMatrix, DVector, Dyn, OMatrix, SMatrix, SVector};

use super::factors::Step;
use super::schur::Schur;
use super::tangent::axes;

/// A pose's rows of the border: `D` × number of face parameters.
pub type Row<const D: usize> = OMatrix<f64, Const<D>, Dyn>;

/// The matrix H and the gradient g of a quadratic ½xᵀHx + gᵀx. `D` numbers a pose.
#[derive(Clone, Debug)]
pub struct Arrow<const D: usize> {
    /// Diagonal blocks of T.
    pub diagonal: Vec<SMatrix<f64, D, D>>,
    /// Blocks left of them: `coupling[k]` is T at row k and column k − 1; the first is not used.
    pub coupling: Vec<SMatrix<f64, D, D>>,
    /// B by poses.
    pub border: Vec<Row<D>>,
    /// C.
    pub corner: DMatrix<f64>,
    /// Gradient of the poses.
    pub chain: Vec<SVector<f64, D>>,
    /// Gradient of the faces.
    pub rest: DVector<f64>,
}

/// Its Cholesky factor.
#[derive(Clone, Debug)]
pub struct Factor<const D: usize> {
    /// Diagonal blocks L of the factor of T.
    lower: Vec<SMatrix<f64, D, D>>,
    /// Blocks left of them.
    below: Vec<SMatrix<f64, D, D>>,
    /// L⁻¹B.
    half: Vec<Row<D>>,
    schur: Cholesky<f64, Dyn>,
}

/// Blocks of H⁻¹.
#[derive(Clone, Debug)]
pub struct Inverse<const D: usize> {
    /// Of every pose if the faces were known: diagonal blocks of T⁻¹.
    pub given_faces: Vec<SMatrix<f64, D, D>>,
    /// Of every pose.
    pub poses: Vec<SMatrix<f64, D, D>>,
    /// Between every pose and the faces.
    pub between: Vec<Row<D>>,
    /// Of the faces.
    pub faces: DMatrix<f64>,
}

impl<const D: usize> Arrow<D> {
    /// All zero, for so many poses and numbers that describe faces.
    pub fn zeros(poses: usize, width: usize) -> Self {
        Arrow {
            diagonal: vec![SMatrix::zeros(); poses],
            coupling: vec![SMatrix::zeros(); poses],
            border: vec![Row::zeros(width); poses],
            corner: DMatrix::zeros(width, width),
            chain: vec![SVector::zeros(); poses],
            rest: DVector::zeros(width),
        }
    }

    /// Adds a motion's residual between grasps k − 1 and k; grasp 0 stays, so that block k is of grasp
    /// k + 1.
    pub fn add_step(&mut self, grasp: usize, step: &Step, weight: f64) {
        let chosen = axes::<D>();
        let before = SMatrix::<f64, 6, D>::from_fn(|r, c| step.by_before[(r, chosen[c])]);
        let after = SMatrix::<f64, 6, D>::from_fn(|r, c| step.by_after[(r, chosen[c])]);
        self.diagonal[grasp - 1] += after.tr_mul(&after) * weight;
        self.chain[grasp - 1] += after.tr_mul(&step.residual) * weight;
        if grasp > 1 {
            self.diagonal[grasp - 2] += before.tr_mul(&before) * weight;
            self.chain[grasp - 2] += before.tr_mul(&step.residual) * weight;
            self.coupling[grasp - 1] += after.tr_mul(&before) * weight;
        }
    }

    /// Faces stay where they are: a step moves the poses alone.
    pub fn hold_faces(&mut self) {
        self.border.iter_mut().for_each(|rows| rows.fill(0.0));
        self.corner.fill_with_identity();
        self.rest.fill(0.0);
    }

    /// Adds a contact's residual at a grasp on some faces, with its derivatives by the pose's tangent and
    /// by each face's turns and offset; there are so many numbers to a face as dimensions.
    pub fn add_touch<const R: usize>(
        &mut self,
        grasp: usize,
        residual: &SVector<f64, R>,
        by_pose: &SMatrix<f64, R, 6>,
        faces: &[(usize, SMatrix<f64, R, 3>)],
    ) {
        // In the plane a face turns about one axis.
        let columns: &[usize] = if D == 3 { &[0, 2] } else { &[0, 1, 2] };
        let chosen = axes::<D>();
        let by_pose = SMatrix::<f64, R, D>::from_fn(|r, c| by_pose[(r, chosen[c])]);
        let at = |face: usize, a: usize| columns.len() * face + a;
        for (face, by_face) in faces {
            for (a, column) in columns.iter().enumerate() {
                let column = by_face.column(*column);
                self.rest[at(*face, a)] += column.dot(residual);
                for (other, by_other) in faces {
                    for (b, row) in columns.iter().enumerate() {
                        self.corner[(at(*face, a), at(*other, b))] +=
                            column.dot(&by_other.column(*row));
                    }
                }
                if grasp > 0 {
                    let mut rows = self.border[grasp - 1].column_mut(at(*face, a));
                    rows += by_pose.tr_mul(&column);
                }
            }
        }
        if grasp > 0 {
            self.diagonal[grasp - 1] += by_pose.tr_mul(&by_pose);
            self.chain[grasp - 1] += by_pose.tr_mul(residual);
        }
    }

    /// Factors H with every diagonal entry enlarged by `damping` times itself; `None` where that is
    /// not positive definite.
    pub fn factor(&self, damping: f64) -> Option<Factor<D>> {
        let enlarge = 1.0 + damping;
        let count = self.diagonal.len();
        let mut factor: Factor<D> = Factor {
            lower: Vec::with_capacity(count),
            below: Vec::with_capacity(count),
            half: Vec::with_capacity(count),
            schur: Cholesky::new(DMatrix::zeros(0, 0))?,
        };
        let mut schur = Schur::new(&self.corner, enlarge);
        for k in 0..count {
            let mut block = self.diagonal[k];
            for i in 0..D {
                block[(i, i)] *= enlarge;
            }
            let mut half = self.border[k].clone();
            let mut below = SMatrix::<f64, D, D>::zeros();
            if k > 0 {
                // below = coupling · L⁻ᵀ of the pose before.
                let solved =
                    factor.lower[k - 1].solve_lower_triangular(&self.coupling[k].transpose())?;
                below = solved.transpose();
                block -= below * solved;
                half -= below * &factor.half[k - 1];
            }
            let lower = Cholesky::new(block)?.unpack();
            if !lower.solve_lower_triangular_mut(&mut half) {
                return None;
            }
            schur.take(&half);
            factor.lower.push(lower);
            factor.below.push(below);
            factor.half.push(half);
        }
        factor.schur = Cholesky::new(schur.matrix())?;
        Some(factor)
    }
}

impl<const D: usize> Factor<D> {
    /// −H⁻¹g: the step to the quadratic's minimum, poses and faces.
    pub fn step(&self, arrow: &Arrow<D>) -> Option<(Vec<SVector<f64, D>>, DVector<f64>)> {
        let mut forward: Vec<SVector<f64, D>> = Vec::with_capacity(self.lower.len());
        let mut rest = -&arrow.rest;
        for k in 0..self.lower.len() {
            let mut right = -arrow.chain[k];
            if k > 0 {
                right -= self.below[k] * forward[k - 1];
            }
            let solved = self.lower[k].solve_lower_triangular(&right)?;
            rest.gemv_tr(-1.0, &self.half[k], &solved, 1.0);
            forward.push(solved);
        }
        let faces = self.schur.solve(&rest);
        let mut poses = forward;
        for k in (0..self.lower.len()).rev() {
            let mut right = poses[k] - &self.half[k] * &faces;
            if k + 1 < self.lower.len() {
                right -= self.below[k + 1].tr_mul(&poses[k + 1]);
            }
            poses[k] = self.lower[k].tr_solve_lower_triangular(&right)?;
        }
        Some((poses, faces))
    }

    /// ln det H.
    pub fn log_determinant(&self) -> f64 {
        let chain: f64 =
            self.lower.iter().map(|l| l.diagonal().iter().map(|v| v.ln()).sum::<f64>()).sum();
        let corner: f64 = self.schur.l_dirty().diagonal().iter().map(|v| v.ln()).sum();
        2.0 * (chain + corner)
    }

    /// Covariance of the faces alone.
    pub fn faces(&self) -> DMatrix<f64> {
        self.schur.inverse()
    }

    /// The blocks of H⁻¹ on the diagonal, and those of the border.
    pub fn inverse(&self) -> Option<Inverse<D>> {
        let count = self.lower.len();
        let faces = self.faces();
        let mut given_faces = vec![SMatrix::<f64, D, D>::zeros(); count];
        // T⁻¹B.
        let mut reached: Vec<Row<D>> = self.half.clone();
        for k in (0..count).rev() {
            let mut middle = SMatrix::<f64, D, D>::identity();
            if k + 1 < count {
                let below = self.below[k + 1];
                middle += below.tr_mul(&(given_faces[k + 1] * below));
                let after = below.tr_mul(&reached[k + 1]);
                reached[k] -= after;
            }
            let left = self.lower[k].tr_solve_lower_triangular(&middle)?;
            given_faces[k] = self.lower[k].tr_solve_lower_triangular(&left.transpose())?;
            if !self.lower[k].tr_solve_lower_triangular_mut(&mut reached[k]) {
                return None;
            }
        }
        let between: Vec<Row<D>> = reached.iter().map(|r| -(r * &faces)).collect();
        let poses = (0..count)
            .map(|k| {
                let all = given_faces[k] - &between[k] * reached[k].transpose();
                (all + all.transpose()) * 0.5
            })
            .collect();
        Some(Inverse { given_faces, poses, between, faces })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A positive definite arrow from any numbers: JᵀJ of residuals that touch what an arrow allows.
    fn arrow(poses: usize, width: usize, seed: u64) -> Arrow<3> {
        let mut state = seed.wrapping_mul(2).wrapping_add(1);
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / (1u64 << 23) as f64 - 1.0
        };
        let mut a = Arrow::<3>::zeros(poses, width);
        for k in 0..poses {
            for _ in 0..6 {
                let x = SVector::<f64, 3>::from_fn(|_, _| next());
                let f = DVector::from_fn(width, |_, _| next());
                a.diagonal[k] += x * x.transpose();
                a.border[k] += x * f.transpose();
                a.corner += &f * f.transpose();
                if k > 0 {
                    let y = SVector::<f64, 3>::from_fn(|_, _| next());
                    let z = SVector::<f64, 3>::from_fn(|_, _| next());
                    a.diagonal[k - 1] += z * z.transpose();
                    a.diagonal[k] += y * y.transpose();
                    a.coupling[k] += y * z.transpose();
                }
            }
            a.diagonal[k] += SMatrix::identity() * 0.3;
            a.chain[k] = SVector::from_fn(|_, _| next());
        }
        a.corner += DMatrix::identity(width, width) * 0.3;
        a.rest = DVector::from_fn(width, |_, _| next());
        a
    }

    fn dense(a: &Arrow<3>) -> (DMatrix<f64>, DVector<f64>) {
        let (n, w) = (3 * a.diagonal.len(), a.corner.nrows());
        let (mut h, mut g) = (DMatrix::zeros(n + w, n + w), DVector::zeros(n + w));
        for k in 0..a.diagonal.len() {
            h.view_mut((3 * k, 3 * k), (3, 3)).copy_from(&a.diagonal[k]);
            h.view_mut((3 * k, n), (3, w)).copy_from(&a.border[k]);
            h.view_mut((n, 3 * k), (w, 3)).copy_from(&a.border[k].transpose());
            if k > 0 {
                h.view_mut((3 * k, 3 * k - 3), (3, 3)).copy_from(&a.coupling[k]);
                h.view_mut((3 * k - 3, 3 * k), (3, 3)).copy_from(&a.coupling[k].transpose());
            }
            g.rows_mut(3 * k, 3).copy_from(&a.chain[k]);
        }
        h.view_mut((n, n), (w, w)).copy_from(&a.corner);
        g.rows_mut(n, w).copy_from(&a.rest);
        (h, g)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn it_is_the_dense_solution(poses in 0usize..7, width in 0usize..9, seed in any::<u64>()) {
            let a = arrow(poses, width, seed);
            let (h, g) = dense(&a);
            let n = 3 * poses;
            let inverse = h.clone().try_inverse().unwrap();
            let step = -&inverse * g;
            let factor = a.factor(0.0).unwrap();
            let (chain, rest) = factor.step(&a).unwrap();
            for k in 0..poses {
                prop_assert!((chain[k] - step.rows(3 * k, 3)).amax() < 1e-9);
            }
            prop_assert!((rest - step.rows(n, width)).norm() < 1e-9);
            if n + width > 0 {
                prop_assert!((factor.log_determinant() - h.determinant().ln()).abs() < 1e-8);
            }
            let blocks = factor.inverse().unwrap();
            prop_assert!((blocks.faces - inverse.view((n, n), (width, width))).norm() < 1e-9);
            let chain = h.view((0, 0), (n, n)).into_owned();
            let alone = if n > 0 { chain.try_inverse().unwrap() } else { DMatrix::zeros(0, 0) };
            for k in 0..poses {
                let own = inverse.view((3 * k, 3 * k), (3, 3));
                prop_assert!((blocks.poses[k] - own).amax() < 1e-9);
                let between = inverse.view((3 * k, n), (3, width)).into_owned();
                prop_assert!((&blocks.between[k] - between).norm() < 1e-9);
                prop_assert!((blocks.given_faces[k] - alone.view((3 * k, 3 * k), (3, 3))).amax() < 1e-9);
            }
        }

        #[test]
        fn damping_shortens_the_step(seed in any::<u64>()) {
            let a = arrow(4, 5, seed);
            let length = |damping: f64| {
                let (chain, rest) = a.factor(damping).unwrap().step(&a).unwrap();
                chain.iter().map(|x| x.norm_squared()).sum::<f64>() + rest.norm_squared()
            };
            prop_assert!(length(10.0) < length(0.0));
        }
    }

    #[test]
    fn what_is_not_positive_definite_has_no_factor() {
        let mut a = arrow(3, 4, 7);
        a.corner.fill(0.0);
        assert!(a.factor(0.0).is_none());
        let mut a = arrow(3, 4, 7);
        a.diagonal[1][(0, 0)] = f64::NAN;
        assert!(a.factor(0.0).is_none());
    }
}
