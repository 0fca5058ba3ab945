//! What is wrong with a robot's data though each message is right: odometry that is missing or jumps, and a clock that is not ours.
//!
//! SLAM goes on with what it gets: without a word the operator would see a worse map, or transforms of another time.

use super::notices::{Notices, is_due};
use super::restart::Jump;
use msg::{RobotId, Stamp};

/// A robot that sends scans and no odometry for this long has none, seconds.
const ODOMETRY_SILENCE_S: f64 = 3.0;
/// Scans this far apart are not one series: what sends them was away, seconds.
const SCAN_SILENCE_S: f64 = 2.0;
/// Scans stamped so far from this machine's clock are told, seconds: networks are faster, and clocks that are kept by NTP nearer.
const CLOCK_ERROR_S: f64 = 1.0;
/// So many scans in a row must show it.
const CLOCK_SCANS: u32 = 10;
/// Jumps since they were told from which on they are not a driver that was started again.
const JUMPS_OF_TWO: u32 = 3;

/// Something that is told when it begins and when it ends, not more often than notices may come ([`is_due`]).
#[derive(Clone, Copy, Debug, Default)]
struct Reported {
    is_wrong: bool,
    at: Option<Stamp>,
}

impl Reported {
    /// Returns whether a change is to be told now.
    fn changes(&mut self, is_wrong: bool, now: Stamp) -> bool {
        let changes = self.is_wrong != is_wrong && is_due(self.at, now);
        if changes {
            *self = Self { is_wrong, at: Some(now) };
        }
        changes
    }
}

/// What is watched of one robot. Times are the run's, at which messages arrived.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SensorWatch {
    /// Beginning and newest of the present series of scans.
    scans: Option<(Stamp, Stamp)>,
    odometry: Option<Stamp>,
    odometry_reported: Reported,
    /// By how much the newest scan's stamp was ahead of its arrival, seconds.
    ahead_s: Option<f64>,
    /// Scans in a row whose stamps are wrong.
    wrong_stamps: u32,
    clock_reported: Reported,
    /// Jumps of odometry since they were told last.
    jumps: u32,
    jumps_reported: Option<Stamp>,
    /// Whether they were told as of two robots.
    is_again_reported: bool,
}

impl SensorWatch {
    /// Takes the arrival of a pose by odometry.
    pub(super) fn add_odometry(&mut self, received: Stamp) {
        self.odometry = Some(received);
    }

    /// Takes a scan that was accepted. `has_own_time`: the world has a clock of its own, as a simulation.
    pub(super) fn add_scan(
        &mut self,
        robot: RobotId,
        stamp: Stamp,
        received: Stamp,
        has_own_time: bool,
        notices: &mut Notices,
    ) {
        let goes_on = |newest: Stamp| (0.0..SCAN_SILENCE_S).contains(&(received - newest));
        let since = self.scans.filter(|(_, newest)| goes_on(*newest)).map_or(received, |(since, _)| since);
        self.scans = Some((since, received));
        let silence_s = received - self.odometry.map_or(since, |odometry| odometry.max(since));
        let is_missing = silence_s > ODOMETRY_SILENCE_S;
        if self.odometry_reported.changes(is_missing, received) {
            notices.push(match (is_missing, self.odometry) {
                (true, None) => format!(
                    "{robot}: scans come, but no odometry: SLAM goes by scans alone. Expected the transform odom -> base_footprint, or \
                     nav_msgs/Odometry on its odom topic"
                ),
                (true, Some(_)) => {
                    format!("{robot}: scans come, but odometry has ended: SLAM goes by scans alone")
                }
                (false, _) => format!("{robot}: odometry comes again"),
            });
        }
        self.watch_clock(robot, stamp - received, received, has_own_time, notices);
    }

    fn watch_clock(
        &mut self,
        robot: RobotId,
        ahead_s: f64,
        received: Stamp,
        has_own_time: bool,
        notices: &mut Notices,
    ) {
        self.ahead_s = Some(ahead_s);
        let is_wrong = !has_own_time && ahead_s.abs() > CLOCK_ERROR_S;
        self.wrong_stamps = if is_wrong { (self.wrong_stamps + 1).min(CLOCK_SCANS) } else { 0 };
        // A few late scans are no wrong clock, and a few right ones no right one.
        let is_known = !is_wrong || self.wrong_stamps == CLOCK_SCANS;
        if !is_known || !self.clock_reported.changes(is_wrong, received) {
            return;
        }
        notices.push(if !is_wrong {
            format!("{robot}: its scans are stamped by this machine's time again")
        } else if ahead_s > 0.0 {
            format!(
                "{robot}: its scans are stamped {ahead_s:.1} s ahead of this machine's clock, and so is its pose in /tf: tf2 finds \
                 no transform for this machine's time. Set the clocks of both machines, as by NTP"
            )
        } else {
            format!(
                "{robot}: its scans are stamped {:.1} s before they arrive, and so is its pose in /tf. Set the clocks of both machines, \
                 as by NTP, or look for what delays the scans",
                -ahead_s
            )
        });
    }

    /// Returns by how much a clock was set, seconds, if a scan is the first that is stamped by it.
    pub(super) fn clock_step_s(&self, stamp: Stamp, received: Stamp) -> Option<f64> {
        Some(stamp - received - self.ahead_s?)
    }

    /// Takes a jump of odometry. `begins_anew`: SLAM is told that a driver was started again, and does not take it for motion.
    pub(super) fn add_jump(
        &mut self,
        robot: RobotId,
        jump: &Jump,
        begins_anew: bool,
        received: Stamp,
        notices: &mut Notices,
    ) {
        self.jumps += 1;
        let is_again = self.jumps >= JUMPS_OF_TWO;
        if !is_due(self.jumps_reported, received) && (!is_again || self.is_again_reported) {
            return;
        }
        (self.jumps, self.jumps_reported, self.is_again_reported) = (0, Some(received), is_again);
        let again = if is_again {
            ", and that again and again: two robots, or two drivers, may send under one name"
        } else {
            ""
        };
        let how = if begins_anew {
            "it is taken as a driver that was started again, and not for motion"
        } else {
            "the scans tell SLAM whether it is motion"
        };
        notices.push(format!("{robot}: odometry {jump}{again}: {how}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROBOT: RobotId = RobotId::new(1).unwrap();

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// A robot whose scans come at 10 Hz, and what was told.
    #[derive(Default)]
    struct Robot {
        watch: SensorWatch,
        notices: Notices,
        now_s: f64,
    }

    impl Robot {
        /// Sends scans, and odometry if `has_odometry`, for some seconds.
        fn run(&mut self, seconds: f64, has_odometry: bool, ahead_s: f64, has_own_time: bool) -> Vec<String> {
            for _ in 0..(10.0 * seconds).round() as u32 {
                self.now_s += 0.1;
                if has_odometry {
                    self.watch.add_odometry(at(self.now_s));
                }
                let stamp = at(self.now_s + ahead_s);
                self.watch.add_scan(ROBOT, stamp, at(self.now_s), has_own_time, &mut self.notices);
            }
            std::iter::from_fn(|| self.notices.take()).collect()
        }
    }

    #[test]
    fn odometry_that_is_missing_is_told_when_it_ends_and_when_it_comes_again() {
        let mut robot = Robot::default();
        assert_eq!(robot.run(10.0, true, 0.0, false), [""; 0]);
        assert_eq!(robot.run(2.0, false, 0.0, false), [""; 0], "a short silence");
        assert!(robot.run(60.0, false, 0.0, false).concat().contains("odometry has ended"));
        assert_eq!(robot.run(60.0, true, 0.0, false), ["robot1: odometry comes again"]);
        let mut robot = Robot::default();
        assert!(robot.run(60.0, false, 0.0, false).concat().contains("but no odometry"));
    }

    #[test]
    fn odometry_that_comes_and_goes_is_not_told_each_time() {
        let mut robot = Robot::default();
        let reported: usize = (0..30).map(|turn| robot.run(4.0, turn % 2 == 0, 0.0, false).len()).sum();
        assert!((1..=5).contains(&reported), "{reported} in 120 s");
    }

    #[test]
    fn scans_that_come_after_a_pause_wait_for_odometry() {
        let mut robot = Robot::default();
        robot.run(10.0, true, 0.0, false);
        robot.now_s += 100.0;
        assert_eq!(robot.run(2.0, false, 0.0, false), [""; 0]);
    }

    #[test]
    fn a_clock_that_differs_is_told_unless_the_world_has_its_own() {
        for ahead_s in [300.0, -300.0, 1.2] {
            let mut robot = Robot::default();
            let reported = robot.run(60.0, true, ahead_s, false).concat();
            let part = if ahead_s > 0.0 { "ahead of this machine's clock" } else { "before they arrive" };
            assert!(
                reported.contains(part) && reported.contains(&format!("{:.1} s", ahead_s.abs())),
                "{reported}"
            );
            assert!(robot.run(60.0, true, 0.01, false).concat().contains("again"));
            assert_eq!(Robot::default().run(60.0, true, ahead_s, true), [""; 0]);
        }
        let mut robot = Robot::default();
        robot.run(10.0, true, 0.05, false);
        assert_eq!(robot.run(0.5, true, -3.0, false), [""; 0], "a network that stalls");
        assert_eq!(robot.watch.clock_step_s(at(50.0), at(40.0)).map(f64::round), Some(13.0));
    }

    #[test]
    fn jumps_are_told_once_and_many_of_them_as_two_robots() {
        let mut watch = SensorWatch::default();
        let mut notices = Notices::default();
        let jump = Jump { distance_m: 3.0, turn_rad: 0.1, span_s: 0.05 };
        for tenth in 0..600 {
            watch.add_jump(ROBOT, &jump, true, at(f64::from(tenth) * 0.1), &mut notices);
        }
        let reported: Vec<String> = std::iter::from_fn(|| notices.take()).collect();
        assert!(
            reported[0].contains("jumps 3.00 m and 6 degrees in 0.050 s: it is taken as a driver"),
            "{reported:?}"
        );
        assert!(reported[1..].iter().all(|reported| reported.contains("again and again")), "{reported:?}");
        assert!((2..=4).contains(&reported.len()), "{reported:?}");
    }
}
