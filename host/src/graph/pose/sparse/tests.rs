use nalgebra::{DMatrix, DVector, SMatrix};
use proptest::prelude::*;

use super::*;

/// A random positive definite matrix over a graph, and the same dense.
fn random<const B: usize>(
    blocks: usize,
    pairs: &[(usize, usize)],
    numbers: &mut impl Iterator<Item = f64>,
) -> (Structure, BlockMatrix<B>, DMatrix<f64>) {
    let structure = Structure::new(blocks, pairs.iter().copied(), 1_000_000).unwrap();
    let mut matrix = BlockMatrix::<B>::new(&structure);
    for i in 0..blocks {
        matrix.diagonal[i] = SMatrix::identity();
    }
    for &(a, b) in pairs.iter().filter(|(a, b)| a != b) {
        let (a, b) = (structure.position(a), structure.position(b));
        let left = SMatrix::<f64, B, B>::from_fn(|_, _| numbers.next().unwrap());
        let right = SMatrix::<f64, B, B>::from_fn(|_, _| numbers.next().unwrap());
        matrix.diagonal[a] += left.transpose() * left;
        matrix.diagonal[b] += right.transpose() * right;
        if a > b {
            matrix.below[structure.slot(a, b).unwrap()] += left.transpose() * right;
        } else {
            matrix.below[structure.slot(b, a).unwrap()] += right.transpose() * left;
        }
    }
    let mut dense = DMatrix::zeros(blocks * B, blocks * B);
    for column in 0..blocks {
        dense.view_mut((column * B, column * B), (B, B)).copy_from(&matrix.diagonal[column]);
        for row in column + 1..blocks {
            if let Some(slot) = structure.slot(row, column) {
                let block = matrix.below[slot];
                dense.view_mut((row * B, column * B), (B, B)).copy_from(&block);
                dense.view_mut((column * B, row * B), (B, B)).copy_from(&block.transpose());
            }
        }
    }
    (structure, matrix, dense)
}

fn numbers(seed: u64) -> impl Iterator<Item = f64> {
    use rand_core::{Rng, SeedableRng};
    let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(seed);
    std::iter::repeat_with(move || (rng.next_u64() >> 11) as f64 / (1u64 << 52) as f64 - 1.0)
}

fn solves<const B: usize>(blocks: usize, pairs: &[(usize, usize)], seed: u64) {
    let mut numbers = numbers(seed);
    let (structure, matrix, dense) = random::<B>(blocks, pairs, &mut numbers);
    let mut factor = Factor::new(&structure);
    let b = DVector::from_fn(blocks * B, |_, _| numbers.next().unwrap());
    for damping in [0.0, 0.5] {
        factor.factorise(&structure, &matrix, damping).unwrap();
        let mut x = b.as_slice().to_vec();
        factor.solve(&structure, &mut x);
        let mut damped = dense.clone();
        for i in 0..blocks * B {
            damped[(i, i)] *= 1.0 + damping;
        }
        let expected = damped.cholesky().unwrap().solve(&b);
        let difference = (DVector::from_vec(x.clone()) - &expected).norm();
        assert!(difference < 1e-9 * (1.0 + expected.norm()), "{difference}");
    }
    factor.factorise(&structure, &matrix, 0.0).unwrap();
    let selected = SelectedInverse::new(&structure, &factor);
    let inverse = dense.clone().cholesky().unwrap().inverse();
    for row in 0..blocks {
        for column in 0..blocks {
            let exact = inverse.view((row * B, column * B), (B, B));
            let needed =
                row == column || structure.slot(row.max(column), row.min(column)).is_some();
            match selected.block(&structure, row, column) {
                Some(block) => assert!((block - exact).norm() < 1e-9 * (1.0 + inverse.norm())),
                None => assert!(!needed, "{row} {column}"),
            }
        }
    }
    let x = DVector::from_fn(blocks * B, |_, _| numbers.next().unwrap());
    let quadratic = matrix.quadratic(&structure, x.as_slice());
    let expected = x.dot(&(&dense * &x));
    assert!((quadratic - expected).abs() < 1e-9 * (1.0 + expected.abs()));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn systems_are_solved_as_dense_ones(
        blocks in 1usize..40,
        raw in proptest::collection::vec((0usize..40, 0usize..40), 0..90),
        seed: u64,
    ) {
        let pairs: Vec<_> = raw.iter().map(|&(a, b)| (a % blocks, b % blocks)).collect();
        solves::<1>(blocks, &pairs, seed);
        solves::<2>(blocks, &pairs, seed);
        solves::<3>(blocks, &pairs, seed);
        solves::<6>(blocks, &pairs, seed);
    }
}

#[test]
fn chains_grids_stars_and_cliques_are_solved() {
    let chain: Vec<_> = (1..200).map(|i| (i - 1, i)).collect();
    solves::<3>(200, &chain, 1);
    let mut grid = Vec::new();
    for i in 0..12 {
        for j in 0..12 {
            if i + 1 < 12 {
                grid.push((12 * i + j, 12 * i + j + 12));
            }
            if j + 1 < 12 {
                grid.push((12 * i + j, 12 * i + j + 1));
            }
        }
    }
    solves::<3>(144, &grid, 2);
    solves::<6>(144, &grid, 3);
    let star: Vec<_> = (1..50).map(|i| (0, i)).collect();
    solves::<6>(50, &star, 4);
    let clique: Vec<_> = (0..20).flat_map(|i| (0..i).map(move |j| (i, j))).collect();
    solves::<3>(20, &clique, 5);
}

#[test]
fn nothing_is_solved_too() {
    solves::<3>(0, &[], 1);
    solves::<3>(1, &[], 1);
    solves::<3>(5, &[], 1);
}

#[test]
fn a_dependent_block_is_named() {
    let structure = Structure::new(3, [(0, 1), (1, 2)].into_iter(), 100).unwrap();
    let mut matrix = BlockMatrix::<2>::new(&structure);
    for i in 0..3 {
        matrix.diagonal[i] = SMatrix::identity();
    }
    let at = structure.position(1);
    matrix.diagonal[at][(1, 1)] = 0.0;
    let mut factor = Factor::new(&structure);
    let error = factor.factorise(&structure, &matrix, 0.0).unwrap_err();
    assert_eq!(error, NotPositive { position: at, row: 1 });
    matrix.diagonal[at][(1, 1)] = f64::NAN;
    assert_eq!(factor.factorise(&structure, &matrix, 0.0).unwrap_err().position, at);
}

#[test]
fn too_dense_a_graph_is_refused_before_memory_is_taken() {
    let clique = (0..100).flat_map(|i| (0..i).map(move |j| (i, j)));
    assert_eq!(Structure::new(100, clique, 1000).unwrap_err(), TooDense { limit: 1000 });
}

#[test]
fn what_the_factor_leaves_out_is_made_up_for() {
    let mut numbers = numbers(3);
    let blocks = 60;
    let chain = (1..blocks).map(|i| (i - 1, i));
    let mut index = || ((numbers.next().unwrap() + 1.0) * 0.5 * blocks as f64) as usize;
    let mut others: Vec<(usize, usize)> = (0..300).map(|_| (index(), index())).collect();
    // Repeated, reversed, on the diagonal and part of the chain: nothing of that is special.
    others.extend([(4, 4), (8, 2), (2, 8), (6, 5)]);
    let structure =
        Structure::partial(blocks, chain.clone(), others.iter().copied(), 1000).unwrap();
    assert!(!structure.is_complete() && structure.factor_blocks() < 4 * blocks);
    let mut matrix = BlockMatrix::<2>::new(&structure);
    assert_eq!(matrix.below.len(), structure.pairs());
    let mut dense = DMatrix::<f64>::identity(2 * blocks, 2 * blocks);
    matrix.diagonal.fill(SMatrix::identity());
    for (a, b) in chain.chain(others).filter(|(a, b)| a != b) {
        let (a, b) = (structure.position(a), structure.position(b));
        let (row, column) = (a.max(b), a.min(b));
        let [left, right] =
            [(); 2].map(|()| SMatrix::<f64, 2, 2>::from_fn(|_, _| number(&mut numbers)));
        let block = left.transpose() * right;
        matrix.diagonal[row] += left.transpose() * left;
        matrix.diagonal[column] += right.transpose() * right;
        matrix.below[structure.slot(row, column).unwrap()] += block;
        for (at, own) in [(row, left), (column, right)] {
            let mut sum = dense.fixed_view_mut::<2, 2>(2 * at, 2 * at);
            sum += own.transpose() * own;
        }
        let mut sum = dense.fixed_view_mut::<2, 2>(2 * row, 2 * column);
        sum += block;
        let mut sum = dense.fixed_view_mut::<2, 2>(2 * column, 2 * row);
        sum += block.transpose();
    }
    let b = DVector::from_fn(2 * blocks, |_, _| number(&mut numbers));
    let mut factor = Factor::new(&structure);
    for damping in [0.0, 0.5] {
        let mut damped = dense.clone();
        (0..2 * blocks).for_each(|i| damped[(i, i)] *= 1.0 + damping);
        factor.factorise(&structure, &matrix, damping).unwrap();
        let mut x = b.as_slice().to_vec();
        let reached = conjugate_gradients(&structure, &factor, &matrix, damping, &mut x, 1e-12);
        assert!(reached.accurate && reached.steps > 3, "{reached:?}");
        let error = (damped * DVector::from_vec(x) - &b).norm() / b.norm();
        assert!(error < 1e-9, "{error}");
    }
}

fn number(numbers: &mut impl Iterator<Item = f64>) -> f64 {
    numbers.next().unwrap()
}
