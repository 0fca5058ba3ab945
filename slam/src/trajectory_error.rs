//! Error of a trajectory where the recording has the true poses.

use crate::PlaceInMap;
use msg::pose::best_rigid_transform;
use msg::{Pose2, Stamp};
use serde::Serialize;

/// Distances between the poses in the map and the true ones, after the rigid transform that fits best (absolute trajectory
/// error; Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrajectoryError {
    /// Number of scans that are placed in the map and of which the true pose is known.
    pub scans: usize,
    /// Mean distance, metres.
    pub mean_m: f64,
    /// Root of the mean squared distance, metres.
    pub rms_m: f64,
    /// Largest distance, metres.
    pub max_m: f64,
}

impl TrajectoryError {
    /// Compares the poses that are placed in the map with the true ones of the same stamps, which are in order of time; `None`
    /// if no pose is known in both.
    pub fn of_placed(
        map_from_base: &[(Stamp, Pose2, PlaceInMap)],
        world_from_base: &[(Stamp, Pose2)],
    ) -> Option<Self> {
        let placed = map_from_base.iter().filter(|(_, _, place)| *place == PlaceInMap::Known);
        let pairs: Vec<[[f64; 2]; 2]> = placed
            .filter_map(|(stamp, estimate, _)| {
                let found = world_from_base.binary_search_by_key(stamp, |(stamp, _)| *stamp).ok()?;
                Some([*estimate, world_from_base[found].1].map(|pose| [pose.x_m, pose.y_m]))
            })
            .collect();
        let world_from_map = best_rigid_transform(&pairs)?;
        let distance_m = |[estimate, truth]: &[[f64; 2]; 2]| {
            let [x, y] = world_from_map.apply(*estimate);
            (x - truth[0]).hypot(y - truth[1])
        };
        let distances_m: Vec<f64> = pairs.iter().map(distance_m).collect();
        let count = distances_m.len() as f64;
        Some(Self {
            scans: distances_m.len(),
            mean_m: distances_m.iter().sum::<f64>() / count,
            rms_m: (distances_m.iter().map(|m| m * m).sum::<f64>() / count).sqrt(),
            max_m: distances_m.iter().copied().fold(0.0, f64::max),
        })
    }

    /// Formats the error for a terminal.
    pub fn text(&self) -> String {
        format!(
            "  error     mean {:.3} m, RMS {:.3} m, max {:.3} m, of {} scans with true poses\n",
            self.mean_m, self.rms_m, self.max_m, self.scans
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight(step: i64) -> Pose2 {
        Pose2::new(step as f64, 0.0, 0.0)
    }

    fn trajectory(steps: i64, pose: impl Fn(i64) -> Pose2) -> Vec<(Stamp, Pose2, PlaceInMap)> {
        (0..steps).map(|step| (Stamp(step), pose(step), PlaceInMap::Known)).collect()
    }

    #[test]
    fn an_error_is_what_no_rigid_transform_removes() {
        let world_from_map = Pose2::new(4.0, -2.0, 1.1);
        let truth: Vec<_> = (0..40).map(|step| (Stamp(step), world_from_map * straight(step))).collect();
        let zigzag = |step: i64| Pose2::new(step as f64, if step % 2 == 0 { 0.1 } else { -0.1 }, 0.0);
        // Of ten scans there is no true pose, and one is not placed.
        let mut estimate = trajectory(50, zigzag);
        estimate[7] = (Stamp(7), Pose2::new(90.0, 0.0, 0.0), PlaceInMap::Unplaced(7));
        let error = TrajectoryError::of_placed(&estimate, &truth).unwrap();
        assert_eq!(error.scans, 39);
        for value in [error.mean_m, error.rms_m, error.max_m] {
            assert!((value - 0.1).abs() < 0.02, "{error:?}");
        }
        let exact = TrajectoryError::of_placed(&trajectory(40, straight), &truth).unwrap();
        assert!(exact.max_m < 1e-9, "{exact:?}");
    }

    #[test]
    fn without_true_poses_there_is_no_error() {
        assert_eq!(TrajectoryError::of_placed(&trajectory(3, straight), &[]), None);
    }
}
