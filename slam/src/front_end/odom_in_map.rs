//! Where odometry's frame lies in the map: the transform `map` from `odom` (REP-105).

use msg::Pose2;

/// Newest poses of the robot at one stamp in two frames, by which one frame lies in the other.
#[derive(Clone, Copy, Debug)]
struct PosePair {
    /// Pose in the front end's frame, or in the map.
    frame_from_base: Pose2,
    /// Inverse of the pose in the continuous frame of odometry.
    base_from_continuous: Pose2,
}

/// Pose of odometry's frame in the front end's frame and in the map, as of the newest scan with odometry.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OdomInMap {
    local: Option<PosePair>,
    map: Option<PosePair>,
}

impl OdomInMap {
    /// Adds a scan's pose. `continuous_from_base` is `None` if odometry is missing at its stamp, `map_from_local` if the robot is not
    /// located: then the frame stays in the map where it was.
    pub fn update(
        &mut self,
        local_from_base: Pose2,
        continuous_from_base: Option<Pose2>,
        map_from_local: Option<Pose2>,
    ) {
        if let Some(continuous_from_base) = continuous_from_base {
            let base_from_continuous = continuous_from_base.inverse();
            self.local = Some(PosePair { frame_from_base: local_from_base, base_from_continuous });
        }
        // The front end's frame may lie elsewhere in the map since the newest scan with odometry.
        if let (Some(map_from_local), Some(local)) = (map_from_local, self.local) {
            self.map = Some(PosePair { frame_from_base: map_from_local * local.frame_from_base, ..local });
        }
    }

    /// Returns the transform `map` from `odom`; `None` if it was never known.
    pub fn map_from_odom(&self, continuous_from_odom: Pose2) -> Option<Pose2> {
        self.map.map(|pair| pair.frame_from_base * (pair.base_from_continuous * continuous_from_odom))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odom_follows_the_local_frame_also_where_odometry_is_missing() {
        let (local_from_base, continuous_from_base) = (Pose2::new(1.0, 0.0, 0.0), Pose2::new(4.0, 0.0, 0.0));
        let mut odom = OdomInMap::default();
        odom.update(local_from_base, Some(continuous_from_base), None);
        assert_eq!(odom.map_from_odom(Pose2::IDENTITY), None, "the robot is not located");
        for x_m in [0.0, 10.0] {
            odom.update(local_from_base, None, Some(Pose2::new(x_m, 0.0, 0.0)));
            assert_eq!(odom.map_from_odom(Pose2::IDENTITY), Some(Pose2::new(x_m - 3.0, 0.0, 0.0)));
        }
        odom.update(Pose2::new(2.0, 0.0, 0.0), Some(continuous_from_base), None);
        assert_eq!(odom.map_from_odom(Pose2::IDENTITY), Some(Pose2::new(7.0, 0.0, 0.0)), "it stays");
    }
}
