//! Sparse Cholesky factorization of a symmetric matrix of 3 x 3 blocks, with one row of blocks for each pose.
//!
//! `A = L Lᵀ` is computed row by row ("up-looking": T. Davis, *Direct Methods for Sparse Linear Systems*, SIAM 2006,
//! section 4.7; the pattern of `L` as in section 4.4). The rows are eliminated in an approximate minimum degree order
//! (Amestoy, Davis, Duff, SIAM J. Matrix Anal. Appl. 1996). Everything is on one thread, in one order: the same
//! matrix gives the same bits.

use nalgebra::{Cholesky, Matrix3, Vector3};

/// A block of the matrix on or below its diagonal: its row and its column, `row >= column`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockIndex {
    /// Row, in blocks.
    pub row: usize,
    /// Column, in blocks.
    pub column: usize,
}

/// Elimination order and pattern of the factor: the same for all matrices with blocks at the same places.
pub(crate) struct SymbolicFactor {
    /// Place of each row of the matrix in the elimination order.
    place_of_row: Vec<usize>,
    /// By row of the reordered matrix: its blocks up to the diagonal.
    matrix_rows: Lists<MatrixBlock>,
    /// By row of `L`: columns of its blocks before the diagonal, ascending.
    factor_rows: Lists<usize>,
    /// By column of `L`: rows of its blocks below the diagonal, ascending.
    factor_columns: Lists<usize>,
}

/// Where a block of the reordered matrix comes from.
#[derive(Clone, Copy)]
struct MatrixBlock {
    column: usize,
    /// Index of the block in the caller's list.
    source: usize,
    /// The caller's block lies above the diagonal of the reordered matrix.
    transposed: bool,
}

/// The factor `L`.
pub(crate) struct NumericFactor<'a> {
    symbolic: &'a SymbolicFactor,
    /// By row: the inverse of the diagonal block.
    inverse_diagonal: Vec<Matrix3<f64>>,
    /// The blocks below the diagonal, in the order of [`SymbolicFactor::factor_columns`].
    below: Vec<Matrix3<f64>>,
}

impl SymbolicFactor {
    /// Orders the rows and finds the pattern of `L`. Several blocks may have one index: they add up. The diagonal
    /// blocks have to be there. `None` if no order is found.
    pub fn new(rows: usize, blocks: &[BlockIndex]) -> Option<Self> {
        let place_of_row = minimum_degree_order(rows, blocks)?;
        let mut by_row = vec![Vec::new(); rows];
        for (source, block) in blocks.iter().enumerate() {
            let (row, column) = (place_of_row[block.row], place_of_row[block.column]);
            let transposed = row < column;
            by_row[row.max(column)].push(MatrixBlock { column: row.min(column), source, transposed });
        }
        let matrix_rows = Lists::new(&by_row);
        let factor_rows = Lists::new(&factor_pattern(&matrix_rows));
        let factor_columns = factor_rows.transposed();
        Some(Self { place_of_row, matrix_rows, factor_rows, factor_columns })
    }

    /// Number of rows of the matrix.
    pub fn rows(&self) -> usize {
        self.place_of_row.len()
    }

    /// Factors the matrix with these blocks, in the order of the indices given to [`SymbolicFactor::new`].
    /// `None` if it is not positive definite.
    pub fn factor(&self, blocks: &[Matrix3<f64>]) -> Option<NumericFactor<'_>> {
        let rows = self.rows();
        let mut inverse_diagonal: Vec<Matrix3<f64>> = Vec::with_capacity(rows);
        let mut below = vec![Matrix3::zeros(); self.factor_columns.items.len()];
        // By column: where its next block goes. Blocks before it are those of the rows that are done.
        let mut next = self.factor_columns.offsets.clone();
        let mut row = vec![Matrix3::zeros(); rows];
        for k in 0..rows {
            for block in self.matrix_rows.of(k) {
                let values = &blocks[block.source];
                row[block.column] += if block.transposed { values.transpose() } else { *values };
            }
            for &column in self.factor_rows.of(k) {
                let block = core::mem::take(&mut row[column]) * inverse_diagonal[column].transpose();
                let done = self.factor_columns.offsets[column]..next[column];
                for (&j, other) in self.factor_columns.items[done.clone()].iter().zip(&below[done]) {
                    row[j] -= block * other.transpose();
                }
                row[k] -= block * block.transpose();
                below[next[column]] = block;
                next[column] += 1;
            }
            let diagonal = Cholesky::new(core::mem::take(&mut row[k]))?;
            let inverse = diagonal.l().solve_lower_triangular(&Matrix3::identity())?;
            // An infinite pivot would hide what the row says.
            if inverse.diagonal().iter().any(|pivot| *pivot == 0.0) {
                return None;
            }
            inverse_diagonal.push(inverse);
        }
        Some(NumericFactor { symbolic: self, inverse_diagonal, below })
    }
}

impl NumericFactor<'_> {
    /// Solves `A x = right`, a vector for each row of the matrix.
    pub fn solve(&self, right: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let columns = &self.symbolic.factor_columns;
        let mut x = vec![Vector3::zeros(); right.len()];
        for (&place, value) in self.symbolic.place_of_row.iter().zip(right) {
            x[place] = *value;
        }
        for column in 0..x.len() {
            let value = self.inverse_diagonal[column] * x[column];
            x[column] = value;
            for (&row, block) in columns.of(column).iter().zip(&self.below[columns.range(column)]) {
                x[row] -= block * value;
            }
        }
        for column in (0..x.len()).rev() {
            let mut value = x[column];
            for (&row, block) in columns.of(column).iter().zip(&self.below[columns.range(column)]) {
                value -= block.tr_mul(&x[row]);
            }
            x[column] = self.inverse_diagonal[column].tr_mul(&value);
        }
        self.symbolic.place_of_row.iter().map(|&place| x[place]).collect()
    }
}

/// Lists of different lengths, one after the other in one vector.
struct Lists<T> {
    /// Begin of each list in `items`, and the end of the last one.
    offsets: Vec<usize>,
    items: Vec<T>,
}

impl<T: Copy> Lists<T> {
    fn new(lists: &[Vec<T>]) -> Self {
        let mut offsets = vec![0];
        offsets.extend(lists.iter().scan(0, |end, list| {
            *end += list.len();
            Some(*end)
        }));
        Self { offsets, items: lists.concat() }
    }

    fn range(&self, list: usize) -> core::ops::Range<usize> {
        self.offsets[list]..self.offsets[list + 1]
    }

    fn of(&self, list: usize) -> &[T] {
        &self.items[self.range(list)]
    }
}

impl Lists<usize> {
    /// The list of `k` names the lists that `k` is in, ascending.
    fn transposed(&self) -> Self {
        let mut lists = vec![Vec::new(); self.offsets.len() - 1];
        for list in 0..lists.len() {
            self.of(list).iter().for_each(|&item| lists[item].push(list));
        }
        Self::new(&lists)
    }
}

/// Place of each row in the elimination order.
fn minimum_degree_order(rows: usize, blocks: &[BlockIndex]) -> Option<Vec<usize>> {
    let mut by_column = vec![Vec::new(); rows];
    blocks.iter().for_each(|block| by_column[block.column].push(block.row));
    for rows in &mut by_column {
        rows.sort_unstable();
        rows.dedup();
    }
    let pattern = Lists::new(&by_column);
    let (_, place_of_row, _) =
        amd::order(rows, &pattern.offsets, &pattern.items, &amd::Control::default()).ok()?;
    Some(place_of_row)
}

/// By row of `L`: columns of its blocks before the diagonal, ascending. A row has a block in the column of each of the
/// matrix's blocks, and in all columns on the way from there to the root of the elimination tree, up to the row.
fn factor_pattern(matrix_rows: &Lists<MatrixBlock>) -> Vec<Vec<usize>> {
    let rows = matrix_rows.offsets.len() - 1;
    let mut parent: Vec<Option<usize>> = vec![None; rows];
    let mut last_row_with: Vec<Option<usize>> = vec![None; rows];
    (0..rows)
        .map(|row| {
            let mut columns = Vec::new();
            last_row_with[row] = Some(row);
            for block in matrix_rows.of(row) {
                let mut column = block.column;
                while last_row_with[column] != Some(row) {
                    last_row_with[column] = Some(row);
                    columns.push(column);
                    column = *parent[column].get_or_insert(row);
                }
            }
            columns.sort_unstable();
            columns
        })
        .collect()
}

#[cfg(test)]
mod tests;
