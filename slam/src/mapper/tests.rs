//! However the work is cut, the map is that of the nodes and their poses.

use super::*;
use crate::cloud::Cloud;
use crate::node::{Rays, SweptPath};
use msg::grid::{SWEPT_FREE, UNKNOWN};
use proptest::prelude::*;
use std::sync::Arc;

/// A node that sees a wall bent around it.
fn node(id: u32, range_m: f32, beams: usize, is_tracked: bool) -> Node {
    let angle = |i: usize| i as f32 * core::f32::consts::TAU / 97.0;
    let mut rays = Rays { sensor: [0.1, 0.0], ..Default::default() };
    for i in 0..beams {
        let (sin, cos) = angle(i).sin_cos();
        let range = range_m + 0.5 * (3.0 * angle(i)).sin();
        let end = [range * cos, range * sin];
        if i % 5 == 0 { rays.misses.push(end) } else { rays.hits.push(end) }
    }
    let mut header = msg::Header::default();
    header.stamp.0 = i64::from(id);
    Node {
        odometry_break: false,
        disconnected_component: None,
        uncertain_component: None,
        id,
        header,
        local_from_base: Pose2::IDENTITY,
        previous_from_this: None,
        is_tracked,
        unmeasured_s: 0.0,
        slip: [0.0; 3],
        possibly_kidnapped: false,
        cloud: Arc::new(Cloud::merged(core::iter::empty(), 1)),
        rays: Arc::new(rays),
        // Some came from afar, or nobody knows from where.
        swept_path: match id % 4 {
            3 => SweptPath::default(),
            _ => SweptPath::of(&[[-0.5 - 0.3 * (id % 5) as f32, 0.1], [0.2, -0.3], [0.0, 0.0]]),
        },
    }
}

fn pose() -> impl Strategy<Value = Pose2> {
    (-9.0..9.0, -9.0..9.0, -3.2..3.2).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

fn nodes() -> impl Strategy<Value = (Vec<Node>, Vec<Pose2>)> {
    let one = (0.5_f32..6.0, 0_usize..97, prop::bool::weighted(0.9), pose());
    prop::collection::vec(one, 1..24).prop_map(|seen| {
        let node = |(id, (range, beams, is_tracked, _)): (usize, &(f32, usize, bool, Pose2))| {
            node(id as u32, *range, *beams, *is_tracked)
        };
        (seen.iter().enumerate().map(node).collect(), seen.iter().map(|(.., pose)| *pose).collect())
    })
}

fn mapper() -> OccupancyMapper {
    OccupancyMapper::new(MapConfig { robot_radius_m: 0.2, ..MapConfig::default() })
}

fn finished(nodes: &[Node], poses: &[Pose2]) -> msg::Grid {
    mapper().finish(nodes, poses).to_owned()
}

/// Nothing of the map is known that the version does not have, and the other way round.
fn same(map: &TileMap, grid: &msg::Grid) -> bool {
    DenseMap::default().update(map).to_owned() == *grid
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn slices_do_not_show(
        (nodes, first) in nodes(),
        moves in prop::collection::vec((0_usize..24, pose()), 0..12),
        slices in prop::collection::vec((0_usize..24, 0_usize..4000), 0..60),
        keeps in prop::collection::vec(any::<bool>(), 24),
    ) {
        let mut mapper = mapper();
        let mut poses = first.clone();
        let mut moves = moves.into_iter();
        let mut known = 1;
        for (more, cells) in slices {
            known = (known + more / 8).min(nodes.len());
            if more % 5 == 0 && let Some((index, pose)) = moves.next() {
                poses[index % nodes.len()] = pose;
            }
            mapper.work(&nodes[..known], &poses[..known], cells);
        }
        let drawn = mapper.finish(&nodes, &poses).to_owned();
        prop_assert_eq!(&drawn, &finished(&nodes, &poses));
        // Some are forgotten.
        let left: Vec<Node> =
            nodes.iter().zip(keeps).map(|(node, keep)| Node { is_tracked: node.is_tracked && keep, ..node.clone() }).collect();
        prop_assert_eq!(mapper.finish(&left, &poses).to_owned(), finished(&left, &poses));
    }

    /// While a new version is drawn, the old one is shown, with what is new drawn in.
    #[test]
    fn never_half_a_version((nodes, before) in nodes(), after in prop::collection::vec(pose(), 24)) {
        let last = nodes.len() - 1;
        let mut mapper = mapper();
        while mapper.work(&nodes[..last], &before[..last], usize::MAX) {}
        let mut poses = before.clone();
        poses[..last].copy_from_slice(&after[..last]);
        let mut with_old = before.clone();
        with_old[last] = poses[last];
        let mut known = last;
        while mapper.work(&nodes[..known], &poses, 1) {
            let shows = |poses: &[Pose2]| same(mapper.tiles(), &finished(&nodes[..known], &poses[..known]));
            prop_assert!(shows(&with_old) || shows(&poses));
            known = nodes.len();
        }
        prop_assert!(same(mapper.tiles(), &finished(&nodes[..known], &poses[..known])));
    }
}

#[test]
fn what_moves_too_little_to_be_seen_is_left_until_the_end() {
    let nodes = [node(0, 3.0, 97, true), node(1, 4.0, 97, true)];
    let here = [Pose2::IDENTITY, Pose2::new(2.0, 0.0, 0.0)];
    let there = [Pose2::new(0.02, 0.0, 0.0), here[1]];
    let mut mapper = mapper();
    while mapper.work(&nodes, &here, usize::MAX) {}
    let drawn = mapper.tiles().clone();
    assert!(!mapper.work(&nodes, &there, usize::MAX));
    assert_eq!(mapper.tiles().changed_since(&drawn).count(), 0);
    assert_eq!(mapper.finish(&nodes, &there).to_owned(), finished(&nodes, &there));
    assert_ne!(finished(&nodes, &there).cells, finished(&nodes, &here).cells);
}

#[test]
fn a_node_beyond_the_largest_map_is_counted_and_comes_back() {
    let nodes: Vec<Node> = (0..3).map(|id| node(id, 3.0, 97, true)).collect();
    let far = [Pose2::IDENTITY, Pose2::new(900.0, 900.0, 0.0), Pose2::new(1.0, 0.0, 0.0)];
    let near = [Pose2::IDENTITY, Pose2::new(0.5, 0.5, 0.0), Pose2::new(1.0, 0.0, 0.0)];
    let mut mapper = mapper();
    mapper.finish(&nodes, &far);
    assert_eq!(mapper.nodes_not_drawn(), 1);
    assert_eq!(mapper.finish(&nodes, &near).to_owned(), finished(&nodes, &near));
    assert_eq!(mapper.nodes_not_drawn(), 0);
    // Then the first one flies off, and room is for those that stay.
    let gone = [Pose2::new(-1e9, f64::MAX, 0.0), near[1], near[2]];
    mapper.finish(&nodes, &gone);
    assert_eq!(mapper.nodes_not_drawn(), 1);
    assert_eq!(mapper.finish(&nodes, &near).to_owned(), finished(&nodes, &near));
}

/// Cells of a map along a line, from a point.
fn along(grid: &msg::Grid, from_m: [f64; 2], step_m: [f64; 2], count: usize) -> Vec<i8> {
    let view = grid.view();
    let at = |k: usize| [0, 1].map(|side| from_m[side] + k as f64 * step_m[side]);
    (0..count).map(|k| view.cell_of(at(k))).map(|(x, y)| view.cell(x, y)).collect()
}

#[test]
fn where_the_body_was_is_floor_until_the_robot_sees_something_there() {
    use msg::grid::{FREE_MAX, LOG_ODDS_MIN, OCCUPIED_MIN};
    // It looks back and sees something just behind its body.
    let looks_back = |id, path: &[[f32; 2]]| {
        let rays = Rays { sensor: [0.0; 2], hits: vec![[-0.28, 0.0]], misses: Vec::new() };
        Node { swept_path: SweptPath::of(path), rays: Arc::new(rays), ..node(id, 1.0, 0, true) }
    };
    let came: Vec<[f32; 2]> = (0..=6).map(|k| [-0.05 * k as f32, 0.0]).collect();
    let mut nodes = vec![looks_back(0, &[]), Node { rays: Arc::default(), ..looks_back(1, &came) }];
    let mut poses = vec![Pose2::new(0.0, 0.025, 0.0), Pose2::new(0.3, 0.025, 0.0)];
    let drawn = finished(&nodes, &poses);
    // From 0.2 m behind the one to 0.2 m before the other, and 0.2 m to each side.
    assert!(
        along(&drawn, [-0.175, 0.025], [0.05, 0.0], 14).iter().all(|cell| *cell == SWEPT_FREE),
        "{drawn:?}"
    );
    assert_eq!(along(&drawn, [0.125, -0.125], [0.0, 0.4], 2), [SWEPT_FREE, UNKNOWN]);
    let behind =
        |nodes: &[Node], poses: &[Pose2]| along(&finished(nodes, poses), [-0.275, 0.025], [0.0; 2], 1)[0];
    assert_eq!(behind(&nodes, &poses), 25);
    // What it took for an obstacle before it came there is gone; what it sees there after is not.
    nodes.push(looks_back(2, &[[0.0, 0.0]]));
    poses.push(Pose2::new(-0.3, 0.025, 0.0));
    assert_eq!(behind(&nodes, &poses), SWEPT_FREE);
    for k in 3..14 {
        nodes.push(looks_back(k, &[]));
        poses.push(poses[0]);
        let seen = behind(&nodes, &poses);
        assert!(seen > LOG_ODDS_MIN && (k > 3 || seen < FREE_MAX), "{seen} after {k}");
    }
    assert!(behind(&nodes, &poses) >= OCCUPIED_MIN);
    // Of a robot whose size is not known, nothing is claimed.
    let unknown_size = OccupancyMapper::new(MapConfig::default()).finish(&nodes, &poses).to_owned();
    assert!(unknown_size.cells.iter().all(|cell| *cell != SWEPT_FREE));
}
