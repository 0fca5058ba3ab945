//! Robots whose machines began anew.

use super::*;

#[test]
fn a_robot_whose_machine_began_anew_has_no_place_until_its_new_map_is_joined() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    assert!(fleet.map_from_robot_map(robot(2)).is_some());
    // Another run on the robot's machine: no submap yet, and nobody knows where the robot is.
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.map_frame, poses.header.incarnation) = (7, 2);
    fleet.update_poses(robot(2), &poses).unwrap();
    assert_eq!(fleet.map_from_robot_map(robot(2)), None);
    assert_eq!(edge(&fleet).state(), EdgeState::None);
    assert!(!fleet.apply_command(1, EdgeAction::Pin), "there is no edge to pin");
    // Nor does a merging that was started again know a place.
    let mut restarted = FleetPoseGraph::new(&MergeConfig::default(), &[Some(Pose2::IDENTITY); 2]);
    restarted.restore(&fleet.snapshot()).unwrap();
    assert_eq!(restarted.map_from_robot_map(robot(2)), None);
    restarted.update_poses(robot(2), &poses).unwrap();
    assert_eq!(restarted.map_from_robot_map(robot(2)), None);
    // The same run goes on with other submaps: joined by what they show.
    send_of(&mut fleet, 2, &paths[1], &estimated[1], (7, 2));
    fleet.finish();
    work(&mut fleet);
    assert!(fleet.map_from_robot_map(robot(2)).is_some());
}

#[test]
fn the_frame_stays_when_the_only_robot_with_a_start_begins_anew() {
    let (_, paths, estimated) = two_connected_robots();
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &[Some(Pose2::IDENTITY), None, None]);
    send(&mut fleet, 1, &paths[0], &estimated[0], 1);
    send(&mut fleet, 2, &paths[1], &estimated[1], 1);
    fleet.finish();
    work(&mut fleet);
    let place = fleet.map_from_robot_map(robot(2)).expect("joined to the first");
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.map_frame, poses.header.incarnation) = (7, 2);
    fleet.update_poses(robot(1), &poses).unwrap();
    work(&mut fleet);
    assert_eq!(fleet.map_from_robot_map(robot(1)), None);
    assert!(fleet.map_from_robot_map(robot(2)).expect("it stays").distance_m(place) < 0.05);
}

/// On another machine a SLAM that is started again has the same generation: it is told by its few submaps.
#[test]
fn a_robot_that_sends_fewer_submaps_begins_anew_and_none_of_its_closures_stays() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    assert!(edge(&fleet).closures > 0);
    let place = fleet.map_from_robot_map(robot(2));
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.len, poses.header.incarnation) = (1, 1);
    poses.robot_map_from_submap[0] = estimated[1][0];
    fleet.update_poses(robot(2), &poses).unwrap();
    work(&mut fleet);
    assert_eq!((edge(&fleet).closures, fleet.missing_submaps(robot(2))), (0, 1));
    assert!(
        place.unwrap().distance_m(fleet.map_from_robot_map(robot(2)).unwrap()) < 0.3,
        "it keeps its place"
    );
    send(&mut fleet, 2, &paths[1], &estimated[1], 1);
    assert!(edge(&fleet).closures > 0);
}

#[test]
fn a_submap_of_an_older_generation_that_comes_late_changes_nothing() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.len, poses.header.incarnation, poses.generation) = (2, 1, 1);
    poses.robot_map_from_submap[..2].copy_from_slice(&estimated[1][..2]);
    fleet.update_poses(robot(2), &poses).unwrap();
    let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
    submap.set_grid(draw_submap(paths[1][0]).view());
    (submap.nodes, submap.finished) = (10, 1);
    submap.header_mut().incarnation = 1;
    fleet.add_submap(robot(2), &submap).unwrap();
    assert_eq!(fleet.missing_submaps(robot(2)), 2, "the new poses stay, without a submap of before");
    submap.generation = 1;
    fleet.add_submap(robot(2), &submap).unwrap();
    assert_eq!(fleet.missing_submaps(robot(2)), 1);
    // A SLAM that is started again on another machine counts from 0, and nothing else tells.
    poses.generation = 0;
    fleet.update_poses(robot(2), &poses).unwrap();
    submap.generation = 0;
    assert_eq!(fleet.missing_submaps(robot(2)), 2);
    fleet.add_submap(robot(2), &submap).unwrap();
    assert_eq!(fleet.missing_submaps(robot(2)), 1);
}

/// The operator holds two maps together that contradict each other.
#[test]
fn a_pinned_edge_that_the_maps_contradict_leaves_time_for_all_other_work() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    assert!(fleet.apply_command(1, EdgeAction::Pin));
    // The second robot's map shows another part of the house at the same place.
    let elsewhere: Vec<Pose2> = paths[0].iter().map(|pose| Pose2::new(0.7, 0.9, 0.0) * *pose).collect();
    let count = elsewhere.len().min(estimated[1].len());
    send(&mut fleet, 2, &elsewhere[..count], &estimated[1][..count], 2);
    work(&mut fleet);
    assert_eq!(edge(&fleet).state(), EdgeState::Pinned, "the operator's word stands");
}
