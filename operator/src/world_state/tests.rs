use super::*;
use bridge::ros::TransformStamped;
use bridge::ros::write::spatial;

fn transform(parent: &str, child: &str, pose: Pose2) -> TransformStamped {
    let (translation, rotation) = spatial(pose);
    TransformStamped {
        stamp: Stamp(0),
        frame_id: parent.into(),
        child_frame_id: child.into(),
        translation,
        rotation,
    }
}

fn store_transforms(state: &mut WorldState, now_s: f64, transforms: Vec<TransformStamped>) {
    let content = MessageContent::Transforms(TfMessage { transforms });
    state.store(Stamp::from_seconds(now_s), "/tf", &[], content).unwrap();
}

fn grid(side: u32) -> Vec<u8> {
    let grid = OccupancyGrid {
        resolution: 0.05,
        width: side,
        height: side,
        orientation: [0.0, 0.0, 0.0, 1.0],
        data: vec![0; (side * side) as usize],
        ..Default::default()
    };
    let mut payload = Vec::new();
    ros::encode(&grid, &mut payload);
    payload
}

#[test]
fn poses_refer_to_the_own_map_until_the_place_in_the_merged_map_is_known() {
    let robot = RobotId::new(2).unwrap();
    let mut state = WorldState::default();
    let (map_from_odom, odom_from_base) = (Pose2::new(1.0, 0.0, 0.5), Pose2::new(0.3, 0.1, -2.0));
    let scan_at = Pose2::new(-0.04, 0.0, 0.0);
    store_transforms(
        &mut state,
        0.0,
        vec![
            transform("map_2", "odom_2", map_from_odom),
            transform("odom_2", "base_footprint_2", odom_from_base),
            transform("base_footprint_2", "base_link_2", Pose2::IDENTITY),
            transform("base_link_2", "base_scan_2", scan_at),
        ],
    );
    state.store(Stamp(0), "/robot2/map", &grid(3), MessageContent::Encoded).unwrap();
    state.store(Stamp(0), "/merged_map", &grid(5), MessageContent::Encoded).unwrap();
    let maps = decode_maps(state.take_encoded_maps());
    assert_eq!(maps.len(), 2);
    state.store_maps(maps);
    let alone = state.robot(Stamp::from_seconds(0.5), robot);
    assert!(!alone.in_merged_map && alone.map.as_ref().unwrap().width == 3);
    assert!(alone.map_from_base.unwrap().distance_m(map_from_odom * odom_from_base) < 1e-9);
    assert!(alone.base_from_scan.distance_m(scan_at) < 1e-9);
    assert!(alone.observation().map.is_some());

    let map_from_robot_map = Pose2::new(-2.0, 3.0, 1.0);
    store_transforms(&mut state, 0.6, vec![transform("map", "map_2", map_from_robot_map)]);
    let merged = state.robot(Stamp::from_seconds(0.7), robot);
    assert!(merged.in_merged_map && merged.map.as_ref().unwrap().width == 5);
    let expected = map_from_robot_map * map_from_odom * odom_from_base;
    assert!(merged.map_from_base.unwrap().distance_m(expected) < 1e-9);

    let stale = state.robot(Stamp::from_seconds(5.0), robot);
    assert_eq!(stale.map_from_base, None);
}

#[test]
fn a_robot_whose_map_has_left_the_merged_map_is_in_its_own_again() {
    let robot = RobotId::new(1).unwrap();
    let mut state = WorldState::default();
    state.store(Stamp(0), "/robot1/map", &grid(3), MessageContent::Encoded).unwrap();
    state.store(Stamp(0), "/merged_map", &grid(5), MessageContent::Encoded).unwrap();
    let maps = decode_maps(state.take_encoded_maps());
    state.store_maps(maps);
    store_transforms(&mut state, 0.0, vec![transform("map", "map_1", Pose2::new(9.0, 0.0, 0.0))]);
    for tenths in 0..100 {
        let now_s = f64::from(tenths) * 0.1;
        let own = vec![
            transform("map_1", "odom_1", Pose2::IDENTITY),
            transform("odom_1", "base_footprint_1", Pose2::IDENTITY),
        ];
        store_transforms(&mut state, now_s, own);
        let at = state.robot(Stamp::from_seconds(now_s), robot);
        // Links are repeated once a second while they hold.
        assert_eq!(at.in_merged_map, tenths <= 50, "after {now_s} s");
        assert!(at.map_from_base.is_some());
    }
}

#[test]
fn invalid_transforms_and_maps_are_ignored() {
    let robot = RobotId::new(1).unwrap();
    let mut state = WorldState::default();
    // A loop, a frame that is its own parent, a pose that is not finite.
    store_transforms(&mut state, 0.0, vec![transform("odom_1", "base_footprint_1", Pose2::IDENTITY)]);
    store_transforms(&mut state, 0.0, vec![transform("base_footprint_1", "odom_1", Pose2::IDENTITY)]);
    store_transforms(&mut state, 0.0, vec![transform("map", "map", Pose2::new(f64::NAN, 0.0, 0.0))]);
    let many = (0..1000).map(|i| transform("a", &format!("f{i}"), Pose2::IDENTITY)).collect();
    store_transforms(&mut state, 0.0, many);
    assert!(state.transforms.len() <= FRAMES_MAX);
    assert_eq!(state.robot(Stamp(0), robot).map_from_base, None);
    // A map that cannot be decoded leaves the one before in place.
    state.store(Stamp(0), "/merged_map", &grid(2), MessageContent::Encoded).unwrap();
    let good = decode_maps(state.take_encoded_maps());
    state.store_maps(good);
    state.store(Stamp(0), "/merged_map", &[0, 1, 0, 0, 7], MessageContent::Encoded).unwrap();
    let bad = decode_maps(state.take_encoded_maps());
    assert!(bad.is_empty());
    state.store_maps(bad);
    assert_eq!(state.merged_map().unwrap().width, 2);
}

#[test]
fn frame_names_of_both_styles_are_understood() {
    let robot = RobotId::new(1).unwrap();
    let mut state = WorldState::default();
    store_transforms(
        &mut state,
        0.0,
        vec![
            transform("robot1/map", "robot1/odom", Pose2::IDENTITY),
            transform("robot1/odom", "robot1/base_footprint", Pose2::new(1.0, 0.0, 0.0)),
        ],
    );
    let pose = state.robot(Stamp(0), robot).map_from_base.unwrap();
    assert!((pose.x_m - 1.0).abs() < 1e-12);
}
