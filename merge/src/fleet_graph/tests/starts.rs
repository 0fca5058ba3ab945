//! Given starts that are wrong.

use super::*;
use proptest::prelude::*;

/// Three paths through the house, which overlap.
fn paths() -> [Vec<Pose2>; 3] {
    [true_path(4.0, 18.0, 5.0), true_path(20.0, 8.0, 6.0), true_path(6.0, 22.0, 7.0)]
}

/// Three robots with these starts after their paths.
fn fleet_with_starts(starts: [Pose2; 3]) -> FleetPoseGraph {
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &starts.map(Some));
    for (number, path) in (1..).zip(&paths()) {
        send(&mut fleet, number, path, &drifted_path(path, 0.0), 1);
    }
    fleet.finish();
    work(&mut fleet);
    fleet
}

fn is_start_contradicted(fleet: &FleetPoseGraph) -> [bool; 3] {
    [1, 2, 3].map(|number| fleet.is_start_contradicted(robot(number)))
}

#[test]
fn right_starts_are_kept() {
    let fleet = fleet_with_starts(paths().map(|path| path[0]));
    assert_eq!(is_start_contradicted(&fleet), [false; 3]);
    for (number, path) in (1..).zip(paths()) {
        let place = fleet.map_from_robot_map(robot(number)).unwrap();
        assert!(place.distance_m(path[0]) < 0.03, "robot{number}: {place:?}");
    }
}

#[test]
fn the_wrong_start_of_three_is_withdrawn_whichever_it_is() {
    for wrong in 0..3 {
        let mut starts = paths().map(|path| path[0]);
        starts[wrong] = starts[wrong] * Pose2::new(3.0, 0.0, 0.3);
        let fleet = fleet_with_starts(starts);
        // The frame is that of the right starts if two of them were compared.
        let from = if is_start_contradicted(&fleet)[0] { 2 } else { 0 };
        assert!(is_start_contradicted(&fleet)[wrong], "{:?}", is_start_contradicted(&fleet));
        let reference = fleet.map_from_robot_map(robot(from + 1)).unwrap();
        for (number, path) in (1..).zip(paths()) {
            let place = fleet.map_from_robot_map(robot(number)).expect("it is aligned");
            let off_m = reference.between(place).distance_m(paths()[from][0].between(path[0]));
            assert!(off_m < 0.1, "robot{wrong} wrong: robot{number} is {off_m} m off");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]
    #[test]
    fn no_robot_is_at_a_wrong_place(
        wrong in 0..3_usize, x_m in -12.0..12.0_f64, y_m in -6.0..6.0_f64, yaw_rad in -3.1..3.1_f64, scale in 0.0..1.0_f64,
    ) {
        let mut starts = paths().map(|path| path[0]);
        // Small errors as often as large ones.
        let scale = scale.powi(3);
        starts[wrong] = starts[wrong] * Pose2::new(scale * x_m, scale * y_m, scale * yaw_rad);
        let fleet = fleet_with_starts(starts);
        let places: Vec<(Pose2, Pose2)> = (1..)
            .zip(paths())
            .filter_map(|(number, path)| Some((fleet.map_from_robot_map(robot(number))?, path[0])))
            .collect();
        for [one, other] in places.iter().flat_map(|one| places.iter().map(move |other| [one, other])) {
            let off_m = one.0.between(other.0).distance_m(one.1.between(other.1));
            prop_assert!(off_m < 0.15, "{off_m} m, {:?}", is_start_contradicted(&fleet));
        }
    }
}

#[test]
fn maps_that_are_not_joined_say_why() {
    // Two robots that hardly leave one small corner.
    let corner = [true_path(4.0, 6.0, 5.0), true_path(24.0, 22.0, 6.0)];
    let mut fleet = FleetPoseGraph::new(&MergeConfig::default(), &[None, None]);
    for (number, path) in (1..).zip(&corner) {
        send(&mut fleet, number, path, &drifted_path(path, 0.0), 1);
    }
    fleet.finish();
    work(&mut fleet);
    let found = edge(&fleet);
    assert_eq!(found.state(), EdgeState::None);
    assert!(found.tries > 0 && found.refusal().is_some(), "{found:?}");
    let (joined, ..) = two_connected_robots();
    assert_eq!(edge(&joined).refusal(), None);
}
