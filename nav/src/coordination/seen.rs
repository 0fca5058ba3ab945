//! Unknown cells that robots have looked at in vain: some surfaces never return a beam.

use crate::clearance_map::ClearanceMap;
use std::collections::HashMap;

/// Side of a square in which attempts are counted, metres: two cells of the map, so that corrections of it matter little.
const SQUARE_M: f64 = 0.1;
/// Attempts after which a square is left alone.
const ATTEMPTS_MAX: u8 = 2;
/// Most squares that are remembered: 1000 square metres. More are not added.
const SQUARES_MAX: usize = 100_000;

/// Squares of unknown space with the number of attempts to see them.
#[derive(Clone, Debug, Default)]
pub(super) struct UnseenCells {
    attempts: HashMap<[i32; 2], Attempts>,
    attempt: u32,
}

#[derive(Clone, Copy, Debug)]
struct Attempts {
    count: u8,
    last: u32,
    /// Whether a robot was there in one of them: others gave up on the way.
    has_looked: bool,
}

impl UnseenCells {
    /// Counts the attempt under way for the square of a point, in which a robot looked or gave up on the way; once, however
    /// often it is called.
    pub(super) fn add_attempt(&mut self, point_m: [f64; 2], has_looked: bool) {
        let key = Self::key(point_m);
        if self.attempts.len() >= SQUARES_MAX && !self.attempts.contains_key(&key) {
            return;
        }
        let none = Attempts { count: 0, last: u32::MAX, has_looked: false };
        let square = self.attempts.entry(key).or_insert(none);
        square.has_looked |= has_looked;
        if square.last != self.attempt {
            (square.count, square.last) = (square.count.saturating_add(1), self.attempt);
        }
    }

    /// Ends the attempt under way.
    pub(super) fn end_attempt(&mut self) {
        self.attempt = self.attempt.wrapping_add(1);
    }

    /// Whether a point is in a square that is left alone.
    pub(super) fn is_given_up(&self, point_m: [f64; 2]) -> bool {
        self.attempts.get(&Self::key(point_m)).is_some_and(|square| square.count >= ATTEMPTS_MAX)
    }

    /// Whether a robot has looked at the square of a point.
    pub(super) fn has_looked(&self, point_m: [f64; 2]) -> bool {
        self.attempts.get(&Self::key(point_m)).is_some_and(|square| square.has_looked)
    }

    /// Sets the cells of a map whose squares are left alone.
    pub(super) fn mark_given_up(&self, map: &ClearanceMap, cells: &mut Vec<bool>) {
        cells.clear();
        cells.resize(map.cell_count(), false);
        let given_up = self.attempts.iter().filter(|(_, square)| square.count >= ATTEMPTS_MAX);
        // The cells whose centres lie in a square, with one of margin: their own test decides.
        let steps = (SQUARE_M / map.cell_size_m()).ceil() as i64 + 1;
        for (key, _) in given_up {
            let middle_m = key.map(|v| (f64::from(v) + 0.5) * SQUARE_M);
            let Some(middle) = map.cell_at(middle_m) else { continue };
            for (dx, dy) in (-steps..=steps).flat_map(|dy| (-steps..=steps).map(move |dx| (dx, dy))) {
                let cell = middle as i64 + dy * map.width() + dx;
                let cell = usize::try_from(cell).ok().filter(|cell| *cell < cells.len());
                if let Some(cell) = cell.filter(|cell| Self::key(map.cell_centre_m(*cell)) == *key) {
                    cells[cell] = true;
                }
            }
        }
    }

    fn key(point_m: [f64; 2]) -> [i32; 2] {
        point_m.map(|v| (v / SQUARE_M).floor() as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_is_given_up_after_two_attempts() {
        let mut unseen = UnseenCells::default();
        for attempt in 0..2 {
            assert!(!unseen.is_given_up([1.02, 3.0]), "{attempt}");
            unseen.add_attempt([1.02, 3.01], attempt == 1);
            unseen.add_attempt([1.07, 3.08], false);
            assert_eq!(unseen.has_looked([1.05, 3.05]), attempt == 1);
            unseen.end_attempt();
        }
        assert!(unseen.is_given_up([1.05, 3.05]));
        assert!(!unseen.is_given_up([1.15, 3.05]));
    }
}
