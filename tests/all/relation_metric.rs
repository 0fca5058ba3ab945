//! The accuracy that `benches/slam` prints is the relation metric: on trajectories made by hand.

#[allow(dead_code, reason = "shared with the slam bench, which uses more of it")]
#[path = "../../benches/slam/relations.rs"]
mod relations;

use msg::Pose2;
use relations::{Relation, Trajectory, Which, errors, parse};

/// One scan a second along x, a metre each, turning 0.1 rad each; from 40 s on shifted to the left.
fn estimate(shift_m: f64) -> Trajectory {
    let pose = |i: u32| {
        let s = f64::from(i);
        (s, Pose2::new(s, if i >= 40 { shift_m } else { 0.0 }, 0.1 * s))
    };
    Trajectory::new((0..60).map(pose).collect())
}

fn relation(from_s: f64, to_s: f64) -> Relation {
    let pose = |s: f64| Pose2::new(s, 0.0, 0.1 * s);
    let Pose2 { x_m, y_m, yaw_rad } = pose(from_s).between(pose(to_s));
    let line = format!("# a comment\n{from_s} {to_s} {x_m} {y_m} 0 0 0 {yaw_rad}\n");
    parse(&line).unwrap().remove(0)
}

#[test]
fn a_shift_causes_errors_only_in_relations_across_it() {
    let relations = [relation(1.0, 2.0), relation(3.0, 45.0), relation(41.0, 55.0)];
    let all = errors(&estimate(0.3), None, &relations, Which::All);
    assert_eq!(all.count, 3);
    assert!((all.mean_m - 0.1).abs() < 1e-9 && (all.max_m - 0.3).abs() < 1e-9, "{all:?}");
    assert!(all.mean_deg < 1e-9, "{all:?}");
    let revisits = errors(&estimate(0.3), None, &relations, Which::Revisits);
    assert!(revisits.count == 1 && (revisits.mean_m - 0.3).abs() < 1e-9, "{revisits:?}");
}

#[test]
fn stamps_between_scans_are_interpolated_or_left_out() {
    let between = [relation(1.0, 2.4)];
    assert_eq!(errors(&estimate(0.0), None, &between, Which::BothKept).count, 0);
    let interpolated = errors(&estimate(0.0), None, &between, Which::All);
    assert!(interpolated.count == 1 && interpolated.mean_m < 1e-9, "{interpolated:?}");
    // Odometry in a frame of its own, ten times as dense.
    let elsewhere = Pose2::new(5.0, -2.0, 1.0);
    let line = |s: f64| {
        let Pose2 { x_m, y_m, yaw_rad } = elsewhere * Pose2::new(s, 0.0, 0.1 * s);
        format!("{s} {x_m} {y_m} {yaw_rad}\n")
    };
    let dense: String = (0..600).map(|i| line(f64::from(i) * 0.1)).collect();
    let dense = Trajectory::parse(&dense).unwrap();
    let by_odometry = errors(&estimate(0.0), Some(&dense), &between, Which::All);
    assert!(by_odometry.count == 1 && by_odometry.mean_m < 1e-9, "{by_odometry:?}");
    assert_eq!(errors(&estimate(0.0), None, &[relation(1.0, 70.0)], Which::All).count, 0);
}

#[test]
fn a_malformed_line_is_reported_with_its_number() {
    let error = parse("1 2 0 0 0 0 0 0\n1 2 x 0 0 0 0 0\n").err().unwrap();
    assert!(error.contains("line 2") && error.contains("t1 t2"), "{error}");
}
