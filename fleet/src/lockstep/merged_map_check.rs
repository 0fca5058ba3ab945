//! Checks that the merged map does not shrink when its process is started again.

use super::Lockstep;
use super::invariants::KNOWN_SHARE_MIN;
use super::members::Member;
use crate::merge_maps;
use crate::ports::ReadMapPort as _;
use crate::storage::Storage as _;
use msg::grid::known_count;
use msg::{MapHeader, Monotonic, RobotId, Role};
use std::time::Duration;

/// Time after a start of merging in which its map may not be smaller than before: longer than it holds its map back.
const CHECKED: Duration = Duration::from_secs(3);

/// Compares the maps after a start of merging with those before.
#[derive(Default)]
pub struct MergedMapCheck {
    /// Known cells of each robot's map when merging last worked: what happens to a map while merging is stopped or dead
    /// must not be taken for a loss.
    merged_robots: Vec<usize>,
    /// Known cells of each robot's map when merging last worked, then of the merged map when it died.
    before: Option<Vec<usize>>,
    /// When merging died.
    died_at: Monotonic,
    /// Until when the maps are compared, once merging runs again.
    until: Option<Monotonic>,
    counts: CellCounts,
}

/// Known cells of each robot's map, then of the merged map; each with the header of the map that was counted.
#[derive(Default)]
struct CellCounts(Vec<(MapHeader, usize)>);

impl CellCounts {
    /// Counts the maps that have changed since the last count, and returns the known cells of all.
    fn update(&mut self, fleet: &Lockstep) -> Vec<usize> {
        let maps = &fleet.observer.maps;
        self.0.resize(maps.len(), Default::default());
        for ((counted, known), (_, reader, _)) in self.0.iter_mut().zip(maps) {
            let map = reader.map();
            if *counted != map.header {
                *counted = map.header;
                *known = map.tiles().map(|tile| known_count(&tile.cells)).sum();
            }
        }
        self.0.iter().map(|(_, known)| *known).collect()
    }
}

impl MergedMapCheck {
    /// Compares the maps that the observer has now. Call it after each tick.
    pub fn check(&mut self, fleet: &Lockstep) -> Option<String> {
        let now = fleet.time();
        let merges = |member: &Member| member.row.role == Role::Merge && member.is_running();
        if !fleet.members.iter().any(merges) {
            // What a full disk kept from being written cannot be continued.
            let mut known = self.counts.update(fleet);
            known[..self.merged_robots.len()].copy_from_slice(&self.merged_robots);
            if self.before.is_none() && are_written(fleet, &known) {
                (self.before, self.died_at) = (Some(known), now);
            }
            self.until = None;
            return None;
        }
        if fleet.members.iter().any(|member| merges(member) && member.frozen_until <= now) {
            self.merged_robots = self.counts.update(fleet);
            self.merged_robots.pop();
        }
        let before = self.before.as_ref()?;
        if now > *self.until.get_or_insert(now + CHECKED) {
            self.before = None;
            return None;
        }
        let known = self.counts.update(fleet);
        let is_smaller = |(now, before): (&usize, &usize)| (*now as f64) < KNOWN_SHARE_MIN * *before as f64;
        let ((merged, robots), (merged_before, robots_before)) = (known.split_last()?, before.split_last()?);
        // A robot whose own map was begun anew makes the merged map smaller, also for a while after its own has grown.
        // Merging may have the new map before the observer, whose messages are lost or late on their own.
        let is_reset = fleet.reset_at.is_some_and(|at| at + CHECKED >= self.died_at);
        let is_begun_anew = is_reset || robots.iter().zip(robots_before).any(is_smaller);
        let violation = (!is_begun_anew && is_smaller((merged, merged_before))).then(|| {
            format!(
                "the merged map has {merged} known cells after a start of merging at {:.3} s, {merged_before} before",
                now.seconds()
            )
        });
        if is_begun_anew || violation.is_some() {
            self.before = None;
        }
        violation
    }
}

/// Returns whether each map that a robot has sent was written by merging.
fn are_written(fleet: &Lockstep, known: &[usize]) -> bool {
    let robots = RobotId::first(known.len().saturating_sub(1)).zip(known);
    let is_written = |robot: RobotId| {
        let path = merge_maps::path(&fleet.world.run.dir, robot);
        fleet.world.storage.read(&path, u64::MAX).is_ok()
    };
    robots.into_iter().all(|(robot, known)| *known == 0 || is_written(robot))
}
