//! Pose estimates while odometry is missing: no transform of `odom` is made up, and a known one does not jump.

mod common;

use common::{FULL, Noise, Robot, cast, laboratory};
use msg::{Odometry, Pose2, PoseEstimate, Scan};
use proptest::prelude::*;
use slam::{Slam, SlamConfig};

/// Odometry's pose at a scan, if it was given, and SLAM's answer.
type Answer = (Option<Pose2>, PoseEstimate);

/// Drives a circle, 10 scans a second. `has_odometry` and `is_refused` say, for each scan, whether odometry comes with
/// it and whether its geometry is nonsense.
fn drive(
    scans: usize,
    has_odometry: impl Fn(usize) -> bool,
    is_refused: impl Fn(usize) -> bool,
) -> Vec<Answer> {
    let (walls, mut noise) = (laboratory(), Noise::new(5));
    let mut robot = Robot::new(Pose2::new(0.0, -0.5, 0.3));
    let mut slam = Slam::new(SlamConfig::default());
    let mut answers = Vec::new();
    for k in 0..scans {
        let odometry: Option<Odometry> =
            has_odometry(k).then(|| Odometry { linear_m_s: 0.2, angular_rad_s: 0.5, ..robot.odometry() });
        odometry.iter().for_each(|odometry| slam.add_odometry(odometry));
        let mut scan: Box<Scan> = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        if is_refused(k) {
            scan.range_max_m = f32::NAN;
        }
        let answer = slam.process(&scan);
        assert_eq!(answer.rejected.is_some(), is_refused(k));
        slam.work();
        answers.push((odometry.map(|odometry| odometry.odom_from_base), answer.pose_estimate));
        robot.drive(0.2, 0.5, 0.1, &mut noise);
    }
    answers
}

/// Largest step of a transform from one answer to the next, metres at 2 m from its origin.
fn steps_m(answers: &[Answer]) -> impl Iterator<Item = f64> + '_ {
    let far = |pose: Pose2| pose.apply([2.0, 0.0]);
    answers.windows(2).filter_map(move |pair| {
        let [a, b] = [far(pair[0].1.map_from_odom()?), far(pair[1].1.map_from_odom()?)];
        Some((a[0] - b[0]).hypot(a[1] - b[1]))
    })
}

#[test]
fn a_gap_of_odometry_does_not_move_odom() {
    // 0.8 s without odometry, which is extrapolated for the first 0.3 s; twice.
    let gap = |k: usize| !(30..38).contains(&k) && !(60..68).contains(&k);
    let answers = drive(90, gap, |_| false);
    let largest = steps_m(&answers).fold(0.0, f64::max);
    assert!(largest < 0.15, "a step of {largest:.3} m");
    assert!(answers.iter().all(|(_, pose_estimate)| pose_estimate.map_from_odom().is_some()));
    // Once it cannot be extrapolated, the transform stays as it was.
    assert!(answers[34..38].windows(2).all(|pair| pair[0].1.map_from_odom == pair[1].1.map_from_odom));
}

#[test]
fn without_odometry_odom_lies_nowhere() {
    let answers = drive(40, |_| false, |_| false);
    for (_, pose_estimate) in &answers {
        assert_eq!(pose_estimate.map_from_odom(), None);
    }
    // The robot's own pose is known all the same.
    assert!(answers[39].1.map_from_base.distance_m(Pose2::IDENTITY) > 0.2);
}

#[test]
fn a_refused_first_scan_tells_no_pose() {
    let answers = drive(4, |k| k > 1, |k| k < 2);
    for (_, pose_estimate) in &answers[..2] {
        assert_eq!(pose_estimate.map_from_odom(), None);
        assert!(pose_estimate.covariance[0] > 1000.0, "{:?}", pose_estimate.covariance);
    }
    assert!(answers[3].1.map_from_odom().is_some());
}

#[test]
fn a_robot_that_is_looked_for_keeps_its_odom() {
    let (walls, mut noise) = (laboratory(), Noise::new(5));
    let mut robot = Robot::new(Pose2::new(0.0, -0.5, 0.3));
    let (mut front, _) = Slam::new(SlamConfig::default()).split();
    let mut known = None;
    for k in 0..20 {
        front.add_odometry(&robot.odometry());
        let scan = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
        let pose_estimate = front.process(&scan).pose_estimate;
        if k == 10 {
            known = pose_estimate.map_from_odom();
            front.set_map_from_local(None);
        } else if k > 10 {
            assert_eq!(pose_estimate.map_from_odom(), known);
        }
        robot.drive(0.2, 0.5, 0.1, &mut noise);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Wherever odometry is given, `map_from_odom * odom_from_base` is the pose in the map; wherever it is missing, the
    /// transform does not jump.
    #[test]
    fn odom_is_where_the_pose_says(
        missing in prop::collection::vec(prop::bool::weighted(0.4), 40),
        refused in prop::collection::vec(prop::bool::weighted(0.2), 40),
    ) {
        let answers = drive(40, |k| !missing[k], |k| refused[k]);
        for (k, (odom_from_base, pose_estimate)) in answers.iter().enumerate() {
            let (Some(odom_from_base), false) = (odom_from_base, refused[k]) else { continue };
            let map_from_odom = pose_estimate.map_from_odom().expect("odometry is known");
            let error_m = (map_from_odom * *odom_from_base).distance_m(pose_estimate.map_from_base);
            prop_assert!(error_m < 1e-9, "scan {k}: {error_m} m");
        }
        let largest = steps_m(&answers).fold(0.0, f64::max);
        prop_assert!(largest < 0.2, "a step of {largest:.3} m");
    }
}
