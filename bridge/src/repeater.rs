//! Repeats SLAM's transforms map -> odom, dated ahead, as SLAM Toolbox and AMCL do for tf2's readers.

use msg::{Monotonic, PoseEstimate, RobotId, Stamp, TrackingState};
use std::time::Duration;

/// How the transforms are repeated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Repetition {
    /// How far ahead of the run's time a transform is dated.
    pub tolerance: Duration,
    /// For how long a transform is repeated after SLAM's last answer.
    pub hold: Duration,
}

/// The newest pose estimate of each robot, while it may be repeated.
#[derive(Debug)]
pub struct PoseEstimateRepeater {
    repetition: Repetition,
    robots: Vec<RobotPoseEstimate>,
}

#[derive(Clone, Copy, Debug)]
struct RobotPoseEstimate {
    /// With the time of its arrival.
    newest: Option<(PoseEstimate, Monotonic)>,
    /// Stamp of the last transform, which only grows.
    sent: Stamp,
}

impl PoseEstimateRepeater {
    /// Creates the repeater of a fleet.
    pub fn new(repetition: Repetition, robot_count: usize) -> Self {
        let none = RobotPoseEstimate { newest: None, sent: Stamp(i64::MIN) };
        Self { repetition, robots: vec![none; robot_count] }
    }

    /// Takes SLAM's answer to a scan. A lost robot's transform is not known, so that nothing is repeated.
    pub fn receive(&mut self, robot: RobotId, pose_estimate: &PoseEstimate, now: Monotonic) {
        let is_known =
            pose_estimate.state() != TrackingState::Lost && pose_estimate.map_from_odom().is_some();
        if let Some(of_robot) = self.robots.get_mut(robot.index()) {
            // The source's time was set back.
            let newest = of_robot.newest.map(|(before, _)| before.header.stamp);
            if newest.is_some_and(|before| pose_estimate.header.stamp < before) {
                of_robot.sent = Stamp(i64::MIN);
            }
            of_robot.newest = is_known.then_some((*pose_estimate, now));
        }
    }

    /// Returns the robot's last pose estimate with the stamp that it has now; `None` if SLAM has been silent for too long,
    /// is lost, or the stamp would not be newer than the last one.
    pub fn take_due(&mut self, robot: RobotId, now: Monotonic) -> Option<PoseEstimate> {
        let Repetition { tolerance, hold } = self.repetition;
        let of_robot = self.robots.get_mut(robot.index())?;
        let (pose_estimate, received) = of_robot.newest?;
        let age = Duration::from_nanos(now.since(received));
        if age > hold {
            of_robot.newest = None;
            return None;
        }
        let stamp = pose_estimate.header.stamp + age + tolerance;
        if stamp <= of_robot.sent {
            return None;
        }
        of_robot.sent = stamp;
        let mut repeated = pose_estimate;
        repeated.header.stamp = stamp;
        Some(repeated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{Header, Pose2};

    const ROBOT: RobotId = RobotId::new(1).unwrap();

    fn ms(ms: u64) -> Monotonic {
        Monotonic(ms * 1_000_000)
    }

    fn pose_estimate(stamp_ms: i64, state: TrackingState) -> PoseEstimate {
        PoseEstimate {
            header: Header { stamp: Stamp(stamp_ms * 1_000_000), ..Header::default() },
            map_from_odom: Pose2::new(1.0, 2.0, 0.3),
            state: state as u32,
            ..PoseEstimate::default()
        }
    }

    fn repeater() -> PoseEstimateRepeater {
        let repetition = Repetition { tolerance: Duration::from_millis(200), hold: Duration::from_secs(1) };
        PoseEstimateRepeater::new(repetition, 1)
    }

    #[test]
    fn the_last_transform_is_repeated_with_newer_stamps_until_slam_is_silent_for_too_long() {
        let mut repeater = repeater();
        assert_eq!(repeater.take_due(ROBOT, ms(0)), None, "nothing is known yet");
        repeater.receive(ROBOT, &pose_estimate(5000, TrackingState::Tracking), ms(100));
        for (at, stamp_ms) in [(100, 5200), (120, 5220), (1100, 6200)] {
            let due = repeater.take_due(ROBOT, ms(at)).unwrap();
            assert_eq!(due.header.stamp, Stamp(stamp_ms * 1_000_000));
            assert_eq!(due.map_from_odom, Pose2::new(1.0, 2.0, 0.3), "repeated, not extrapolated");
        }
        assert_eq!(repeater.take_due(ROBOT, ms(1100)), None, "the same stamp is not sent twice");
        assert_eq!(repeater.take_due(ROBOT, ms(1101)), None, "SLAM has been silent for a second");
        assert_eq!(repeater.take_due(ROBOT, ms(1102)), None);
        repeater.receive(ROBOT, &pose_estimate(6100, TrackingState::Degenerate), ms(1200));
        assert!(repeater.take_due(ROBOT, ms(1200)).is_some());
    }

    #[test]
    fn nothing_is_sent_for_a_lost_robot() {
        let mut repeater = repeater();
        repeater.receive(ROBOT, &pose_estimate(5000, TrackingState::Tracking), ms(0));
        assert!(repeater.take_due(ROBOT, ms(0)).is_some());
        repeater.receive(ROBOT, &pose_estimate(5100, TrackingState::Lost), ms(100));
        assert_eq!(repeater.take_due(ROBOT, ms(110)), None);
    }
}
