//! Agreement of every pair of the robots' maps, a bounded amount of work at a time.

use crate::consistency::{agreement_under_random_transform, compare, overlap_centre_m};
use msg::grid_agreement::GridAgreement;
use msg::{Grid, Pose2, ROBOTS_MAX};

/// Cells compared in one call, about 20 ms of work: other pairs wait for the next call.
const CELLS_PER_CALL: usize = 6_000_000;
/// Newest wrong transforms of a pair that count.
const NULL_TRANSFORMS: usize = 20;
/// Cells compared under wrong transforms in one call, about 2.5 ms of work.
const NULL_CELLS_PER_CALL: usize = 750_000;

/// A robot's newest map with its transform.
pub(crate) struct PlacedMap<'a> {
    /// The map's cells, in the robot's own frame `robotK/map`.
    pub grid: &'a Grid,
    /// Equal versions have equal cells.
    pub version: u64,
    /// Frame `map` from frame `robotK/map`; `None` while it is unknown.
    pub map_from_robot_map: Option<Pose2>,
}

/// The newest comparison of each pair.
pub(crate) struct PairComparisons {
    results: Vec<Option<GridAgreement>>,
    /// Versions of both maps and the transform of each result.
    compared: Vec<Option<(u64, u64, Pose2)>>,
    next: usize,
    /// Agreement and F1 of each pair under its newest wrong transforms.
    nulls: Vec<heapless::HistoryBuf<[f64; 2], NULL_TRANSFORMS>>,
    /// The pair that gets the next wrong transform.
    next_null: usize,
    /// Wrong transforms drawn, the seed of the next one.
    draws: u64,
}

/// Means over the pairs that overlap.
#[derive(Clone, Debug)]
pub(crate) struct PairMeans {
    /// Pairs that overlap.
    pub count: u32,
    /// Means of their figures; NaN where no pair overlaps.
    pub mean: GridAgreement,
    /// Wrong transforms of all pairs that count.
    pub null_count: u32,
    /// Mean agreement under them; NaN before any.
    pub null_agreement_mean: f64,
    /// Mean F1 under them; NaN before any.
    pub null_f1_mean: f64,
}

impl PairComparisons {
    /// Creates the table of a fleet in which no pair has been compared yet.
    pub fn new(robot_count: usize) -> Self {
        let pairs = robot_count * robot_count.saturating_sub(1) / 2;
        Self {
            results: vec![None; pairs],
            compared: vec![None; pairs],
            next: 0,
            nulls: vec![heapless::HistoryBuf::new(); pairs],
            next_null: 0,
            draws: 0,
        }
    }

    /// Compares one pair under random wrong transforms until one leaves enough overlap, or [`NULL_CELLS_PER_CALL`] have
    /// been compared. The pairs take turns.
    pub fn draw_null(&mut self, maps: &[PlacedMap<'_>]) {
        let overlapping = |slot: &usize| self.results[*slot].is_some();
        let Some(slot) = (self.next_null..self.results.len()).chain(0..self.next_null).find(overlapping)
        else {
            return;
        };
        self.next_null = (slot + 1) % self.results.len();
        let (i, j) = robots_of(slot);
        let (Some(right), Some((.., a_from_b))) = (&self.results[slot], self.compared[slot]) else { return };
        let (a, b) = (maps[i].grid.view(), maps[j].grid.view());
        let Some(centre_m) = overlap_centre_m(a, b, a_from_b) else { return };
        let mut cells = 0;
        while cells < NULL_CELLS_PER_CALL {
            self.draws += 1;
            cells += 1 + a.cells.len() + b.cells.len();
            if let Some(wrong) =
                agreement_under_random_transform(a, b, a_from_b, (centre_m, right.overlap_m2), self.draws)
            {
                self.nulls[slot].write([wrong.agreement, wrong.occupied_f1]);
                return;
            }
        }
    }

    /// Compares the pairs whose maps or transforms have changed, in turns if there are many.
    pub fn refresh(&mut self, maps: &[PlacedMap<'_>]) {
        let mut cells = 0;
        for step in 0..self.results.len() {
            let slot = (self.next + step) % self.results.len();
            if cells >= CELLS_PER_CALL {
                self.next = slot;
                return;
            }
            let (i, j) = robots_of(slot);
            let (Some(a), Some(b)) = (maps.get(i), maps.get(j)) else { continue };
            let a_from_b = match (a.map_from_robot_map, b.map_from_robot_map) {
                (Some(a), Some(b)) => a.between(b),
                _ => {
                    (self.results[slot], self.compared[slot]) = (None, None);
                    self.nulls[slot].clear();
                    continue;
                }
            };
            let from = Some((a.version, b.version, a_from_b));
            if self.compared[slot] != from {
                self.results[slot] = compare(a.grid.view(), b.grid.view(), a_from_b);
                self.compared[slot] = from;
                cells += a.grid.cells.len() + b.grid.cells.len();
            }
        }
    }

    /// Computes the means over the pairs.
    pub fn means(&self) -> PairMeans {
        let overlapping = self.results.iter().flatten();
        let (count, sum) = overlapping.fold((0_u32, GridAgreement::default()), |(count, sum), one| {
            let sum = GridAgreement {
                agreement: sum.agreement + one.agreement,
                agreement_near: sum.agreement_near + one.agreement_near,
                occupied_f1: sum.occupied_f1 + one.occupied_f1,
                overlap_m2: sum.overlap_m2 + one.overlap_m2,
                overlap_share: sum.overlap_share + one.overlap_share,
                ..GridAgreement::default()
            };
            (count + 1, sum)
        });
        let n = f64::from(count);
        let mean = GridAgreement {
            agreement: sum.agreement / n,
            agreement_near: sum.agreement_near / n,
            occupied_f1: sum.occupied_f1 / n,
            overlap_m2: sum.overlap_m2 / n,
            overlap_share: sum.overlap_share / n,
            ..GridAgreement::default()
        };
        let draws = || self.nulls.iter().flat_map(|of_pair| of_pair.iter());
        let null_count = draws().count() as u32;
        let [null_agreement_mean, null_f1_mean] =
            [0, 1].map(|k| draws().map(|draw| draw[k]).sum::<f64>() / f64::from(null_count));
        PairMeans { count, mean, null_count, null_agreement_mean, null_f1_mean }
    }
}

/// The robots of a pair: (0, 1), (0, 2), (1, 2), (0, 3), ... The pairs of a small fleet come first.
fn robots_of(slot: usize) -> (usize, usize) {
    let j = (1..ROBOTS_MAX).rfind(|j| j * (j - 1) / 2 <= slot).unwrap_or(1);
    (slot - j * (j - 1) / 2, j)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::house;

    const ROBOTS: usize = 16;
    const PAIRS: usize = ROBOTS * (ROBOTS - 1) / 2;

    #[test]
    fn every_pair_has_one_slot() {
        let mut pairs: Vec<_> = (0..PAIRS).map(robots_of).collect();
        assert!(pairs.iter().all(|(i, j)| i < j && *j < ROBOTS));
        pairs.sort_unstable();
        pairs.dedup();
        assert_eq!(pairs.len(), PAIRS);
    }

    #[test]
    fn many_pairs_take_turns_until_all_are_compared() {
        let grid = house();
        let maps: Vec<_> = (0..ROBOTS)
            .map(|_| PlacedMap { grid: &grid, version: 1, map_from_robot_map: Some(Pose2::IDENTITY) })
            .collect();
        let mut pairs = PairComparisons::new(ROBOTS);
        pairs.refresh(&maps);
        let first = pairs.means().count;
        assert!(first >= 1 && (first as usize) < PAIRS, "{first}");
        for _ in 0..PAIRS {
            pairs.refresh(&maps);
        }
        assert_eq!(pairs.means().count as usize, PAIRS);
        assert_eq!(pairs.means().mean.agreement, 1.0);
        let nobody: Vec<_> = maps
            .iter()
            .map(|map| PlacedMap { map_from_robot_map: None, grid: map.grid, version: 1 })
            .collect();
        pairs.refresh(&nobody);
        assert!(pairs.means().count == 0 && pairs.means().mean.agreement.is_nan());
    }
}
