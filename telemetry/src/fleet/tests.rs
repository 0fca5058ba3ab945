//! Messages of small fleets, and the statistics that must come of them.

use super::*;
use crate::MapMetrics;
use crate::testing::{house, within};
use msg::{GridView, MapTransform, RobotFrame, RobotFrameTransform, Role, TrackingState};

const MS: u64 = 1_000_000;

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

fn map_transforms(known: usize) -> MapTransforms {
    let mut map_transforms = MapTransforms::default();
    map_transforms.robots[..known].fill(MapTransform {
        map_from_robot_map: Pose2::IDENTITY,
        known: 1,
        map_frame: 0,
    });
    map_transforms
}

#[test]
fn a_state_that_slam_has_not_repeated_is_not_known() {
    let mut telemetry = Telemetry::new(1, &[], Monotonic(0));
    let mut state = |now_s: u64| {
        TrackingState::from_code(
            telemetry.compute_stats(Stamp(0), Monotonic(now_s * 1000 * MS)).robots[0].state,
        )
    };
    assert_eq!(state(100), Some(TrackingState::Starting));
    let pose_estimate = PoseEstimate { state: TrackingState::Tracking as u32, ..Default::default() };
    telemetry.add_pose_estimate(robot(1), &pose_estimate, Monotonic(100_000 * MS));
    let mut state = |now_s: u64| {
        TrackingState::from_code(
            telemetry.compute_stats(Stamp(0), Monotonic(now_s * 1000 * MS)).robots[0].state,
        )
    };
    for now_s in 100..200 {
        assert_eq!(state(now_s), (now_s <= 103).then_some(TrackingState::Tracking), "{now_s}");
    }
}

#[test]
fn the_statistics_of_one_robot_are_those_of_its_messages() {
    let start = Pose2::new(1.0, 0.5, 0.0);
    let mut telemetry = Telemetry::new(1, &[Some(start)], Monotonic(0));
    for n in 0..60_u64 {
        let stamp = Stamp((n * 100 * MS) as i64);
        let sent = Monotonic(1 << 40 | (n * 100 * MS));
        let header = Header { stamp, seq: n, incarnation: 3, ..Default::default() };
        let x_m = 0.01 * n as f64;
        telemetry.add_truth(
            robot(1),
            &GroundTruth { header, world_from_base: Pose2::new(1.0 + x_m, 0.5, 0.0), ..Default::default() },
        );
        let pose_estimate = PoseEstimate {
            header,
            scan_seq: n,
            scan_sent: sent,
            map_from_base: Pose2::new(x_m, 0.03, 0.0),
            state: TrackingState::Tracking as u32,
            nodes: 4,
            ..Default::default()
        };
        telemetry.add_pose_estimate(robot(1), &pose_estimate, Monotonic(sent.0 + 12 * MS));
        let mut transforms = Transforms { header, len: 1, ..Default::default() };
        transforms.transforms[0] =
            RobotFrameTransform { child_frame: RobotFrame::BaseFootprint as u32, ..Default::default() };
        telemetry.add_transforms(robot(1), &transforms, Monotonic(sent.0 + MS));
        telemetry.record_map_arrival(robot(1), sent, Monotonic(sent.0 + 40 * MS));
    }
    let mut metrics = MapMetrics::new(1, None, &[Some(start)]);
    metrics.update_map(robot(1), house().view());
    telemetry.set_map_figures(metrics.compute(), Monotonic(1));
    let stats = *telemetry.compute_stats(Stamp(5_950 * MS as i64), Monotonic(0));
    let figures = &stats.robots[0];
    within(figures.scan_hz, 10.0, 1e-9);
    assert_eq!((figures.scans, figures.scans_lost, figures.nodes), (60, 0, 4));
    within(figures.pose_error_m, 0.03, 1e-9);
    within(figures.scan_to_pose_ms.p50.into(), 12.0, 0.1);
    within(figures.scan_to_map_ms.p99.into(), 40.0, 0.4);
    assert_eq!((figures.tf_jitter_ms.count, figures.tf_jitter_ms.max), (20, 0.0));
    assert_eq!(figures.free_cells + figures.occupied_cells + figures.unknown_cells, 260 * 200);
    within(figures.coverage, f64::from(figures.free_cells + figures.occupied_cells) / 52_000.0, 1e-12);
    assert!(stats.consistency.is_nan() && stats.room_coverage.is_nan());
}

#[test]
fn the_figures_say_over_what_time_they_are_counted_and_whether_lost_scans_are_known() {
    let mut telemetry = Telemetry::new(1, &[], Monotonic(5_000 * MS));
    assert!(telemetry.compute_stats(Stamp(0), Monotonic(5_000 * MS)).maps_age_s.is_nan());
    telemetry.set_map_figures(MapMetrics::new(1, None, &[]).compute(), Monotonic(4_000 * MS));
    for (seconds, is_unknown) in [(5, 0), (12, 0), (90, 1)] {
        if is_unknown == 1 {
            telemetry.set_lost_scans_unknown();
        }
        let stats = telemetry.compute_stats(Stamp(0), Monotonic(seconds * 1_000 * MS));
        assert_eq!([stats.counted_s, stats.maps_age_s], [(seconds - 5) as f64, (seconds - 4) as f64]);
        assert_eq!(stats.robots[0].scans_lost_unknown, is_unknown);
    }
}

#[test]
fn a_map_from_before_a_restart_has_no_latency() {
    let mut telemetry = Telemetry::new(1, &[None], Monotonic(0));
    let arrive = |telemetry: &mut Telemetry, scan_sent: u64, received: u64| {
        telemetry.record_map_arrival(robot(1), Monotonic(scan_sent * MS), Monotonic(received * MS));
    };
    let answer = |telemetry: &mut Telemetry, incarnation: u64, scan_sent: u64| {
        let header = Header { incarnation, ..Default::default() };
        let pose_estimate =
            PoseEstimate { header, scan_sent: Monotonic(scan_sent * MS), ..Default::default() };
        telemetry.add_pose_estimate(robot(1), &pose_estimate, Monotonic((scan_sent + 5) * MS));
    };
    // Telemetry starts late and gets an old map.
    arrive(&mut telemetry, 1_000, 210_000);
    answer(&mut telemetry, 1, 210_000);
    arrive(&mut telemetry, 1_000, 210_010);
    arrive(&mut telemetry, 210_000, 210_040);
    answer(&mut telemetry, 1, 220_000);
    arrive(&mut telemetry, 220_000, 220_040);
    // SLAM is killed; its successor first sends the map that was saved.
    arrive(&mut telemetry, 215_000, 230_000);
    answer(&mut telemetry, 2, 230_100);
    arrive(&mut telemetry, 215_000, 230_110);
    arrive(&mut telemetry, 230_100, 230_140);
    let stats = telemetry.compute_stats(Stamp(0), Monotonic(0));
    let latency = stats.robots[0].scan_to_map_ms;
    assert_eq!(latency.count, 3);
    within(latency.max.into(), 40.0, 0.4);
}

#[test]
fn maps_are_compared_once_their_transforms_are_known() {
    let mut metrics = MapMetrics::new(3, Some(house()), &[Some(Pose2::IDENTITY), None]);
    for number in 1..=3 {
        metrics.update_map(robot(number), house().view());
    }
    metrics.update_map_transforms(&map_transforms(2));
    metrics.update_merged_map(house().view());
    let mut telemetry = Telemetry::new(3, &[Some(Pose2::IDENTITY), None], Monotonic(0));
    telemetry.set_map_figures(metrics.compute(), Monotonic(1));
    let stats = *telemetry.compute_stats(Stamp(0), Monotonic(0));
    assert_eq!((stats.robot_count, stats.pair_count), (3, 1));
    assert_eq!((stats.consistency, stats.occupied_f1, stats.room_coverage), (1.0, 1.0, 1.0));
    metrics.update_map_transforms(&map_transforms(3));
    telemetry.set_map_figures(metrics.compute(), Monotonic(1));
    assert_eq!(telemetry.compute_stats(Stamp(0), Monotonic(0)).pair_count, 3);
}

#[test]
fn unknown_robots_and_malformed_maps_change_nothing() {
    let mut telemetry = Telemetry::new(1, &[], Monotonic(0));
    let empty = *telemetry.compute_stats(Stamp(0), Monotonic(0));
    let mut metrics = MapMetrics::new(1, None, &[]);
    metrics.update_map(robot(2), house().view());
    let map = house();
    metrics.update_map(robot(1), GridView { header: &map.header, cells: &map.cells[1..] });
    metrics.update_merged_map(GridView { header: &map.header, cells: &[] });
    telemetry.set_map_figures(metrics.compute(), Monotonic(0));
    telemetry.record_map_arrival(robot(2), Monotonic(0), Monotonic(0));
    telemetry.add_pose_estimate(robot(9), &PoseEstimate::default(), Monotonic(0));
    telemetry.add_process_health(
        &ProcessHealth { role: Role::Sim as u32, robot: 5, ..Default::default() },
        Monotonic(0),
    );
    let after = *telemetry.compute_stats(Stamp(0), Monotonic(0));
    assert_eq!(format!("{empty:?}"), format!("{after:?}"));
}

#[test]
fn nothing_is_said_of_errors_in_a_frame_in_which_the_robot_did_not_begin() {
    let mut telemetry = Telemetry::new(2, &[Some(Pose2::IDENTITY); 2], Monotonic(0));
    telemetry.add_truth(robot(2), &GroundTruth::default());
    telemetry.add_pose_estimate(robot(2), &PoseEstimate::default(), Monotonic(0));
    let errors = |telemetry: &mut Telemetry, map_frame: u32| {
        let mut transforms = map_transforms(2);
        transforms.robots[1].map_frame = map_frame;
        telemetry.update_map_transforms(&transforms);
        let figures = telemetry.compute_stats(Stamp(0), Monotonic(0)).robots[1];
        [figures.pose_error_m, figures.map_transform_error_m]
    };
    assert_eq!(errors(&mut telemetry, 0), [0.0; 2]);
    assert!(errors(&mut telemetry, 1).iter().all(|error| error.is_nan()));
}
