//! Memory of one robot, with what its scans of the last seconds show, the goals that failed, and the places it visited.
//!
//! All positions are in the frame of the map that the robot is shown in. Every list is bounded; the oldest entry
//! goes first.

use crate::clearance_map::ClearanceMap;
use crate::geometry::distance_m;
use crate::observation::ScanView;
use crate::obstacles::RecentObstacles;
use core::time::Duration;
use msg::{Pose2, Stamp};
use std::collections::VecDeque;

/// Longest delay after which a scan is certainly part of the map, seconds.
const SCAN_AGE_MAX_S: f64 = 4.0;
/// Least time between two scans kept, seconds: at walking pace they overlap well.
const SCAN_PERIOD_S: f64 = 0.2;
/// Slack on [`SCAN_PERIOD_S`] for stamps rounded to nanoseconds, seconds.
const STAMP_ROUNDING_S: f64 = 1e-6;
/// Most scans kept: those of [`SCAN_AGE_MAX_S`] and a few to spare.
const SCANS_MAX: usize = 24;
/// Most beams kept of a scan: enough for 0.05 m between beams at 3 m and 180 degrees.
const BEAMS_MAX: usize = 192;
/// Beams farther apart than this leave cells between them untouched and say nothing about an area, metres.
const BEAM_GAP_MAX_M: f64 = 0.075;
/// Smallest angle between beams that is divided by, radians.
const BEAM_ANGLE_MIN_RAD: f64 = 1e-6;
/// Farthest range of a kept beam, metres: further away an error of the heading moves it by more than a cell.
const BEAM_RANGE_MAX_M: f64 = 3.0;

/// Most goals whose attempts are remembered.
const ATTEMPTED_GOALS_MAX: usize = 64;
/// Goals closer together than this are the same goal, metres.
const SAME_ATTEMPT_M: f64 = 0.3;
/// After this time a goal may be tried again, seconds: other robots and people may have moved.
const ATTEMPT_AGE_MAX_S: f64 = 90.0;

/// Most visited places remembered: 100 m of driving at [`VISIT_SPACING_M`].
const VISITS_MAX: usize = 256;
/// Distance between two remembered places, metres.
const VISIT_SPACING_M: f64 = 0.4;

/// What one robot remembers.
#[derive(Clone, Debug, Default)]
pub struct RobotMemory {
    /// Scans that the map may not show yet.
    recent_scans: RecentScans,
    /// Obstacles that the map may not show.
    obstacles: RecentObstacles,
    /// When a scan was recorded last.
    recorded: Stamp,
    /// Goals that were tried in vain.
    pub attempts: GoalAttempts,
    /// Places that the robot has been to.
    pub visits: VisitHistory,
}

impl RobotMemory {
    /// Records the robot's pose and scan; `robots_m` are the positions of the other robots, whose bodies have this radius.
    pub fn record(
        &mut self,
        now: Stamp,
        map_from_base: Pose2,
        scan: &ScanView,
        robots_m: &[[f64; 2]],
        radius_m: f64,
    ) {
        self.recorded = now;
        self.obstacles.record(now, map_from_base, scan, robots_m, radius_m);
        self.visits.record(now, [map_from_base.x_m, map_from_base.y_m]);
        self.recent_scans.record(now, map_from_base, scan);
    }

    /// Draws into a window of the map what the scans show and the map does not: free space and obstacles.
    pub fn mark(&self, map: &mut ClearanceMap) {
        self.recent_scans.mark_free_space(map);
        self.obstacles.mark(self.recorded, Pose2::IDENTITY, map);
    }

    /// Removes everything: the robot is shown in another map from now on.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

/// Scans of the last four seconds, because maps lag behind scans.
#[derive(Clone, Debug, Default)]
struct RecentScans {
    scans: VecDeque<SeenRays>,
}

/// Beams of one scan in the frame of the map.
#[derive(Clone, Debug)]
struct SeenRays {
    stamp: Stamp,
    origin_m: [f64; 2],
    ends_m: Vec<[f64; 2]>,
}

impl RecentScans {
    /// Adds a scan unless the newest one is less than 0.2 s old, and drops those older than 4 s.
    fn record(&mut self, now: Stamp, map_from_base: Pose2, scan: &ScanView) {
        while self.scans.front().is_some_and(|seen| now - seen.stamp > SCAN_AGE_MAX_S) {
            self.scans.pop_front();
        }
        let is_due = |seen: &SeenRays| now - seen.stamp >= SCAN_PERIOD_S - STAMP_ROUNDING_S;
        if self.scans.back().is_none_or(is_due) {
            push_bounded(&mut self.scans, seen_rays(now, map_from_base, scan), SCANS_MAX);
        }
    }

    /// Marks what the beams passed through as free where the map does not know it yet.
    fn mark_free_space(&self, map: &mut ClearanceMap) {
        for seen in &self.scans {
            for end in &seen.ends_m {
                map.mark_ray_free(seen.origin_m, *end);
            }
        }
    }
}

fn seen_rays(stamp: Stamp, map_from_base: Pose2, scan: &ScanView) -> SeenRays {
    let map_from_scan = map_from_base * scan.base_from_scan;
    let stride = scan.ranges_m.len().div_ceil(BEAMS_MAX).max(1);
    let between_rad = (scan.angle_increment_rad * stride as f64).abs().max(BEAM_ANGLE_MIN_RAD);
    let range_max_m = BEAM_RANGE_MAX_M.min(BEAM_GAP_MAX_M / between_rad);
    let beams = scan.beams().step_by(stride).take(BEAMS_MAX);
    let ends_m = beams
        .map(|beam| {
            let (sin, cos) = beam.angle_rad.sin_cos();
            let range_m = beam.range_m.min(range_max_m);
            map_from_scan.apply([cos * range_m, sin * range_m])
        })
        .collect();
    SeenRays { stamp, origin_m: [map_from_scan.x_m, map_from_scan.y_m], ends_m }
}

/// How often goals were tried in vain, forgotten after 90 s.
#[derive(Clone, Debug, Default)]
pub struct GoalAttempts {
    goals: VecDeque<AttemptedGoal>,
}

#[derive(Clone, Copy, Debug)]
struct AttemptedGoal {
    position_m: [f64; 2],
    attempts: u32,
    until: Stamp,
}

impl GoalAttempts {
    /// Adds attempts to the goal at a position.
    pub fn add(&mut self, now: Stamp, position_m: [f64; 2], attempts: u32) {
        let until = now + Duration::from_secs_f64(ATTEMPT_AGE_MAX_S);
        self.goals.retain(|goal| goal.until > now);
        let is_same = |goal: &&mut AttemptedGoal| distance_m(goal.position_m, position_m) < SAME_ATTEMPT_M;
        match self.goals.iter_mut().find(is_same) {
            Some(goal) => (goal.attempts, goal.until) = (goal.attempts.saturating_add(attempts), until),
            None => {
                let goal = AttemptedGoal { position_m, attempts, until };
                push_bounded(&mut self.goals, goal, ATTEMPTED_GOALS_MAX);
            }
        }
    }

    /// Number of attempts at the goal at a position.
    pub fn count(&self, now: Stamp, position_m: [f64; 2]) -> u32 {
        let is_same = |goal: &&AttemptedGoal| {
            goal.until > now && distance_m(goal.position_m, position_m) < SAME_ATTEMPT_M
        };
        self.goals.iter().filter(is_same).map(|goal| goal.attempts).max().unwrap_or(0)
    }
}

/// Places along the robot's way, 0.4 m apart, with the time of each visit.
#[derive(Clone, Debug, Default)]
pub struct VisitHistory {
    visits: VecDeque<(Stamp, [f64; 2])>,
}

impl VisitHistory {
    /// Adds the robot's position if it is far enough from the last one.
    pub fn record(&mut self, now: Stamp, position_m: [f64; 2]) {
        if self.visits.back().is_none_or(|(_, last)| distance_m(*last, position_m) >= VISIT_SPACING_M) {
            push_bounded(&mut self.visits, (now, position_m), VISITS_MAX);
        }
    }

    /// Seconds since the robot was last within `radius_m` of a place; `None` if it does not remember a visit.
    pub fn since_visit_s(&self, now: Stamp, place_m: [f64; 2], radius_m: f64) -> Option<f64> {
        let visit = self.visits.iter().rev().find(|(_, position)| distance_m(*position, place_m) <= radius_m);
        visit.map(|(stamp, _)| now - *stamp)
    }
}

/// Adds an item to a queue; the oldest makes room.
pub(crate) fn push_bounded<T>(queue: &mut VecDeque<T>, item: T, max: usize) {
    if queue.len() == max {
        queue.pop_front();
    }
    queue.push_back(item);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attempts_add_up_and_expire() {
        let mut attempts = GoalAttempts::default();
        let at = Stamp::from_seconds;
        attempts.add(at(0.0), [1.0, 1.0], 1);
        attempts.add(at(1.0), [1.1, 1.0], 1);
        assert_eq!(attempts.count(at(2.0), [1.0, 1.1]), 2);
        assert_eq!(attempts.count(at(2.0), [2.0, 1.0]), 0);
        assert_eq!(attempts.count(at(92.0), [1.0, 1.0]), 0);
        for i in 0..1000 {
            attempts.add(at(3.0), [f64::from(i), 0.0], 1);
        }
        assert_eq!(attempts.goals.len(), ATTEMPTED_GOALS_MAX);
    }

    #[test]
    fn scans_and_visits_are_bounded() {
        let mut memory = RobotMemory::default();
        let scan = ScanView {
            received: Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: -3.0,
            angle_increment_rad: 0.001,
            range_min_m: 0.1,
            range_max_m: 3.5,
            ranges_m: &[1.0; 4096],
        };
        for i in 0..2000 {
            let now = Stamp::from_seconds(f64::from(i) * 0.2);
            memory.record(now, Pose2::new(f64::from(i) * 0.1, 0.0, 0.0), &scan, &[], 0.1);
        }
        assert_eq!(memory.visits.visits.len(), VISITS_MAX);
        assert!(memory.recent_scans.scans.len() <= SCANS_MAX);
        assert!(memory.recent_scans.scans.iter().all(|seen| seen.ends_m.len() <= BEAMS_MAX));
        let now = Stamp::from_seconds(400.0);
        let since_s = memory.visits.since_visit_s(now, [180.0, 0.0], 0.5).unwrap();
        assert!((30.0..50.0).contains(&since_s), "{since_s}");
        assert!(memory.visits.since_visit_s(now, [0.0, 50.0], 0.5).is_none());
    }
}
