//! A robot that is searched for in a map: how many searches must agree before it counts as found.

use super::{MapNodes, RelocalizationCounts, RelocalizationOutcome, Relocalizer};
use crate::common::{FULL, Lidar, Noise, cast, laboratory};
use crate::config::SlamConfig;
use crate::node::Node;
use crate::testing::standing_node;
use msg::{Pose2, Stamp};

/// Sees the laboratory from wall to wall.
const LIDAR: Lidar = Lidar { range_max_m: 12.0, ..FULL };

/// A node that sees the laboratory from `pose`. `local_from_base`: where the front end has it.
fn node(id: u32, pose: Pose2, local_from_base: Pose2, noise: &mut Noise, config: &SlamConfig) -> Node {
    let scan = cast(&laboratory(), &LIDAR, pose, Stamp::default(), noise);
    standing_node(id, &scan, local_from_base, &config.lidar)
}

#[test]
fn a_robot_is_found_when_searches_along_its_path_agree_and_not_before() {
    let (config, mut noise) = (SlamConfig::default(), Noise::new(2));
    let poses: Vec<Pose2> = (0..10).map(|i| Pose2::new(-0.5, -1.8 + 0.4 * f64::from(i), 1.5)).collect();
    let nodes: Vec<Node> =
        poses.iter().enumerate().map(|(i, pose)| node(i as u32, *pose, *pose, &mut noise, &config)).collect();
    let map = MapNodes::of_map(&nodes, &poses);
    let mut relocalizer = Relocalizer::new(config.clone(), map, None, RelocalizationCounts::default());
    // The robot drives beside the path of the map, in a frame of its own.
    let map_from_local = Pose2::new(0.0, -1.5, 1.4);
    for i in 0..24 {
        let local = Pose2::new(0.15 * f64::from(i), 0.0, 0.0);
        let newest = node(i, map_from_local * local, local, &mut noise, &config);
        let outcome = relocalizer.add_node(newest, map);
        let counts = relocalizer.counts();
        if counts.found < 3 {
            assert_eq!(outcome, RelocalizationOutcome::NotFound, "{} searches are no proof", counts.found);
        }
        if let RelocalizationOutcome::Found { map_from_local: found } = outcome {
            assert!(found.distance_m(map_from_local) < 0.05, "{found:?}");
            return;
        }
    }
    panic!("not found: {:?}", relocalizer.counts());
}
