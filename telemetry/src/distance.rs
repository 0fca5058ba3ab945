//! Exact Euclidean distance transform.

/// Squared distance where no cell is marked, in cells: far beyond the square of any grid's side.
const FAR: f64 = 1e18;

/// Computes the squared distance, in cells, from every cell to the nearest marked one; huge if none is marked.
///
/// Two passes of lower envelopes of parabolas (Felzenszwalb and Huttenlocher, "Distance
/// transforms of sampled functions", 2012), time linear in the cells.
pub(crate) fn squared_distances(marked: &[bool], width: usize) -> Vec<f64> {
    let width = width.max(1);
    let height = marked.len() / width;
    let mut distances: Vec<f64> = marked.iter().map(|marked| if *marked { 0.0 } else { FAR }).collect();
    let mut pass = Envelope::default();
    let mut column = vec![0.0; height];
    for x in 0..width {
        (0..height).for_each(|y| column[y] = distances[y * width + x]);
        pass.transform(&mut column);
        (0..height).for_each(|y| distances[y * width + x] = column[y]);
    }
    distances.chunks_exact_mut(width).for_each(|row| pass.transform(row));
    distances
}

/// Lower envelope of parabolas: their apexes, and where each begins to be the lowest.
#[derive(Default)]
struct Envelope {
    apex: Vec<usize>,
    start: Vec<f64>,
    values: Vec<f64>,
}

impl Envelope {
    /// Replaces a line of squared distances by those that count its other cells too.
    fn transform(&mut self, line: &mut [f64]) {
        self.values.clear();
        self.values.extend_from_slice(line);
        self.apex.clear();
        self.start.clear();
        for at in 0..line.len() {
            let mut from = f64::NEG_INFINITY;
            while let (Some(last), Some(start)) = (self.apex.last(), self.start.last()) {
                from = self.crossing(*last, at);
                if from > *start {
                    break;
                }
                self.apex.pop();
                self.start.pop();
                from = f64::NEG_INFINITY;
            }
            self.apex.push(at);
            self.start.push(from);
        }
        let mut piece = 0;
        for (at, value) in line.iter_mut().enumerate() {
            while self.start.get(piece + 1).is_some_and(|start| *start <= at as f64) {
                piece += 1;
            }
            let offset = at as f64 - self.apex[piece] as f64;
            *value = self.values[self.apex[piece]] + offset * offset;
        }
    }

    /// Where the parabola of the later apex crosses below that of the earlier one.
    fn crossing(&self, earlier: usize, later: usize) -> f64 {
        let (p, q) = (earlier as f64, later as f64);
        ((self.values[later] + q * q) - (self.values[earlier] + p * p)) / (2.0 * (q - p))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_equal_those_of_a_full_search(
            (width, marked) in (1_usize..9).prop_flat_map(|w| (Just(w), proptest::collection::vec(any::<bool>(), w..9 * w))),
        ) {
            let marked = &marked[..marked.len() / width * width];
            let found = squared_distances(marked, width);
            let place = |i: usize| ((i % width) as f64, (i / width) as f64);
            for (i, found) in found.into_iter().enumerate() {
                let (x, y) = place(i);
                let all = (0..marked.len()).filter(|j| marked[*j]).map(|j| (place(j).0 - x).powi(2) + (place(j).1 - y).powi(2));
                match all.reduce(f64::min) {
                    Some(nearest) => prop_assert_eq!(found, nearest),
                    None => prop_assert!(found >= FAR),
                }
            }
        }
    }
}
