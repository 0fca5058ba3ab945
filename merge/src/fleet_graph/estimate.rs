//! Estimate of where one robot's map lies, from the fleet's pose graph.

use super::submaps::SubmapStore;
use msg::Pose2;

/// Change below which a transform is not updated, metres: half a cell of 0.05 m. Transforms and redrawn maps follow the
/// graph in steps of it.
pub(crate) const TOLERANCE_M: f64 = 0.025;

/// Frame `map` from frame `robotK/map`: one transform that is right where the robot is now, and one at each submap.
#[derive(Clone, Debug, Default)]
pub(crate) struct RobotEstimate {
    configured_map_from_robot_map: Option<Pose2>,
    map_from_robot_map: Option<Pose2>,
    map_from_robot_map_at_submaps: Vec<Pose2>,
    is_deformed: bool,
}

impl RobotEstimate {
    /// Creates an estimate from a given start, if there is one.
    pub fn new(start: Option<Pose2>) -> Self {
        let mut estimate = Self { configured_map_from_robot_map: start, ..Self::default() };
        estimate.reset_to(start);
        estimate
    }

    /// Returns the given start: `map` from `robotK/map`.
    pub fn configured_map_from_robot_map(&self) -> Option<Pose2> {
        self.configured_map_from_robot_map
    }

    /// Forgets the given start. The estimate stays.
    pub fn forget_start(&mut self) {
        self.configured_map_from_robot_map = None;
    }

    /// Returns the published transform, exact where the robot is now; `None` while it is unknown.
    pub fn map_from_robot_map(&self) -> Option<Pose2> {
        self.map_from_robot_map
    }

    /// Returns the transform at each submap of the last solution; all alike while the robot's map is not deformed.
    pub fn map_from_robot_map_at_submaps(&self) -> &[Pose2] {
        &self.map_from_robot_map_at_submaps
    }

    /// Returns the transform at a submap; that of the newest one for submaps that came after the last solution.
    pub fn at_submap(&self, id: usize) -> Option<Pose2> {
        self.map_from_robot_map_at_submaps.get(id).or(self.map_from_robot_map_at_submaps.last()).copied()
    }

    /// Returns whether no single transform aligns all of the robot's map.
    pub fn is_deformed(&self) -> bool {
        self.is_deformed
    }

    /// Sets one transform for the whole map, or none.
    pub fn reset_to(&mut self, transform: Option<Pose2>) {
        self.set_transform(transform);
        self.is_deformed = false;
    }

    /// Sets one transform for the whole map until the next solution.
    pub fn set_transform(&mut self, transform: Option<Pose2>) {
        self.map_from_robot_map = transform;
        self.map_from_robot_map_at_submaps = transform.into_iter().collect();
    }

    /// Applies a solution. The published transform moves only if it is off by more than [`TOLERANCE_M`] somewhere.
    pub fn apply(&mut self, map_from_robot_map_at_submaps: Vec<Pose2>, submaps: &SubmapStore) {
        self.map_from_robot_map_at_submaps = map_from_robot_map_at_submaps;
        let Some(newest) = self.map_from_robot_map_at_submaps.last().copied() else { return };
        let current = self.map_from_robot_map.map(|transform| self.errors_m(transform, submaps));
        match current {
            Some([largest_m, _]) if largest_m <= TOLERANCE_M => self.is_deformed = false,
            Some([_, newest_m])
                if newest_m <= TOLERANCE_M && self.errors_m(newest, submaps)[0] > TOLERANCE_M =>
            {
                self.is_deformed = true;
            }
            _ => {
                self.map_from_robot_map = Some(newest);
                self.is_deformed = self.errors_m(newest, submaps)[0] > TOLERANCE_M;
            }
        }
    }

    /// Returns the largest error of one transform over the centres of all submaps, and its error at the newest, metres.
    fn errors_m(&self, transform: Pose2, submaps: &SubmapStore) -> [f64; 2] {
        let error_m = |id: usize| {
            let centre = submaps.centre_m(id)?;
            Some(distance_at_m(transform, self.at_submap(id)?, centre))
        };
        let count = submaps.poses().len();
        let largest_m = (0..count).filter_map(error_m).fold(0.0, f64::max);
        let newest_m = count.checked_sub(1).and_then(error_m).unwrap_or(0.0);
        [largest_m, newest_m]
    }
}

/// Returns the distance between the images of a point under two transforms, metres.
pub(crate) fn distance_at_m(one: Pose2, other: Pose2, point_m: [f64; 2]) -> f64 {
    let ([x, y], [u, v]) = (one.apply(point_m), other.apply(point_m));
    (x - u).hypot(y - v)
}
