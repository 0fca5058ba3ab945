//! The frame `map` while robots are joined and separated.

use super::*;

#[test]
fn robots_that_become_the_larger_group_stay_where_they_are() {
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &[None; 3]);
    let paths = [true_path(4.0, 16.0, 5.0), true_path(18.0, 6.0, 6.0), true_path(6.0, 18.0, 6.0)];
    for (number, path) in (1..).zip(&paths) {
        send(&mut fleet, number, path, &drifted_path(path, 0.0), 1);
    }
    fleet.finish();
    work(&mut fleet);
    let places = [2, 3].map(|number| fleet.map_from_robot_map(robot(number)).expect("all are joined"));
    assert!(places[0].distance_m(Pose2::IDENTITY) > 1.0, "{places:?}");
    // The first robot, whose map is the frame `map`, is separated from both.
    for edge in [1, 2] {
        fleet.apply_command(edge, EdgeAction::Undo);
        fleet.finish();
        work(&mut fleet);
    }
    assert_eq!(fleet.map_from_robot_map(robot(1)), None);
    for (number, before) in [2, 3].into_iter().zip(places) {
        let after = fleet.map_from_robot_map(robot(number)).expect("they are joined with each other");
        assert!(after.distance_m(before) < 0.1, "robot{number} was at {before:?}, is at {after:?}");
    }
}

#[test]
fn the_frame_is_that_of_the_largest_group_of_joined_robots() {
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &[None; 3]);
    // The first robot is outside the house, where no other ever comes.
    let outside = true_path(100.0, 104.0, 5.0);
    send(&mut fleet, 1, &outside, &drifted_path(&outside, 0.0), 1);
    assert_eq!(fleet.map_from_robot_map(robot(1)), Some(Pose2::IDENTITY), "the only one");
    let (paths, estimated) = one_drifting();
    send(&mut fleet, 2, &paths[0], &estimated[0], 1);
    send(&mut fleet, 3, &paths[1], &estimated[1], 1);
    fleet.finish();
    work(&mut fleet);
    let second = fleet.map_from_robot_map(robot(2)).expect("two robots are joined");
    assert!(second.distance_m(Pose2::IDENTITY) < 0.05, "{second:?}");
    assert!(fleet.map_from_robot_map(robot(3)).is_some());
    assert_eq!(fleet.map_from_robot_map(robot(1)), None, "it is in another group");
    // Groups of one size: the frame stays.
    fleet.remove_robot(robot(3));
    work(&mut fleet);
    assert!(fleet.map_from_robot_map(robot(2)).is_some());
    assert_eq!(fleet.map_from_robot_map(robot(1)), None);
}
