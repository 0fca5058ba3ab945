//! Frontiers: where the known free floor ends and nobody has looked further (Yamauchi 1997).

use crate::floor::Floor;
use crate::routes::Routes;
use msg::grid::Occupancy;

/// A long frontier is looked at in pieces of at most this many cells.
const PIECE_CELLS_MAX: usize = 24;
/// Shorter pieces are noise of the map, cells.
const PIECE_CELLS_MIN: usize = 5;
/// How far past a frontier one has to see for it to be worth the way, metres.
const DEPTH_M: f64 = 0.3;
/// At most this many pieces are weighed, nearest first.
const PIECES_MAX: usize = 192;

/// A piece of frontier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frontier {
    /// The free cell in its middle.
    pub cell: usize,
    /// What nobody has seen beyond it.
    pub beyond: usize,
    /// A place deeper in the unknown.
    pub deep: usize,
    /// Its length, metres.
    pub length_m: f64,
}

/// Finds the frontiers among the reached cells.
#[derive(Clone, Debug, Default)]
pub struct FrontierSearch {
    is_frontier: Vec<bool>,
    piece: Vec<usize>,
    found: Vec<Frontier>,
}

impl FrontierSearch {
    /// The pieces, nearest first.
    pub fn find(&mut self, floor: &Floor, routes: &Routes) -> &[Frontier] {
        self.found.clear();
        self.is_frontier.clear();
        self.is_frontier.resize(floor.known().len(), false);
        for cell in routes.reached() {
            self.is_frontier[*cell] = unknown_beside(floor, *cell).is_some();
        }
        for seed in routes.reached() {
            if self.found.len() == PIECES_MAX {
                break;
            }
            if self.is_frontier[*seed] {
                self.collect_piece(floor, *seed);
                self.found.extend(self.middle(floor));
            }
        }
        &self.found
    }

    /// The connected cells around `seed`, taken out of the set.
    fn collect_piece(&mut self, floor: &Floor, seed: usize) {
        self.piece.clear();
        self.piece.push(seed);
        self.is_frontier[seed] = false;
        let mut next = 0;
        while next < self.piece.len() && self.piece.len() < PIECE_CELLS_MAX {
            let cell = self.piece[next];
            for neighbour in (0..8).filter_map(|d| floor.neighbour(cell, d)) {
                if self.is_frontier[neighbour] && self.piece.len() < PIECE_CELLS_MAX {
                    self.is_frontier[neighbour] = false;
                    self.piece.push(neighbour);
                }
            }
            next += 1;
        }
    }

    /// From `cell` into the unknown, across the piece.
    fn deep(&self, floor: &Floor, cell: usize) -> Option<usize> {
        let mut inwards = [0.0, 0.0];
        for cell in &self.piece {
            let from = floor.centre_m(*cell);
            let unknown = unknown_beside(floor, *cell).map_or(from, |unknown| floor.centre_m(unknown));
            inwards = [inwards[0] + unknown[0] - from[0], inwards[1] + unknown[1] - from[1]];
        }
        let length = inwards[0].hypot(inwards[1]);
        let [x, y] = floor.centre_m(cell);
        let step = DEPTH_M / length;
        step.is_finite().then(|| floor.cell_of([x + inwards[0] * step, y + inwards[1] * step])).flatten()
    }

    fn middle(&self, floor: &Floor) -> Option<Frontier> {
        if self.piece.len() < PIECE_CELLS_MIN {
            return None;
        }
        let count = self.piece.len() as f64;
        let centres = || self.piece.iter().map(|cell| floor.centre_m(*cell));
        let sum = centres().fold([0.0, 0.0], |sum, c| [sum[0] + c[0], sum[1] + c[1]]);
        let mean = [sum[0] / count, sum[1] / count];
        let off = |cell: &usize| {
            let [x, y] = floor.centre_m(*cell);
            (x - mean[0]).hypot(y - mean[1])
        };
        let cell = *self.piece.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        let beyond = unknown_beside(floor, cell)?;
        let deep = self.deep(floor, cell).unwrap_or(beyond);
        Some(Frontier { cell, beyond, deep, length_m: count * floor.cell_m() })
    }
}

/// An unknown cell at one of a cell's four sides.
fn unknown_beside(floor: &Floor, cell: usize) -> Option<usize> {
    let sides = [0, 2, 4, 6].into_iter().filter_map(|direction| floor.neighbour(cell, direction));
    sides.into_iter().find(|side| floor.known()[*side] == Occupancy::Unknown)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sight::MapView;
    use msg::Pose2;

    #[test]
    fn a_half_seen_room_has_its_frontier_at_the_edge_of_sight() {
        // Free up to column 30, unknown beyond, walls above and below.
        let mut cells = vec![-1_i8; 60 * 40];
        for (x, y) in (0..31).flat_map(|x| (0..40).map(move |y| (x, y))) {
            cells[y * 60 + x] = if x == 0 || y == 0 || y == 39 { 100 } else { 0 };
        }
        let map = MapView::percent(Pose2::IDENTITY, 0.05, (60, 40), &cells).unwrap();
        let mut floor = Floor::default();
        floor.survey(&map, [0.5, 1.0]);
        floor.measure_clearance();
        let mut routes = Routes::default();
        assert!(routes.spread(&floor, [0.5, 1.0], 0.15));
        let mut search = FrontierSearch::default();
        let found = search.find(&floor, &routes);
        let length_m: f64 = found.iter().map(|f| f.length_m).sum();
        assert!((1.7..=2.0).contains(&length_m), "{length_m}: {found:?}");
        for frontier in found {
            assert!((floor.centre_m(frontier.cell)[0] - 1.525).abs() < 1e-9);
            assert!((floor.centre_m(frontier.beyond)[0] - 1.575).abs() < 1e-9);
        }
        // Once all is seen, none is left.
        let cells: Vec<i8> = cells.iter().map(|cell| if *cell == -1 { 100 } else { *cell }).collect();
        let map = MapView::percent(Pose2::IDENTITY, 0.05, (60, 40), &cells).unwrap();
        floor.survey(&map, [0.5, 1.0]);
        floor.measure_clearance();
        assert!(routes.spread(&floor, [0.5, 1.0], 0.15));
        assert!(search.find(&floor, &routes).is_empty());
    }
}
