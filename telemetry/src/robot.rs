//! What is known of one robot.

use crate::Histogram;
use crate::jitter::Jitter;
use crate::scans::Scans;
use heapless::Deque;
use msg::grid::{MAP_CELLS_MAX, Occupancy, UNKNOWN, occupancy};
use msg::{Correction, Grid, GridView, GroundTruth, Monotonic, Pose2, RobotStats, Stamp};

/// True poses remembered until the correction of that time arrives: more than half a second at 100 Hz.
const TRUTHS: usize = 64;
/// A true pose this far from the correction's stamp is not compared with it, seconds: at most
/// 1.5 cm of driving.
const TRUTH_APART_S: f64 = 0.1;

/// One robot.
#[derive(Default)]
pub(crate) struct Robot {
    pub jitter: Jitter,
    scans: Scans,
    scan_to_pose: Histogram,
    scan_to_map: Histogram,
    newest: Option<Correction>,
    truths: Deque<(Stamp, Pose2), TRUTHS>,
    pub grid: Grid,
    /// Counts the maps taken.
    pub version: u64,
    counted: RobotStats,
    /// If the launcher knows.
    pub world_from_robot_map: Option<Pose2>,
}

impl Robot {
    /// `world` from `robotK/map`, if the launcher knows.
    pub fn new(world_from_robot_map: Option<Pose2>) -> Self {
        Self { world_from_robot_map, ..Default::default() }
    }

    pub fn correction(&mut self, correction: &Correction, received: Monotonic) {
        self.scans.add(correction);
        latency(&mut self.scan_to_pose, correction.scan_sent, received);
        self.newest = Some(*correction);
    }

    pub fn map_came(&mut self, scan_sent: Monotonic, received: Monotonic) {
        latency(&mut self.scan_to_map, scan_sent, received);
    }

    pub fn map(&mut self, map: GridView<'_>) {
        let sound = GridView::new(map.header, map.cells).is_some() && map.cells.len() <= MAP_CELLS_MAX;
        if !sound {
            return;
        }
        self.grid.header = *map.header;
        self.grid.cells.clear();
        self.grid.cells.extend_from_slice(map.cells);
        self.counted = count(map);
        self.version += 1;
    }

    pub fn truth(&mut self, truth: &GroundTruth) {
        if self.truths.is_full() {
            self.truths.pop_front();
        }
        let _ = self.truths.push_back((truth.header.stamp, truth.world_from_base));
    }

    pub fn stats(&self, stamp: Stamp) -> RobotStats {
        let correction = self.newest.unwrap_or_default();
        RobotStats {
            state: correction.state,
            scan_hz: self.scans.rate_hz(stamp),
            scans: self.scans.received,
            scans_lost: self.scans.lost,
            tf_jitter_ms: self.jitter.deviations().distribution_ms(),
            scan_to_pose_ms: self.scan_to_pose.distribution_ms(),
            scan_to_map_ms: self.scan_to_map.distribution_ms(),
            map_from_base: correction.map_from_base,
            pose_error_m: self.pose_error_m().unwrap_or(f64::NAN),
            nodes: correction.nodes,
            closures: correction.closures,
            ..self.counted
        }
    }

    /// SLAM's newest pose against the true one of nearly the same time.
    fn pose_error_m(&self) -> Option<f64> {
        let correction = self.newest.as_ref()?;
        let apart = |stamp: Stamp| (stamp - correction.header.stamp).abs();
        let nearest = self.truths.iter().min_by(|a, b| apart(a.0).total_cmp(&apart(b.0)))?;
        let world_from_base = self.world_from_robot_map? * correction.map_from_base;
        (apart(nearest.0) <= TRUTH_APART_S).then(|| world_from_base.distance_m(nearest.1))
    }
}

/// A time of sending that is missing or lies ahead is no latency.
fn latency(histogram: &mut Histogram, sent: Monotonic, received: Monotonic) {
    if sent != Monotonic::default() && sent <= received {
        histogram.add(received.since(sent));
    }
}

/// A map's cells by map_server's thresholds, and the paper's coverage.
pub(crate) fn count(map: GridView<'_>) -> RobotStats {
    let free = map.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Free).count();
    let occupied = map.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Occupied).count();
    let total = map.cells.len();
    debug_assert_eq!(occupancy(UNKNOWN), Occupancy::Unknown);
    RobotStats {
        free_cells: free as u32, // all at most MAP_CELLS_MAX
        occupied_cells: occupied as u32,
        unknown_cells: (total - free - occupied) as u32,
        width: map.header.width,
        height: map.header.height,
        resolution_m: map.header.resolution_m,
        coverage: (free + occupied) as f64 / total.max(1) as f64,
        ..Default::default()
    }
}
