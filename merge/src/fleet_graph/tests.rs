use super::*;
use msg::grid::{OCCUPIED_MIN, UNKNOWN};
use msg::{GridHeader, GridView, Message, SubmapEdge};

/// A house of 30 m x 12 m with rooms and furniture that tell places apart, in cells of 0.05 m.
fn stands(x: i64, y: i64) -> bool {
    let outer = x == 0 || x == 599 || y == 0 || y == 239;
    let inner = [(97, 60..84), (214, 150..180), (301, 40..70), (421, 170..196), (505, 20..50)];
    let wall = inner.iter().any(|(at, door)| (*at..*at + 2).contains(&x) && !door.contains(&y));
    // Boxes of many sizes, the same for everybody.
    let (i, j) = (x.div_euclid(40), y.div_euclid(40));
    let mix = (i * 7919 + j * 104_729 + i * j * 31).rem_euclid(1009);
    let (left, low, wide, high) = (4 + mix % 17, 3 + mix % 19, 5 + mix % 13, 4 + mix % 11);
    let (u, v) = (x.rem_euclid(40), y.rem_euclid(40));
    let edge = u == left || u == left + wide || v == low || v == low + high;
    let inside = (left..=left + wide).contains(&u) && (low..=low + high).contains(&v);
    outer || wall || (mix % 3 != 0 && edge && inside)
}

/// What a robot that stands at a true pose draws: 8 m around it.
fn look(world_from_submap: Pose2) -> Grid {
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
                grid.cells[(y * 160 + x) as usize] = if stands(i, j) { OCCUPIED_MIN + 20 } else { -60 };
            }
        }
    }
    grid
}

/// A robot's true way: along the house, a submap each 2 m.
fn way(from_x_m: f64, to_x_m: f64, y_m: f64) -> Vec<Pose2> {
    let count = ((to_x_m - from_x_m).abs() / 2.0) as usize;
    let step = (to_x_m - from_x_m) / count as f64;
    let yaw = if step < 0.0 { core::f64::consts::PI } else { 0.0 };
    (0..=count).map(|k| Pose2::new(from_x_m + k as f64 * step, y_m, yaw)).collect()
}

/// What the robot believes of its way: it begins at its own origin and turns a little more than it
/// should with each step.
fn bent(true_way: &[Pose2], rad_per_step: f64) -> Vec<Pose2> {
    let mut believed = vec![Pose2::IDENTITY];
    for pair in true_way.windows(2) {
        let step = pair[0].between(pair[1]) * Pose2::new(0.0, 0.0, rad_per_step);
        believed.push(believed[believed.len() - 1] * step);
    }
    believed
}

/// All of a robot's submaps and poses as its SLAM sends them.
fn send(fleet: &mut FleetPoseGraph, robot: usize, true_way: &[Pose2], believed: &[Pose2], run: u64) {
    let robot = RobotId::new(robot).unwrap();
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
    for (id, pose) in true_way.iter().enumerate() {
        submap.set_grid(look(*pose).view());
        (submap.id, submap.nodes, submap.finished) = (id as u32, 10, 1);
        submap.header_mut().incarnation = run;
        poses.robot_map_from_submap[id] = believed[id];
        if let Some(before) = id.checked_sub(1) {
            let (m, rad) = (1.0 / (0.03 * 0.03), 1.0 / (0.02 * 0.02));
            let information = [m, 0.0, 0.0, m, 0.0, rad];
            poses.edges[before] = SubmapEdge { a: before as u32, b: id as u32, information };
        }
        (poses.len, poses.edges_len) = (id as u32 + 1, id as u32);
        poses.header.incarnation = run;
        fleet.update_poses(robot, &poses).unwrap();
        fleet.add_submap(robot, &submap).unwrap();
        work(fleet);
    }
}

fn work(fleet: &mut FleetPoseGraph) {
    for _ in 0..2_000 {
        let Some(task) = fleet.next_task() else { return };
        fleet.apply_outcome(task.run());
    }
    panic!("the work has no end");
}

fn edge(fleet: &FleetPoseGraph) -> msg::MergeEdge {
    let mut edges = MergeEdges::default();
    fleet.write_edges(&mut edges);
    edges.edges()[0]
}

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

/// A fleet whose starts are unknown and whose two robots have found each other on these ways.
fn together(ways: &[Vec<Pose2>; 2], believed: &[Vec<Pose2>; 2]) -> FleetPoseGraph {
    let mut fleet = FleetPoseGraph::new(&AlignConfig::default(), &[None, None]);
    send(&mut fleet, 1, &ways[0], &believed[0], 1);
    send(&mut fleet, 2, &ways[1], &believed[1], 1);
    fleet.finish();
    work(&mut fleet);
    assert_eq!(edge(&fleet).state(), EdgeState::Accepted, "{:?}", edge(&fleet));
    fleet
}

/// The house from both ends, and what two robots believe of it of whom the second turns too much.
fn one_bent() -> ([Vec<Pose2>; 2], [Vec<Pose2>; 2]) {
    let ways = [way(4.0, 26.0, 5.0), way(26.0, 4.0, 7.0)];
    let believed = [bent(&ways[0], 0.0), bent(&ways[1], 0.012)];
    (ways, believed)
}

/// Mean and greatest distance of robot 2's submaps from where they truly lie, as robot 1 begins.
fn errors(fleet: &FleetPoseGraph, ways: [&[Pose2]; 2], believed: &[Pose2]) -> [f64; 2] {
    let off = (0..believed.len()).map(|id| {
        let here = fleet.map_from_robot_map_at(robot(2), id as u32).unwrap() * believed[id];
        here.distance_m(ways[0][0].between(ways[1][id]))
    });
    let off: Vec<f64> = off.collect();
    [off.iter().sum::<f64>() / off.len() as f64, off.iter().fold(0.0, |most, m| most.max(*m))]
}

#[test]
fn the_joint_graph_is_better_than_any_rigid_merge_of_a_bent_map() {
    let (ways, believed) = one_bent();
    let (fleet, drifted) = (together(&ways, &believed), &believed[1]);
    let told = edge(&fleet);
    assert!(told.closures >= 5 && told.occupied_f1 > told.null_f1_max + 0.3, "{told:?}");
    assert!(fleet.redrawn_map(robot(2)).is_some());
    let [mean_m, most_m] = errors(&fleet, [&ways[0], &ways[1]], drifted);
    // The best that a rigid transform can do: the truth fitted to the bent way, point by point.
    let rigid = (0..drifted.len()).map(|fixed| {
        let anchor = ways[0][0].between(ways[1][fixed]) * drifted[fixed].inverse();
        let off = |id: usize| (anchor * drifted[id]).distance_m(ways[0][0].between(ways[1][id]));
        (0..drifted.len()).map(off).sum::<f64>() / drifted.len() as f64
    });
    let rigid_m = rigid.fold(f64::INFINITY, f64::min);
    assert!(mean_m < 0.02 && most_m < 0.05 && mean_m < 0.15 * rigid_m, "{mean_m} {most_m}, rigid {rigid_m}");
}

#[test]
fn wrong_closures_are_left_out() {
    let (ways, believed) = one_bent();
    let (mut fleet, drifted) = (together(&ways, &believed), &believed[1]);
    let right = fleet.pairs[0].closures.clone();
    let [before_m, _] = errors(&fleet, [&ways[0], &ways[1]], drifted);
    // As many as a third of them again, off by what a search's window allows, each its own way.
    for (k, closure) in right.iter().enumerate().step_by(3) {
        let mut wrong = *closure;
        let (sin, cos) = (1.7 * k as f64).sin_cos();
        wrong.found.i_from_j = wrong.found.i_from_j * Pose2::new(0.7 * cos, 0.7 * sin, 0.1 * sin);
        fleet.pairs[0].closures.push(wrong);
    }
    fleet.unsolved = true;
    work(&mut fleet);
    let in_force = &fleet.pairs[0].in_force;
    assert!(in_force.iter().all(|k| *k < right.len()), "{in_force:?} of {}", right.len());
    assert!(in_force.len() * 10 >= right.len() * 9, "{in_force:?} of {}", right.len());
    let [after_m, _] = errors(&fleet, [&ways[0], &ways[1]], drifted);
    assert!(after_m < before_m + 0.01, "{after_m} m with them, {before_m} m without");
}

#[test]
fn what_the_operator_undoes_stays_undone_and_what_he_pins_comes_back() {
    let (mut fleet, ..) = found();
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
fn a_robot_that_begins_again_keeps_its_place_and_one_that_leaves_does_not_move_the_frame() {
    let (mut fleet, ways, believed) = found();
    let place = fleet.map_from_robot_map(robot(2)).unwrap();
    send(&mut fleet, 2, &ways[1][..2], &believed[1][..2], 2);
    assert!(fleet.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
    // Its SLAM has forgotten nodes: the same incarnation, new submaps under the old ids, of which none has come.
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
fn strangers_and_nonsense_are_refused() {
    let mut fleet = FleetPoseGraph::new(&AlignConfig::default(), &[None]);
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

/// Two robots that have found each other, and what they drove.
fn found() -> (FleetPoseGraph, [Vec<Pose2>; 2], [Vec<Pose2>; 2]) {
    let ways = [way(4.0, 16.0, 5.0), way(18.0, 6.0, 6.0)];
    let believed = [bent(&ways[0], 0.0), bent(&ways[1], 0.0)];
    (together(&ways, &believed), ways, believed)
}

fn recalled(memory: &FleetSnapshot) -> FleetPoseGraph {
    let mut fleet = FleetPoseGraph::new(&AlignConfig::default(), &[None, None]);
    fleet.restore(memory).unwrap();
    fleet
}

#[test]
fn a_fleet_that_is_recalled_has_its_places_before_anything_is_found_again() {
    let (mut fleet, ways, believed) = found();
    assert!(fleet.apply_command(1, EdgeAction::Pin));
    work(&mut fleet);
    let memory = fleet.snapshot();
    let mut again = recalled(&memory);
    assert_eq!(again.snapshot(), memory);
    for k in [1, 2] {
        assert_eq!(again.map_from_robot_map(robot(k)), fleet.map_from_robot_map(robot(k)));
    }
    let (before, now) = (edge(&fleet), edge(&again));
    assert_eq!((now.state(), now.a_from_b), (EdgeState::Pinned, before.a_from_b));
    assert_eq!(
        (now.occupied_f1, now.null_f1_max, now.inliers),
        (before.occupied_f1, before.null_f1_max, before.inliers)
    );
    // Robot 2's submaps come first: the frame stays robot 1's, and nobody moves.
    let place = fleet.map_from_robot_map(robot(2)).unwrap();
    send(&mut again, 2, &ways[1], &believed[1], 1);
    assert_eq!(again.map_from_robot_map(robot(1)), Some(Pose2::IDENTITY));
    assert!(again.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
    send(&mut again, 1, &ways[0], &believed[0], 1);
    again.finish();
    work(&mut again);
    assert_eq!(edge(&again).state(), EdgeState::Pinned);
    assert!(edge(&again).closures >= 3, "closures are found again: {:?}", edge(&again));
    assert!(again.map_from_robot_map(robot(1)).unwrap().distance_m(Pose2::IDENTITY) < 0.01);
    assert!(again.map_from_robot_map(robot(2)).unwrap().distance_m(place) < 0.05);
}

#[test]
fn what_the_operator_took_back_is_not_found_again_by_a_fleet_that_is_recalled() {
    let (mut fleet, ways, believed) = found();
    assert!(fleet.apply_command(1, EdgeAction::Undo));
    work(&mut fleet);
    let mut again = recalled(&fleet.snapshot());
    assert_eq!((edge(&again).state(), again.map_from_robot_map(robot(2))), (EdgeState::Undone, None));
    send(&mut again, 1, &ways[0], &believed[0], 1);
    send(&mut again, 2, &ways[1], &believed[1], 1);
    again.finish();
    work(&mut again);
    assert_eq!((edge(&again).state(), again.map_from_robot_map(robot(2))), (EdgeState::Undone, None));
    // Without the memory it is.
    assert_eq!(edge(&found().0).state(), EdgeState::Accepted);
}

#[test]
fn the_frame_of_a_robot_that_left_is_remembered() {
    let (mut fleet, _, _) = found();
    let place = fleet.map_from_robot_map(robot(2));
    fleet.remove_robot(robot(1));
    work(&mut fleet);
    let again = recalled(&fleet.snapshot());
    assert_eq!((again.map_from_robot_map(robot(1)), again.map_from_robot_map(robot(2))), (None, place));
}

#[test]
fn a_find_that_waits_and_places_that_hang_on_nothing_are_not_remembered() {
    let (mut fleet, _, _) = found();
    fleet.pairs[0].let_go(EdgeState::Candidate);
    let again = recalled(&fleet.snapshot());
    assert_eq!(edge(&again).state(), EdgeState::None);
    // Only the robot whose map gives the frame is sure of its place.
    assert_eq!(
        (again.map_from_robot_map(robot(1)), again.map_from_robot_map(robot(2))),
        (Some(Pose2::IDENTITY), None)
    );
}
