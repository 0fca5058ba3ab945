//! The factorization against nalgebra's dense one.

use super::{BlockIndex, SymbolicFactor};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use proptest::prelude::*;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

const ROWS: usize = 9;

fn matrix() -> impl Strategy<Value = Matrix3<f64>> {
    prop::array::uniform9(-1.0..1.0).prop_map(|values| Matrix3::from_row_slice(&values))
}

/// A positive definite matrix as a graph makes it: for each edge, `[a b]ᵀ [a b]` at the rows of its two ends.
/// Several edges may join the same rows. Indices and blocks, diagonal first.
fn positive_definite() -> impl Strategy<Value = (Vec<BlockIndex>, Vec<Matrix3<f64>>)> {
    prop::collection::vec((0..ROWS, 0..ROWS, matrix(), matrix()), 0..30).prop_map(|edges| {
        let mut indices: Vec<BlockIndex> = (0..ROWS).map(|row| BlockIndex { row, column: row }).collect();
        let mut blocks = vec![Matrix3::identity(); ROWS];
        for (row, column, a, b) in edges.into_iter().filter(|(row, column, ..)| row > column) {
            blocks[row] += a.transpose() * a;
            blocks[column] += b.transpose() * b;
            indices.push(BlockIndex { row, column });
            blocks.push(a.transpose() * b);
        }
        (indices, blocks)
    })
}

fn dense(indices: &[BlockIndex], blocks: &[Matrix3<f64>]) -> DMatrix<f64> {
    let mut dense = DMatrix::zeros(3 * ROWS, 3 * ROWS);
    for (index, block) in indices.iter().zip(blocks) {
        let mut add = |row: usize, column: usize, block: Matrix3<f64>| {
            let mut place = dense.fixed_view_mut::<3, 3>(3 * row, 3 * column);
            place += block;
        };
        add(index.row, index.column, *block);
        if index.row != index.column {
            add(index.column, index.row, block.transpose());
        }
    }
    dense
}

proptest! {
    #[test]
    fn the_solution_is_that_of_the_dense_factorization(
        (indices, blocks) in positive_definite(),
        right in prop::collection::vec(prop::array::uniform3(-5.0..5.0), ROWS),
    ) {
        let right: Vec<Vector3<f64>> = right.into_iter().map(Vector3::from).collect();
        let symbolic = SymbolicFactor::new(ROWS, &indices).unwrap();
        let solution = symbolic.factor(&blocks).unwrap().solve(&right);
        let dense_right = DVector::from_iterator(3 * ROWS, right.iter().flatten().copied());
        let expected = dense(&indices, &blocks).cholesky().unwrap().solve(&dense_right);
        for (value, expected) in solution.iter().flatten().zip(&expected) {
            prop_assert!((value - expected).abs() < 1e-9, "{value} instead of {expected}");
        }
    }

    /// One diagonal entry below zero: no matrix of this kind is positive definite.
    #[test]
    fn a_matrix_that_is_not_positive_definite_has_no_factor(
        (indices, mut blocks) in positive_definite(),
        row in 0..ROWS,
        entry in 0_usize..3,
    ) {
        blocks[row][(entry, entry)] = -1e-3;
        prop_assert!(SymbolicFactor::new(ROWS, &indices).unwrap().factor(&blocks).is_none());
    }
}

#[test]
fn a_matrix_with_nan_infinity_or_of_zeros_has_no_factor() {
    let symbolic = SymbolicFactor::new(1, &[BlockIndex { row: 0, column: 0 }]).unwrap();
    assert!(symbolic.factor(&[Matrix3::zeros()]).is_none());
    assert!(symbolic.factor(&[Matrix3::from_element(f64::NAN)]).is_none());
    assert!(symbolic.factor(&[Matrix3::identity() * f64::INFINITY]).is_none());
    assert!(symbolic.factor(&[Matrix3::from_diagonal_element(f64::INFINITY)]).is_none());
}

/// A hub that all others touch, eliminated first, would join all of them.
#[test]
fn the_elimination_order_keeps_a_star_sparse() {
    let rows = 200;
    let diagonal = (0..rows).map(|row| BlockIndex { row, column: row });
    let spokes = (1..rows).map(|row| BlockIndex { row, column: 0 });
    let symbolic = SymbolicFactor::new(rows, &diagonal.chain(spokes).collect::<Vec<_>>()).unwrap();
    assert_eq!(symbolic.factor_columns.items.len(), rows - 1);
}

/// As large as a robot's graph: a chain, and edges between places that lie anywhere along it.
#[test]
fn large_graphs_are_solved() {
    for seed in 0..20 {
        let mut random = SplitMix64::seed_from_u64(seed);
        let rows = 1 + random.next_u32() as usize % 2000;
        let mut indices: Vec<BlockIndex> = (0..rows).map(|row| BlockIndex { row, column: row }).collect();
        let mut blocks = vec![Matrix3::identity(); rows];
        let chain = (1..rows).map(|row| (row, row - 1));
        let ends: Vec<(usize, usize)> = chain
            .chain(
                (0..3 * rows).map(|_| (random.next_u32() as usize % rows, random.next_u32() as usize % rows)),
            )
            .filter(|(row, column)| row > column)
            .collect();
        for (row, column) in ends {
            let mut number = || f64::from(random.next_u32()) / f64::from(u32::MAX) - 0.5;
            let [a, b] = [Matrix3::from_fn(|_, _| number()), Matrix3::from_fn(|_, _| number())];
            blocks[row] += a.transpose() * a;
            blocks[column] += b.transpose() * b;
            indices.push(BlockIndex { row, column });
            blocks.push(a.transpose() * b);
        }
        let right: Vec<Vector3<f64>> =
            (0..rows).map(|row| Vector3::repeat(row as f64 / rows as f64)).collect();
        let x = SymbolicFactor::new(rows, &indices).unwrap().factor(&blocks).unwrap().solve(&right);
        let mut residual: Vec<Vector3<f64>> = right.iter().map(|value| -value).collect();
        for (index, block) in indices.iter().zip(&blocks) {
            residual[index.row] += block * x[index.column];
            if index.row != index.column {
                residual[index.column] += block.tr_mul(&x[index.row]);
            }
        }
        let worst = residual.iter().map(Vector3::amax).fold(0.0, f64::max);
        assert!(worst < 1e-9, "seed {seed}, {rows} rows: {worst}");
    }
}

#[test]
fn a_matrix_without_rows_is_solved() {
    let symbolic = SymbolicFactor::new(0, &[]).unwrap();
    assert!(symbolic.factor(&[]).unwrap().solve(&[]).is_empty());
}
