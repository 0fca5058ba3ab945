//! What an operator keeps in mind about one robot: what its eyes saw in the last seconds, which places
//! turned out not to show anything new, and where it has been.

use crate::floor::Floor;
use crate::sight::ScanView;
use msg::{Pose2, Stamp};
use std::collections::VecDeque;

/// Maps lag behind the scans; what was seen this long ago is certainly drawn by now, seconds.
const GLIMPSE_AGE_MAX_S: f64 = 4.0;
/// One scan in this time is kept, seconds.
const GLIMPSE_EVERY_S: f64 = 0.2;
const GLIMPSES_MAX: usize = 24;
const GLIMPSE_BEAMS_MAX: usize = 192;
/// Beams further apart than this do not join to a surface seen, metres.
const BEAM_GAP_MAX_M: f64 = 0.075;
/// How far a glimpse is trusted, metres.
const GLIMPSE_RANGE_MAX_M: f64 = 3.0;

const DOUBTS_MAX: usize = 64;
/// Doubts closer together than this are about the same place, metres.
const DOUBT_RADIUS_M: f64 = 0.3;
/// After this long a place is worth another try, seconds.
const DOUBT_AGE_MAX_S: f64 = 90.0;

const TRAIL_MAX: usize = 256;
const TRAIL_STEP_M: f64 = 0.4;

#[derive(Clone, Debug)]
struct Glimpse {
    stamp: Stamp,
    from_m: [f64; 2],
    ends_m: Vec<[f64; 2]>,
}

#[derive(Clone, Copy, Debug)]
struct Doubt {
    at_m: [f64; 2],
    tries: u32,
    until: Stamp,
}

/// One robot's, in the frame of the map it is shown in. Bounded; the oldest is forgotten first.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    glimpses: VecDeque<Glimpse>,
    doubts: VecDeque<Doubt>,
    trail: VecDeque<(Stamp, [f64; 2])>,
}

impl Memory {
    /// Takes in where the robot is and what it sees.
    pub fn note(&mut self, now: Stamp, map_from_base: Pose2, scan: &ScanView) {
        let here = [map_from_base.x_m, map_from_base.y_m];
        if self.trail.back().is_none_or(|(_, last)| distance_m(*last, here) >= TRAIL_STEP_M) {
            push_bounded(&mut self.trail, (now, here), TRAIL_MAX);
        }
        while self.glimpses.front().is_some_and(|g| now - g.stamp > GLIMPSE_AGE_MAX_S) {
            self.glimpses.pop_front();
        }
        if self.glimpses.back().is_none_or(|g| now - g.stamp >= GLIMPSE_EVERY_S - 1e-6) {
            push_bounded(&mut self.glimpses, glimpse(now, map_from_base, scan), GLIMPSES_MAX);
        }
    }

    /// Forgets what was seen and doubted: the robot is shown in another map from now on.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Draws what was seen of late where the map says nothing yet.
    pub fn draw_glimpses(&self, floor: &mut Floor) {
        for glimpse in &self.glimpses {
            for end in &glimpse.ends_m {
                floor.mark_seen(glimpse.from_m, *end);
            }
        }
    }

    /// Looking at this place brought nothing new, `tries` times more.
    pub fn doubt(&mut self, now: Stamp, at_m: [f64; 2], tries: u32) {
        let until = now + core::time::Duration::from_secs_f64(DOUBT_AGE_MAX_S);
        self.doubts.retain(|doubt| doubt.until > now);
        match self.doubts.iter_mut().find(|doubt| distance_m(doubt.at_m, at_m) < DOUBT_RADIUS_M) {
            Some(doubt) => *doubt = Doubt { tries: doubt.tries.saturating_add(tries), until, ..*doubt },
            None => push_bounded(&mut self.doubts, Doubt { at_m, tries, until }, DOUBTS_MAX),
        }
    }

    /// How often this place was tried in vain.
    pub fn tries(&self, now: Stamp, at_m: [f64; 2]) -> u32 {
        let about = |doubt: &&Doubt| doubt.until > now && distance_m(doubt.at_m, at_m) < DOUBT_RADIUS_M;
        self.doubts.iter().filter(about).map(|doubt| doubt.tries).max().unwrap_or(0)
    }

    /// Seconds since the robot was last within `radius_m` of a place, if it remembers.
    pub fn absent_s(&self, now: Stamp, at_m: [f64; 2], radius_m: f64) -> Option<f64> {
        let visit = self.trail.iter().rev().find(|(_, place)| distance_m(*place, at_m) <= radius_m);
        visit.map(|(stamp, _)| now - *stamp)
    }
}

fn glimpse(stamp: Stamp, map_from_base: Pose2, scan: &ScanView) -> Glimpse {
    let map_from_scan = map_from_base * scan.base_from_scan;
    let stride = scan.ranges_m.len().div_ceil(GLIMPSE_BEAMS_MAX).max(1);
    let between_rad = (scan.angle_increment_rad * stride as f64).abs().max(1e-6);
    let range_max_m = GLIMPSE_RANGE_MAX_M.min(BEAM_GAP_MAX_M / between_rad);
    let beams = scan.beams().step_by(stride).take(GLIMPSE_BEAMS_MAX);
    let ends_m = beams
        .map(|beam| {
            let (sin, cos) = beam.angle_rad.sin_cos();
            let range_m = beam.range_m.min(range_max_m);
            map_from_scan.apply([cos * range_m, sin * range_m])
        })
        .collect();
    Glimpse { stamp, from_m: [map_from_scan.x_m, map_from_scan.y_m], ends_m }
}

fn push_bounded<T>(queue: &mut VecDeque<T>, item: T, max: usize) {
    if queue.len() == max {
        queue.pop_front();
    }
    queue.push_back(item);
}

/// Metres between two points.
pub fn distance_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubts_add_up_and_fade() {
        let mut memory = Memory::default();
        let at = Stamp::from_seconds;
        memory.doubt(at(0.0), [1.0, 1.0], 1);
        memory.doubt(at(1.0), [1.1, 1.0], 1);
        assert_eq!(memory.tries(at(2.0), [1.0, 1.1]), 2);
        assert_eq!(memory.tries(at(2.0), [2.0, 1.0]), 0);
        assert_eq!(memory.tries(at(92.0), [1.0, 1.0]), 0);
        for i in 0..1000 {
            memory.doubt(at(3.0), [f64::from(i), 0.0], 1);
        }
        assert_eq!(memory.doubts.len(), DOUBTS_MAX);
    }

    #[test]
    fn remembers_where_it_was_in_bounds() {
        let mut memory = Memory::default();
        let scan = ScanView {
            seen: Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: -3.0,
            angle_increment_rad: 0.001,
            range_min_m: 0.1,
            range_max_m: 3.5,
            ranges_m: &[1.0; 4096],
        };
        for i in 0..2000 {
            let now = Stamp::from_seconds(f64::from(i) * 0.2);
            memory.note(now, Pose2::new(f64::from(i) * 0.1, 0.0, 0.0), &scan);
        }
        assert_eq!(memory.trail.len(), TRAIL_MAX);
        assert!(memory.glimpses.len() <= GLIMPSES_MAX);
        assert!(memory.glimpses.iter().all(|g| g.ends_m.len() <= GLIMPSE_BEAMS_MAX));
        let absent_s = memory.absent_s(Stamp::from_seconds(400.0), [180.0, 0.0], 0.5).unwrap();
        assert!((30.0..50.0).contains(&absent_s), "{absent_s}");
        assert!(memory.absent_s(Stamp::from_seconds(400.0), [0.0, 50.0], 0.5).is_none());
    }
}
