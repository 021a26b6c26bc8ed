use super::*;
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

const N: usize = 13;
type Factor = Cholesky<N, { packed(N) }>;

/// A·Aᵀ + I of the first `n` rows of a random A.
fn matrix(a: &[[f32; N]], rows: &[usize]) -> Vec<Vec<f32>> {
    rows.iter()
        .map(|&i| {
            rows.iter()
                .map(|&j| {
                    let s: f32 = (0..N).map(|k| a[i][k] * a[j][k]).sum();
                    s + f32::from(u8::from(i == j))
                })
                .collect()
        })
        .collect()
}

fn factor(m: &[Vec<f32>]) -> Factor {
    let mut f = Factor::new();
    for i in 0..m.len() {
        f.stage(0).copy_from_slice(&m[i][..i + 1]);
        assert_eq!(f.append(), Ok(()));
    }
    f
}

fn solve_error(f: &Factor, m: &[Vec<f32>]) -> f32 {
    let mut x: Vec<f32> = (0..m.len()).map(|i| 1.0 - 0.3 * i as f32).collect();
    let b = x.clone();
    f.forward(&mut x);
    f.backward(&mut x);
    (0..m.len())
        .map(|i| ((0..m.len()).map(|j| m[i][j] * x[j]).sum::<f32>() - b[i]).abs())
        .fold(0.0, f32::max)
}

proptest! {
    #[test]
    fn appending_and_removing_solves(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), gone in 0usize..13) {
        let mut rows: Vec<usize> = (0..N).collect();
        let mut f = factor(&matrix(&a, &rows));
        prop_assert!(solve_error(&f, &matrix(&a, &rows)) < 1e-3);
        f.remove(gone);
        rows.remove(gone);
        let m = matrix(&a, &rows);
        prop_assert!(solve_error(&f, &m) < 1e-3);
        let fresh = factor(&m);
        prop_assert!((f.half_log_determinant() - fresh.half_log_determinant()).abs() < 1e-3);
        f.remove(99);
        prop_assert_eq!(f.rows(), N - 1);
    }
}

proptest! {
    #[test]
    fn downdating_takes_a_product_away(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), v in proptest::array::uniform13(-1.0f32..1.0)) {
        let rows: Vec<usize> = (0..N).collect();
        let m = matrix(&a, &rows);
        let more: Vec<Vec<f32>> =
            (0..N).map(|i| (0..N).map(|j| m[i][j] + v[i] * v[j]).collect()).collect();
        let mut f = factor(&more);
        f.downdate(&v[..N - 1]);
        prop_assert!(solve_error(&f, &more) < 1e-3);
        f.downdate(&v);
        prop_assert!(solve_error(&f, &m) < 3e-3);
        // More than there is: still a factor.
        f.downdate(&[100.0; N]);
        prop_assert!(f.half_log_determinant().is_finite());
    }
}

proptest! {
    #[test]
    fn sides_solved_together_are_those_solved_alone(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), first in 0usize..14, short in 0usize..14) {
        let rows: Vec<usize> = (0..N).collect();
        let f = factor(&matrix(&a, &rows));
        let count = N.saturating_sub(first + short);
        let (mut together, mut alone) = ([[7.0; 3]; N], [[0.0; N]; 3]);
        for (i, side) in (0..count).flat_map(|i| (0..3).map(move |side| (i, side))) {
            together[i][side] = a[side][i];
            alone[side][first + i] = a[side][i];
        }
        f.forward_together(first, &mut together[..count]);
        alone.iter_mut().for_each(|x| f.forward(x));
        for (i, side) in (0..count).flat_map(|i| (0..3).map(move |side| (i, side))) {
            prop_assert!((together[i][side] - alone[side][first + i]).abs() < 1e-5);
        }
        // What was not handed over is as it was.
        prop_assert!(together[count..].iter().flatten().all(|x| *x == 7.0));
    }
}

proptest! {
    #[test]
    fn rows_appended_together_are_those_appended_alone(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), before in 0usize..12, count in 1usize..5) {
        let rows: Vec<usize> = (0..(before + count).min(N)).collect();
        let count = rows.len() - before;
        let m = matrix(&a, &rows);
        let alone = factor(&m);
        let mut f = factor(&m[..before]);
        let stage = |f: &mut Factor| {
            for i in 0..count {
                f.stage(i).copy_from_slice(&m[before + i][..before + i + 1]);
            }
        };
        stage(&mut f);
        prop_assert_eq!(f.append_together(count), Ok(()));
        prop_assert_eq!(f.rows(), rows.len());
        for i in 0..packed(rows.len()) {
            prop_assert!((f.lower[i] - alone.lower[i]).abs() < 1e-5);
        }
        prop_assert!(solve_error(&f, &m) < 1e-3);
        // One that is no row: none is taken.
        f.truncate(before);
        stage(&mut f);
        f.stage(count - 1)[before + count - 1] = -1.0;
        prop_assert_eq!(f.append_together(count), Err(NotPositiveDefinite));
        prop_assert_eq!(f.rows(), before);
    }
}

proptest! {
    #[test]
    fn a_block_of_rows_is_those_appended_alone(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), before in 0usize..10, count in 1usize..5) {
        let rows: Vec<usize> = (0..before + count).collect();
        let m = matrix(&a, &rows);
        let alone = factor(&m);
        let mut f = factor(&m[..before]);
        // Past the last row, and above the diagonal, whatever.
        let entry = |i: usize, k: usize| if i < count && k <= before + i { m[before + i][k] } else { 7.0 };
        let columns: Vec<[f32; 4]> =
            (0..before).map(|k| core::array::from_fn(|i| entry(i, k))).collect();
        let mut own: [[f32; 4]; 4] =
            core::array::from_fn(|i| core::array::from_fn(|j| entry(i, before + j)));
        prop_assert_eq!(f.append_block(count, &mut columns.clone(), &own), Ok(()));
        prop_assert_eq!(f.rows(), rows.len());
        for i in 0..packed(rows.len()) {
            prop_assert!((f.lower[i] - alone.lower[i]).abs() < 1e-5);
        }
        // More than there are, no row, or columns that are not those of the rows: none is taken.
        f.truncate(before);
        prop_assert_eq!(f.append_block(5, &mut columns.clone(), &own), Err(NotPositiveDefinite));
        let wrong = &mut [[0.0; 4]; N][..before + 1];
        prop_assert_eq!(f.append_block(count, wrong, &own), Err(NotPositiveDefinite));
        own[count - 1][count - 1] = -1.0;
        prop_assert_eq!(f.append_block(count, &mut columns.clone(), &own), Err(NotPositiveDefinite));
        prop_assert_eq!(f.rows(), before);
    }
}

proptest! {
    #[test]
    fn independent_rows_are_those_appended_alone(a in proptest::array::uniform13(proptest::array::uniform13(-1.0f32..1.0)), before in 1usize..10) {
        let rows: Vec<usize> = (0..before + 4).collect();
        let mut m = matrix(&a, &rows);
        for i in before..before + 4 {
            for j in (before..before + 4).filter(|j| *j != i) {
                m[i][j] = 0.0;
            }
            m[i][i] += 12.0;
        }
        let alone = factor(&m);
        let mut f = factor(&m[..before]);
        // Whatever is staged.
        (0..4).for_each(|i| f.stage(i).fill(7.0));
        let mut columns: Vec<[f32; 4]> =
            (0..before).map(|k| core::array::from_fn(|i| m[before + i][k])).collect();
        let own = core::array::from_fn(|i| m[before + i][before + i]);
        let mut indefinite = columns.clone();
        prop_assert_eq!(f.append_independent(&mut columns, own), Ok(()));
        prop_assert_eq!(f.rows(), rows.len());
        for i in 0..packed(rows.len()) {
            prop_assert!((f.lower[i] - alone.lower[i]).abs() < 1e-5);
        }
        // One that is no row, or columns that are not those of the rows: none is taken.
        f.truncate(before);
        let bad = [own[0], own[1], own[2], -1.0];
        prop_assert_eq!(f.append_independent(&mut indefinite, bad), Err(NotPositiveDefinite));
        for wrong in [before - 1, N] {
            let columns = &mut [[0.0; 4]; N][..wrong];
            prop_assert_eq!(f.append_independent(columns, own), Err(NotPositiveDefinite));
        }
        prop_assert_eq!(f.rows(), before);
    }
}

#[test]
fn refuses_what_is_not_positive_definite() {
    let mut f = Factor::new();
    f.stage(0).copy_from_slice(&[2.0]);
    assert_eq!(f.append(), Ok(()));
    for bad in [[2.0, 2.0], [3.0, 1.0], [0.0, f32::NAN], [0.0, f32::INFINITY], [0.0, -1.0]] {
        f.stage(0).copy_from_slice(&bad);
        assert_eq!(f.append(), Err(NotPositiveDefinite));
        assert_eq!(f.rows(), 1);
    }
}

#[test]
fn rows_that_do_not_exist_solve_nothing() {
    let f = factor(&[vec![2.0]]);
    for first in [1, N, N + 1, 1_000] {
        let mut x = [[1.0, 2.0, 3.0]];
        f.forward_together(first, &mut x);
        assert_eq!(x, [[1.0, 2.0, 3.0]]);
    }
}

#[test]
fn a_full_factor_stages_nothing() {
    let mut f = Cholesky::<1, 1>::new();
    f.stage(0)[0] = 1.0;
    assert_eq!(f.append(), Ok(()));
    assert!(f.stage(0).is_empty());
    for count in 0..7 {
        assert_eq!(f.append(), Err(NotPositiveDefinite));
        assert_eq!(f.append_together(count), Err(NotPositiveDefinite));
    }
    assert_eq!(f.append_independent(&mut [[0.5]], [1.0]), Err(NotPositiveDefinite));
}

#[test]
fn taking_more_away_than_there_is_leaves_a_factor() {
    const ROWS: usize = 40;
    let mut f = Cholesky::<ROWS, { packed(ROWS) }>::new();
    for i in 0..ROWS {
        f.stage(0).fill(0.9);
        f.stage(0)[i] = 1.0;
        f.append().unwrap();
    }
    for more in [0.96, 1.0, 1.2, 1e6, f32::NAN] {
        let mut f = f.clone();
        f.downdate(&[more; ROWS]);
        let mut x = [1.0; ROWS];
        f.forward(&mut x);
        assert!(more.is_nan() || x.iter().all(|x| x.abs() < 1e4), "{more}: {x:?}");
        assert!(f.half_log_determinant().is_finite());
    }
}

#[test]
fn there_is_no_room_however_far_ahead() {
    let mut f = factor(&[std::vec![1.0]]);
    assert!(f.stage(N - 2).len() == N && f.stage(N - 1).is_empty());
    assert!(f.stage(usize::MAX).is_empty());
}
