//! Robots whose machines began anew.

use super::*;

#[test]
fn a_robot_whose_machine_began_anew_has_no_place_until_its_new_map_is_joined() {
    let (mut fleet, paths, estimated) = two_connected_robots();
    assert!(fleet.map_from_robot_map(robot(2)).is_some());
    // Another run on the robot's machine: no submap yet, and nobody knows where the robot is.
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.run, poses.header.incarnation) = (7, 2);
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
    (poses.run, poses.header.incarnation) = (7, 2);
    fleet.update_poses(robot(1), &poses).unwrap();
    work(&mut fleet);
    assert_eq!(fleet.map_from_robot_map(robot(1)), None);
    assert!(fleet.map_from_robot_map(robot(2)).expect("it stays").distance_m(place) < 0.05);
}
