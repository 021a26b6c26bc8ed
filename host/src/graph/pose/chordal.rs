//! Initial values by chordal relaxation: rotations first, then translations, each by sparse linear
//! least squares (Martinec & Pajdla 2007; Carlone, Tron, Daniilidis & Dellaert 2015).
//!
//! With rotations as any matrices, Σ κ ‖Rⱼ − Rᵢ Rz‖² is a linear problem whose rows of R are
//! independent: one factorisation serves N right-hand sides. Its solution, projected on rotations, is
//! near the global optimum at noise where composed odometry ends in a local minimum. Given the
//! rotations, Σ τ ‖tⱼ − tᵢ − Rᵢ tz‖² is linear too, and its axes share one factor.

use nalgebra::{SMatrix, SVector};

use super::blocks::{Blocks, Places, Singular};
use super::normal::{Layout, Limit};
use super::rigid::Rigid;
use super::{Error, PoseGraph};

/// Initial values of all poses, near the best where the noise is moderate.
///
/// Fixed poses stay where they are, as does the first of every connected part that has none; the
/// others' places are not used.
///
/// κ and τ are the harmonic means of each edge's rotation and translation information: inverse mean
/// variances (1/rad², 1/m²).
///
/// ```
/// use tactile_host::graph::pose::chordal::chordal;
/// use tactile_host::graph::pose::{Edge, PoseGraph2, Se2};
///
/// // Three poses, each one metre ahead of the one before, and a loop closure that agrees.
/// let edge = |from, to, x| Edge {
///     from,
///     to,
///     measured: Se2::new(x, 0.0, 0.0),
///     information: nalgebra::Matrix3::identity(),
/// };
/// let poses = vec![Se2::new(0.0, 0.0, 1.0); 3];
/// let edges = vec![edge(0, 1, 1.0), edge(1, 2, 1.0), edge(0, 2, 2.0)];
/// let graph = PoseGraph2 { ids: vec![0, 1, 2], poses, edges, fixed: vec![] };
/// let found = chordal(&graph)?;
/// assert!((found[2].translation - nalgebra::Vector2::new(1f64.cos(), 1f64.sin()) * 2.0).norm() < 1e-9);
/// # Ok::<(), tactile_host::graph::pose::Error>(())
/// ```
///
/// # Errors
/// See [`Error`]: numbers out of range, or poses whose rotation or translation nothing measures.
pub fn chordal<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
) -> Result<Vec<G>, Error> {
    graph.check()?;
    chordal_in(graph, &Layout::new(graph, &graph.held(), Limit::default())?, None)
}

/// [`chordal`] of a graph that is checked, in a layout that is known, its information times `weights`.
pub(super) fn chordal_in<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    layout: &Layout,
    weights: Option<&[f64]>,
) -> Result<Vec<G>, Error> {
    let places = Places::new(graph, layout);
    let mut poses = graph.poses.clone();
    rotations(graph, &places, weights, &mut poses)?;
    translations(graph, &places, weights, &mut poses)?;
    Ok(poses)
}

/// κ or τ: n / tr(A⁻¹) of the n × n part of an edge's information that starts at row `first`; zero where
/// that is singular.
pub(super) fn harmonic_mean<const D: usize>(
    information: &SMatrix<f64, D, D>,
    first: usize,
    n: usize,
) -> f64 {
    let get = |r: usize, c: usize| information[(first + r, first + c)];
    let minor = |a: usize, b: usize| get(a, a) * get(b, b) - get(a, b) * get(b, a);
    let (determinant, minors) = match n {
        1 => return get(0, 0),
        2 => (minor(0, 1), get(0, 0) + get(1, 1)),
        _ => {
            let matrix = SMatrix::<f64, 3, 3>::from_fn(get);
            (matrix.determinant(), minor(0, 1) + minor(0, 2) + minor(1, 2))
        }
    };
    let scale = (0..n).map(|k| get(k, k)).fold(0.0, f64::max);
    // Rounding leaves this much of a determinant that is zero.
    let singular = determinant <= 1e-12 * scale.powi(n as i32);
    if singular { 0.0 } else { n as f64 * determinant / minors }
}

/// Sets the rotations of the free poses.
fn rotations<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    places: &Places<'_>,
    weights: Option<&[f64]>,
    poses: &mut [G],
) -> Result<(), Error> {
    let unconstrained = |pose| Error::Unconstrained { id: graph.ids[pose], component: N };
    let rows = places.free() * N;
    let mut system = Blocks::<N>::new(places);
    // Unknown is the transpose of each rotation: its columns are the rows of R, which are independent.
    let mut right = vec![0.0; rows * N];
    let mut pull = |pose: usize, block: SMatrix<f64, N, N>| {
        if let Some(at) = places.position(pose) {
            for c in 0..N {
                for r in 0..N {
                    right[c * rows + at * N + r] += block[(r, c)];
                }
            }
        }
    };
    for (index, edge) in graph.edges.iter().enumerate() {
        let weight = weights.map_or(1.0, |weights| weights[index]);
        let kappa = weight * harmonic_mean(&edge.information, N, D - N);
        let measured = edge.measured.rotation_matrix() * kappa;
        let own = SMatrix::identity() * kappa;
        system.add_pose(edge.from, &own);
        system.add_pose(edge.to, &own);
        system.add_edge(index, &-measured.transpose());
        if places.position(edge.from).is_none() {
            pull(edge.to, (graph.poses[edge.from].rotation_matrix() * measured).transpose());
        }
        if places.position(edge.to).is_none() {
            pull(edge.from, measured * graph.poses[edge.to].rotation_matrix().transpose());
        }
    }
    system.solve(&mut right).map_err(|Singular { pose, .. }| unconstrained(pose))?;
    for (pose, place) in poses.iter_mut().enumerate() {
        if let Some(at) = places.position(pose) {
            let relaxed = SMatrix::from_fn(|r, c| right[r * rows + at * N + c]);
            *place = G::nearest(&relaxed, SVector::zeros()).ok_or_else(|| unconstrained(pose))?;
        }
    }
    Ok(())
}

/// Sets the translations of the free poses, given all rotations.
fn translations<G: Rigid<D, N>, const D: usize, const N: usize>(
    graph: &PoseGraph<G, D>,
    places: &Places<'_>,
    weights: Option<&[f64]>,
    poses: &mut [G],
) -> Result<(), Error> {
    let unconstrained = |pose| Error::Unconstrained { id: graph.ids[pose], component: 0 };
    let rows = places.free();
    let mut system = Blocks::<1>::new(places);
    let mut right = vec![0.0; rows * N];
    let mut pull = |pose: usize, force: SVector<f64, N>| {
        if let Some(at) = places.position(pose) {
            for (axis, value) in force.iter().enumerate() {
                right[axis * rows + at] += value;
            }
        }
    };
    for (index, edge) in graph.edges.iter().enumerate() {
        let weight = weights.map_or(1.0, |weights| weights[index]);
        let tau = weight * harmonic_mean(&edge.information, 0, N);
        let block = SMatrix::<f64, 1, 1>::new(tau);
        system.add_pose(edge.from, &block);
        system.add_pose(edge.to, &block);
        system.add_edge(index, &-block);
        let step = poses[edge.from].rotation_matrix() * edge.measured.translation_vector() * tau;
        pull(edge.from, -step);
        pull(edge.to, step);
        if places.position(edge.from).is_none() {
            pull(edge.to, poses[edge.from].translation_vector() * tau);
        }
        if places.position(edge.to).is_none() {
            pull(edge.from, poses[edge.to].translation_vector() * tau);
        }
    }
    system.solve(&mut right).map_err(|Singular { pose, .. }| unconstrained(pose))?;
    for (pose, place) in poses.iter_mut().enumerate() {
        if let Some(at) = places.position(pose) {
            *place = place.moved_to(SVector::from_fn(|axis, _| right[axis * rows + at]));
            if !place.is_finite() {
                return Err(unconstrained(pose));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::grid::{Random, distance, grid, planar, spatial};
    use super::super::odometry::odometry;
    use super::super::{Se2, Se3};
    use super::*;

    /// Exact measurements are met exactly, whatever their information, from any estimates.
    fn exact<G: Rigid<D, N>, const D: usize, const N: usize>(
        mut graph: PoseGraph<G, D>,
        seed: u64,
    ) {
        let mut random = Random::new(seed);
        for edge in &mut graph.edges {
            let root = SMatrix::<f64, D, D>::from_fn(|_, _| random.normal());
            edge.information = root * root.transpose() + SMatrix::identity() * 0.1;
        }
        graph.fixed = (0..random.index(3)).map(|_| random.index(graph.poses.len())).collect();
        let truth = graph.poses.clone();
        let held = graph.held();
        for (pose, place) in graph.poses.iter_mut().enumerate() {
            if !held[pose] {
                *place = random.anywhere(10.0);
            }
        }
        let found = chordal(&graph).unwrap();
        assert!(distance(&found, &truth) < 1e-16, "{}", distance(&found, &truth));
        assert!((0..held.len()).all(|k| !held[k] || found[k] == graph.poses[k]));
    }

    fn better_than_odometry<G: Rigid<D, N>, const D: usize, const N: usize>(
        mut graph: PoseGraph<G, D>,
    ) {
        graph.poses = odometry(&graph).unwrap();
        let before = graph.chi2();
        graph.poses = chordal(&graph).unwrap();
        assert!(graph.chi2() < 0.2 * before, "{} {before}", graph.chi2());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn exact_measurements_give_the_truth(
            plane in planar(0.0), space in spatial(0.0), seed in 0u64..1000,
        ) {
            exact(plane, seed);
            exact(space, seed);
        }

        #[test]
        fn noise_is_distributed_over_loops(seed in 0u64..1000) {
            better_than_odometry(grid::<Se2, 3>(seed, 10, 0.1));
            better_than_odometry(grid::<Se3, 6>(seed, 10, 0.1));
        }

        #[test]
        fn any_matrix_has_the_rotation_that_the_singular_values_say(seed in 0u64..10_000) {
            let mut random = Random::new(seed);
            let matrix = nalgebra::Matrix3::from_fn(|_, _| random.normal());
            let found = Se3::nearest(&matrix, SVector::zeros()).unwrap().rotation_matrix();
            // First-order optimality and its second order: Rᵀ A symmetric, tr(RᵀA) I − RᵀA ≥ 0.
            let stretch = found.transpose() * matrix;
            prop_assert!((stretch - stretch.transpose()).norm() < 1e-9 * matrix.norm());
            let curvature = nalgebra::Matrix3::identity() * stretch.trace() - stretch;
            let symmetric = (curvature + curvature.transpose()) * 0.5;
            prop_assert!(symmetric.symmetric_eigenvalues().min() > -1e-9 * matrix.norm());
        }

        #[test]
        fn harmonic_means_are_those_of_the_inverse(seed in 0u64..1000) {
            let mut random = Random::new(seed);
            let root = nalgebra::Matrix3::from_fn(|_, _| random.normal());
            let matrix = root * root.transpose() + nalgebra::Matrix3::identity() * 0.01;
            let expected = 3.0 / matrix.try_inverse().unwrap().trace();
            let mean = harmonic_mean(&matrix, 0, 3);
            prop_assert!((mean - expected).abs() < 1e-6 * expected);
            let expected = 2.0 / matrix.fixed_view::<2, 2>(1, 1).try_inverse().unwrap().trace();
            prop_assert!((harmonic_mean(&matrix, 1, 2) - expected).abs() < 1e-6 * expected);
        }
    }

    #[test]
    fn reflections_and_nothing_at_all_have_no_nearest_rotation() {
        let nearest = |matrix| Se3::nearest(&matrix, SVector::zeros());
        assert!(nearest(-nalgebra::Matrix3::identity()).is_none());
        assert!(nearest(nalgebra::Matrix3::zeros()).is_none());
        assert!(nearest(nalgebra::Matrix3::repeat(f64::NAN)).is_none());
        assert!(
            Se2::nearest(&nalgebra::Matrix2::new(1.0, 0.0, 0.0, -1.0), SVector::zeros()).is_none()
        );
    }

    #[test]
    fn little_or_nothing_is_returned_as_it_is() {
        let none: PoseGraph<Se2, 3> =
            PoseGraph { ids: vec![], poses: vec![], edges: vec![], fixed: vec![] };
        assert_eq!(chordal(&none), Ok(vec![]));
        let two = PoseGraph { ids: vec![5, 6], poses: vec![Se2::new(1.0, 2.0, 3.0); 2], ..none };
        assert_eq!(chordal(&two), Ok(two.poses.clone()));
    }

    #[test]
    fn missing_information_names_the_pose() {
        let mut graph = grid::<Se2, 3>(5, 2, 0.0);
        graph.edges[0].information[(2, 2)] = 0.0;
        graph.edges.pop();
        // Any of the poses beyond that edge.
        let loose = chordal(&graph);
        assert!(matches!(loose, Err(Error::Unconstrained { component: 2, .. })), "{loose:?}");
        graph.edges[0].information = SMatrix::identity();
        graph.edges[0].information[(0, 1)] = 1.0;
        graph.edges[0].information[(1, 0)] = 1.0;
        let loose = chordal(&graph);
        assert!(matches!(loose, Err(Error::Unconstrained { component: 0, .. })), "{loose:?}");
        graph.edges[0].information[(2, 2)] = -1.0;
        let problem = "not positive semidefinite";
        let indefinite = Err(Error::Information { edge: 0, from: 7, to: 10, problem });
        assert_eq!(chordal(&graph), indefinite);
    }
}
