//! Two robots in one house, whose maps drift deforms, and messages that must be rejected.

use super::*;
use msg::grid::{OCCUPIED_MIN, UNKNOWN};
use msg::{EdgeState, GridHeader, GridView, Message, SubmapEdge};
use nalgebra::Matrix3;

mod frame;
mod new_run;
mod starts;

/// Whether a cell of 0.05 m is an obstacle: a house of 30 m x 12 m whose rooms and furniture tell places apart.
fn is_obstacle(x: i64, y: i64) -> bool {
    let outer = x == 0 || x == 599 || y == 0 || y == 239;
    let inner = [(97, 60..84), (214, 150..180), (301, 40..70), (421, 170..196), (505, 20..50)];
    let wall = inner.iter().any(|(at, door)| (*at..*at + 2).contains(&x) && !door.contains(&y));
    // Boxes of many sizes, in a fixed pattern.
    let (i, j) = (x.div_euclid(40), y.div_euclid(40));
    let mix = (i * 7919 + j * 104_729 + i * j * 31).rem_euclid(1009);
    let (left, low, wide, high) = (4 + mix % 17, 3 + mix % 19, 5 + mix % 13, 4 + mix % 11);
    let (u, v) = (x.rem_euclid(40), y.rem_euclid(40));
    let edge = u == left || u == left + wide || v == low || v == low + high;
    let inside = (left..=left + wide).contains(&u) && (low..=low + high).contains(&v);
    outer || wall || (mix % 3 != 0 && edge && inside)
}

/// Submap that a robot draws at a true pose: the 8 m x 8 m around it.
fn draw_submap(world_from_submap: Pose2) -> Grid {
    let header = GridHeader {
        resolution_m: 0.05,
        width: 160,
        height: 160,
        origin: Pose2::new(-4.0, -4.0, 0.0),
        ..Default::default()
    };
    let mut grid = Grid { header, cells: vec![UNKNOWN; 160 * 160] };
    for y in 0..160 {
        for x in 0..160 {
            let [u, v] = world_from_submap.apply(grid.view().centre_m(x, y));
            let (i, j) = ((u / 0.05).floor() as i64, (v / 0.05).floor() as i64);
            if (0..600).contains(&i) && (0..240).contains(&j) {
                grid.cells[(y * 160 + x) as usize] = if is_obstacle(i, j) { OCCUPIED_MIN + 20 } else { -60 };
            }
        }
    }
    grid
}

/// A robot's true path along the house, a submap each 2 m.
fn true_path(from_x_m: f64, to_x_m: f64, y_m: f64) -> Vec<Pose2> {
    let count = ((to_x_m - from_x_m).abs() / 2.0) as usize;
    let step = (to_x_m - from_x_m) / count as f64;
    let yaw = if step < 0.0 { core::f64::consts::PI } else { 0.0 };
    (0..=count).map(|k| Pose2::new(from_x_m + k as f64 * step, y_m, yaw)).collect()
}

/// The path as the robot's SLAM estimates it: from its own origin, with a constant error of the heading at each step.
fn drifted_path(true_path: &[Pose2], rad_per_step: f64) -> Vec<Pose2> {
    let mut estimated = vec![Pose2::IDENTITY];
    for pair in true_path.windows(2) {
        let step = pair[0].between(pair[1]) * Pose2::new(0.0, 0.0, rad_per_step);
        estimated.push(estimated[estimated.len() - 1] * step);
    }
    estimated
}

/// Sends all of a robot's submaps and poses as its SLAM would, and does the work that comes of each.
fn send(
    fleet: &mut FleetPoseGraph,
    robot: usize,
    true_path: &[Pose2],
    estimated: &[Pose2],
    incarnation: u64,
) {
    send_of(fleet, robot, true_path, estimated, (0, incarnation));
}

/// Sends the submaps of a run of the robot's machine and an incarnation of its SLAM.
fn send_of(
    fleet: &mut FleetPoseGraph,
    robot: usize,
    true_path: &[Pose2],
    estimated: &[Pose2],
    (run, incarnation): (u32, u64),
) {
    let robot = RobotId::new(robot).unwrap();
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
    for (id, pose) in true_path.iter().enumerate() {
        submap.set_grid(draw_submap(*pose).view());
        (submap.id, submap.nodes, submap.finished) = (id as u32, 10, 1);
        submap.header_mut().incarnation = incarnation;
        poses.robot_map_from_submap[id] = estimated[id];
        if let Some(before) = id.checked_sub(1) {
            let (m, rad) = (1.0 / (0.03 * 0.03), 1.0 / (0.02 * 0.02));
            let information = [m, 0.0, 0.0, m, 0.0, rad];
            poses.edges[before] = SubmapEdge { a: before as u32, b: id as u32, information };
        }
        (poses.len, poses.edges_len) = (id as u32 + 1, id as u32);
        (poses.map_frame, poses.header.incarnation) = (run, incarnation);
        fleet.update_poses(robot, &poses).unwrap();
        fleet.add_submap(robot, &submap).unwrap();
        work(fleet);
    }
}

fn work(fleet: &mut FleetPoseGraph) {
    for _ in 0..2_000 {
        let Some(task) = fleet.next_task() else { return };
        fleet.apply_result(task.run());
    }
    panic!("the graph has work without end");
}

fn edge(fleet: &FleetPoseGraph) -> msg::MergeEdge {
    let mut edges = MergeEdges::default();
    fleet.write_edges(&mut edges);
    edges.edges()[0]
}

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

/// A fleet of two robots of unknown starts that are connected after these paths.
fn connected_fleet(paths: &[Vec<Pose2>; 2], estimated: &[Vec<Pose2>; 2]) -> FleetPoseGraph {
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &[None, None]);
    send(&mut fleet, 1, &paths[0], &estimated[0], 1);
    send(&mut fleet, 2, &paths[1], &estimated[1], 1);
    fleet.finish();
    work(&mut fleet);
    assert_eq!(edge(&fleet).state(), EdgeState::Accepted, "{:?}", edge(&fleet));
    fleet
}

/// Paths from both ends of the house, and their estimates, of which the second one drifts.
fn one_drifting() -> ([Vec<Pose2>; 2], [Vec<Pose2>; 2]) {
    let paths = [true_path(4.0, 26.0, 5.0), true_path(26.0, 4.0, 7.0)];
    let estimated = [drifted_path(&paths[0], 0.0), drifted_path(&paths[1], 0.012)];
    (paths, estimated)
}

/// Mean and largest error of robot 2's submaps, metres, in the frame in which robot 1 begins.
fn errors(fleet: &FleetPoseGraph, paths: [&[Pose2]; 2], estimated: &[Pose2]) -> [f64; 2] {
    let off = (0..estimated.len()).map(|id| {
        let here = fleet.map_from_robot_map_at(robot(2), id as u32).unwrap() * estimated[id];
        here.distance_m(paths[0][0].between(paths[1][id]))
    });
    let off: Vec<f64> = off.collect();
    [off.iter().sum::<f64>() / off.len() as f64, off.iter().fold(0.0, |most, m| most.max(*m))]
}

#[test]
fn the_joint_graph_is_better_than_any_rigid_transform_of_a_deformed_map() {
    let (paths, estimated) = one_drifting();
    let (fleet, drifted) = (connected_fleet(&paths, &estimated), &estimated[1]);
    let found = edge(&fleet);
    assert!(found.closures >= 5 && found.occupied_f1 > found.null_f1_max + 0.3, "{found:?}");
    assert!(fleet.redrawn_map(robot(2)).is_some());
    let [mean_m, most_m] = errors(&fleet, [&paths[0], &paths[1]], drifted);
    // The best that a rigid transform can do: right at one submap, whichever is best.
    let rigid = (0..drifted.len()).map(|fixed| {
        let transform = paths[0][0].between(paths[1][fixed]) * drifted[fixed].inverse();
        let off = |id: usize| (transform * drifted[id]).distance_m(paths[0][0].between(paths[1][id]));
        (0..drifted.len()).map(off).sum::<f64>() / drifted.len() as f64
    });
    let rigid_m = rigid.fold(f64::INFINITY, f64::min);
    assert!(mean_m < 0.02 && most_m < 0.05 && mean_m < 0.15 * rigid_m, "{mean_m} {most_m}, rigid {rigid_m}");
}

#[test]
fn wrong_closures_are_not_in_force() {
    let (paths, estimated) = one_drifting();
    let (mut fleet, drifted) = (connected_fleet(&paths, &estimated), &estimated[1]);
    let right = fleet.pairs[0].closures.found().to_vec();
    let [before_m, _] = errors(&fleet, [&paths[0], &paths[1]], drifted);
    // A third as many wrong ones, off by what a search window allows, each in another direction.
    for (k, closure) in right.iter().enumerate().step_by(3) {
        let mut wrong = *closure;
        let (sin, cos) = (1.7 * k as f64).sin_cos();
        wrong.measured.i_from_j = wrong.measured.i_from_j * Pose2::new(0.7 * cos, 0.7 * sin, 0.1 * sin);
        fleet.pairs[0].closures.push(wrong);
    }
    fleet.needs_solve = true;
    work(&mut fleet);
    let active = fleet.pairs[0].closures.active();
    assert!(active.iter().all(|k| *k < right.len()), "{active:?} of {}", right.len());
    assert!(active.len() * 10 >= right.len() * 9, "{active:?} of {}", right.len());
    let [after_m, _] = errors(&fleet, [&paths[0], &paths[1]], drifted);
    assert!(after_m < before_m + 0.01, "{after_m} m with them, {before_m} m without");
}

#[test]
fn a_failed_solution_changes_nothing_and_is_reported() {
    let (mut fleet, ..) = two_connected_robots();
    let transforms = [1, 2].map(|k| fleet.map_from_robot_map(robot(k)));
    let (before, solved) = (edge(&fleet), fleet.solve_count());
    let mut broken = fleet.pairs[0].closures.found()[0];
    broken.measured.information = Matrix3::from_element(f64::NAN);
    fleet.pairs[0].closures.push(broken);
    fleet.needs_solve = true;
    let outcome = fleet.next_task().unwrap().run();
    assert!(outcome.solve_error().is_some());
    fleet.apply_result(outcome);
    assert_eq!((fleet.solve_count(), fleet.failed_solve_count()), (solved, 1));
    assert_eq!([1, 2].map(|k| fleet.map_from_robot_map(robot(k))), transforms);
    assert_eq!((edge(&fleet).a_from_b, edge(&fleet).closures), (before.a_from_b, before.closures));
    // The same graph is not tried again and again.
    work(&mut fleet);
    assert_eq!(fleet.failed_solve_count(), 1);
}

#[test]
fn a_rejected_edge_stays_out_and_a_pinned_one_comes_back() {
    let (mut fleet, ..) = two_connected_robots();
    let place = fleet.map_from_robot_map(robot(2)).unwrap();
    assert!(fleet.apply_command(1, EdgeAction::Undo));
    fleet.finish();
    work(&mut fleet);
    assert_eq!((edge(&fleet).state(), fleet.map_from_robot_map(robot(2))), (EdgeState::Undone, None));
    assert_eq!(fleet.map_from_robot_map(robot(1)), Some(Pose2::IDENTITY));
    assert!(fleet.apply_command(1, EdgeAction::Pin));
    work(&mut fleet);
    assert_eq!(edge(&fleet).state(), EdgeState::Pinned);
    assert!(fleet.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
    assert!(fleet.apply_command(1, EdgeAction::Unpin) && !fleet.apply_command(1, EdgeAction::Unpin));
    assert_eq!(edge(&fleet).state(), EdgeState::Accepted);
    assert!(!fleet.apply_command(0, EdgeAction::Undo) && !fleet.apply_command(2, EdgeAction::Undo));
}

#[test]
fn a_restarted_robot_keeps_its_place_and_one_that_leaves_does_not_move_the_frame() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    let place = fleet.map_from_robot_map(robot(2)).unwrap();
    send(&mut fleet, 2, &paths[1][..2], &estimated[1][..2], 2);
    assert!(fleet.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
    // Its SLAM has forgotten nodes: the same incarnation, new submaps under the old ids, of which none has arrived.
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.len, poses.generation, poses.header.incarnation) = (1, 1, 2);
    fleet.update_poses(robot(2), &poses).unwrap();
    assert_eq!([1, 2].map(|k| fleet.missing_submaps(robot(k))), [0, 1]);
    assert!(fleet.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
    fleet.remove_robot(robot(1));
    work(&mut fleet);
    assert_eq!(fleet.map_from_robot_map(robot(1)), None);
    assert!(fleet.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
}

#[test]
fn unknown_robots_and_malformed_messages_are_rejected() {
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &[None]);
    let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
    assert_eq!(fleet.add_submap(robot(2), &submap), Err(SubmapRejected::UnknownRobot(robot(2))));
    assert_eq!(fleet.add_submap(robot(1), &submap), Err(SubmapRejected::Malformed(robot(1))));
    let header = GridHeader { resolution_m: 0.05, width: 2, height: 2, ..Default::default() };
    submap.set_grid(GridView { header: &header, cells: &[1; 4] });
    submap.grid.origin.x_m = f64::NAN;
    assert_eq!(fleet.add_submap(robot(1), &submap), Err(SubmapRejected::Malformed(robot(1))));
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.len, poses.robot_map_from_submap[0].x_m) = (1, f64::INFINITY);
    assert_eq!(fleet.update_poses(robot(1), &poses), Err(SubmapRejected::Malformed(robot(1))));
}

/// Two connected robots, their paths and the estimates of these.
fn two_connected_robots() -> (FleetPoseGraph, [Vec<Pose2>; 2], [Vec<Pose2>; 2]) {
    let paths = [true_path(4.0, 16.0, 5.0), true_path(18.0, 6.0, 6.0)];
    let estimated = [drifted_path(&paths[0], 0.0), drifted_path(&paths[1], 0.0)];
    (connected_fleet(&paths, &estimated), paths, estimated)
}

fn restored(snapshot: &FleetSnapshot) -> FleetPoseGraph {
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &[None, None]);
    fleet.restore(snapshot).unwrap();
    fleet
}

#[test]
fn a_restored_fleet_has_its_places_before_any_closure_is_found_again() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    assert!(fleet.apply_command(1, EdgeAction::Pin));
    work(&mut fleet);
    let snapshot = fleet.snapshot();
    let mut again = restored(&snapshot);
    assert_eq!(again.snapshot(), snapshot);
    for k in [1, 2] {
        assert_eq!(again.map_from_robot_map(robot(k)), fleet.map_from_robot_map(robot(k)));
    }
    let (before, now) = (edge(&fleet), edge(&again));
    assert_eq!((now.state(), now.a_from_b), (EdgeState::Pinned, before.a_from_b));
    assert_eq!(
        (now.occupied_f1, now.null_f1_max, now.inliers),
        (before.occupied_f1, before.null_f1_max, before.inliers)
    );
    // Robot 2's submaps come first: the frame stays robot 1's, and no robot moves.
    let place = fleet.map_from_robot_map(robot(2)).unwrap();
    send(&mut again, 2, &paths[1], &estimated[1], 1);
    assert_eq!(again.map_from_robot_map(robot(1)), Some(Pose2::IDENTITY));
    assert!(again.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
    send(&mut again, 1, &paths[0], &estimated[0], 1);
    again.finish();
    work(&mut again);
    assert_eq!(edge(&again).state(), EdgeState::Pinned);
    assert!(edge(&again).closures >= 3, "closures are found again: {:?}", edge(&again));
    assert!(again.map_from_robot_map(robot(1)).unwrap().distance_m(Pose2::IDENTITY) < 0.01);
    assert!(again.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
}

#[test]
fn a_restored_fleet_does_not_accept_a_rejected_alignment() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    assert!(fleet.apply_command(1, EdgeAction::Undo));
    work(&mut fleet);
    let mut again = restored(&fleet.snapshot());
    assert_eq!((edge(&again).state(), again.map_from_robot_map(robot(2))), (EdgeState::Undone, None));
    send(&mut again, 1, &paths[0], &estimated[0], 1);
    send(&mut again, 2, &paths[1], &estimated[1], 1);
    again.finish();
    work(&mut again);
    assert_eq!((edge(&again).state(), again.map_from_robot_map(robot(2))), (EdgeState::Undone, None));
    // Without the snapshot it does.
    assert_eq!(edge(&two_connected_robots().0).state(), EdgeState::Accepted);
}

#[test]
fn the_frame_of_a_robot_that_left_is_restored() {
    let (mut fleet, _, _) = two_connected_robots();
    let place = fleet.map_from_robot_map(robot(2));
    fleet.remove_robot(robot(1));
    work(&mut fleet);
    let again = restored(&fleet.snapshot());
    assert_eq!((again.map_from_robot_map(robot(1)), again.map_from_robot_map(robot(2))), (None, place));
}

#[test]
fn candidates_and_unconnected_robots_are_not_restored() {
    let (mut fleet, _, _) = two_connected_robots();
    fleet.pairs[0].edge.deactivate(EdgeState::Candidate);
    let again = restored(&fleet.snapshot());
    assert_eq!(edge(&again).state(), EdgeState::None);
    // Only the reference robot keeps its place.
    assert_eq!(
        (again.map_from_robot_map(robot(1)), again.map_from_robot_map(robot(2))),
        (Some(Pose2::IDENTITY), None)
    );
}

#[test]
fn a_dropped_edge_is_not_accepted_again_on_the_same_evidence() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    let nodes = fleet.robots.iter().map(|robot| robot.submaps.node_count()).sum();
    fleet.pairs[0].drop_edge(nodes);
    fleet.graph_changed();
    fleet.finish();
    work(&mut fleet);
    let dropped = edge(&fleet);
    assert_eq!((dropped.state(), fleet.map_from_robot_map(robot(2))), (EdgeState::Dropped, None));
    assert_eq!(dropped.closures, 0, "closures of the dropped edge are active: {dropped:?}");
    // More of the map is new evidence, by which the place is found again.
    let longer = true_path(18.0, 2.0, 6.0).into_iter().chain(true_path(2.0, 12.0, 8.0)).collect::<Vec<_>>();
    send(&mut fleet, 2, &longer, &drifted_path(&longer, 0.0), 1);
    fleet.finish();
    work(&mut fleet);
    let found = edge(&fleet);
    assert_eq!(found.state(), EdgeState::Accepted);
    assert!(found.a_from_b.distance_m(paths[0][0].between(paths[1][0])) < 0.1, "{found:?} {estimated:?}");
}

#[test]
fn a_bent_map_says_that_submaps_contradict_the_other() {
    let paths = [true_path(4.0, 26.0, 5.0), true_path(4.0, 26.0, 7.0)];
    let mut estimated = [drifted_path(&paths[0], 0.0), drifted_path(&paths[1], 0.0)];
    let straight = connected_fleet(&paths, &estimated);
    assert_eq!(edge(&straight).contradicted_submaps, 0, "{:?}", edge(&straight));
    assert!(edge(&straight).compared_submaps > 10, "{:?}", edge(&straight));
    // Half way the second robot's SLAM errs by 20 degrees.
    let bend = paths[1].len() / 2;
    for id in bend + 1..paths[1].len() {
        let from_bend = estimated[1][bend].between(estimated[1][id]);
        estimated[1][id] = estimated[1][bend] * Pose2::new(0.0, 0.0, 0.35) * from_bend;
    }
    let bent = connected_fleet(&paths, &estimated);
    let [_, most_m] = errors(&bent, [&paths[0], &paths[1]], &estimated[1]);
    assert!(most_m > 1.0 && edge(&bent).is_contradicted(), "{most_m} m, {:?}", edge(&bent));
}
