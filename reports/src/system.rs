//! What a fleet is made of, as pictures: the tree of its frames, and its processes with the channels between them.

use crate::graph_picture::{GraphEdge, GraphNode, graph_picture, tree_picture};
use bridge::RobotNames;
use bridge::ros::{FrameNames, NameStyle};
use msg::RobotFrame;

/// Robots whose frames are drawn; those of the others are like them.
const ROBOTS_SHOWN: usize = 4;
/// Processes by their columns: what measures, what maps, what joins the maps and drives, and what looks on.
const COLUMNS: [&[&str]; 4] =
    [&["sim", "link"], &["slam"], &["merge", "nav"], &["telemetry", "bridge", "record", "launcher"]];
/// Distance between the processes of a column, rows.
const ROWS_APART: f64 = 2.0;

/// Returns the frames of a fleet's `/tf` under ROS's names as SVG. Who publishes a transform is shown under the pointer.
pub fn frame_tree(names: &RobotNames) -> String {
    let frames = FrameNames::new(NameStyle::Slash, names);
    let (mut nodes, mut parents, mut labels) = (vec!["map".to_owned()], vec![None], vec![String::new()]);
    let mut add = |name: &str, parent: usize, label: &str| {
        nodes.push(name.to_owned());
        parents.push(Some(parent));
        labels.push(label.to_owned());
        nodes.len() - 1
    };
    for robot in names.robots().take(ROBOTS_SHOWN) {
        let link = |link| frames.robot_frame(robot, link);
        let of_robot = match frames.map(robot) {
            // The only robot under plain names has the fleet's map.
            "map" => 0,
            own => add(own, 0, "merging, as soon as the map is joined"),
        };
        let odom = add(link(RobotFrame::Odom), of_robot, "SLAM, with each scan");
        let footprint = add(link(RobotFrame::BaseFootprint), odom, "odometry");
        let base = add(link(RobotFrame::BaseLink), footprint, "the robot's description");
        for part in [RobotFrame::BaseScan, RobotFrame::WheelLeft, RobotFrame::WheelRight, RobotFrame::Imu] {
            add(link(part), base, "the robot's description");
        }
    }
    tree_picture("Frames of /tf", &nodes, &parents, &labels)
}

/// Returns processes and channels as SVG. An arrow is from a writer to a reader, with the names of the channels.
pub fn process_graph(arrows: &[(&str, &str, Vec<&str>)]) -> String {
    let place = |name: &str| {
        COLUMNS.iter().enumerate().find_map(|(column, names)| {
            names.iter().position(|known| *known == name).map(|row| (column, row))
        })
    };
    let mut names: Vec<&str> = arrows.iter().flat_map(|(from, to, _)| [*from, *to]).collect();
    names.sort_unstable();
    names.dedup();
    names.retain(|name| place(name).is_some());
    let node = |name: &&str| {
        let (column, row) = place(name).unwrap_or_default();
        // Columns with fewer processes stand lower, so that arrows do not run along each other.
        let row = (row as f64 + 0.5 * (column % 2) as f64) * ROWS_APART;
        GraphNode { name: (*name).to_owned(), column, row }
    };
    let nodes: Vec<GraphNode> = names.iter().map(node).collect();
    let index = |name: &str| names.iter().position(|known| *known == name);
    let edge = |(from, to, channels): &(&str, &str, Vec<&str>)| {
        let (from, to) = (index(from)?, index(to)?);
        (from != to).then(|| GraphEdge { from, to, label: channels.join(", ") })
    };
    graph_picture("Processes and channels", &nodes, &arrows.iter().filter_map(edge).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_robots_frames_hang_below_the_merged_map() {
        let svg = frame_tree(&RobotNames::from(2));
        for frame in ["map", "robot1/map", "robot2/map", "robot1/odom", "robot2/base_scan"] {
            assert!(svg.contains(&format!(">{frame}</text>")), "{frame}: {svg}");
        }
        assert_eq!(svg.matches("<rect").count(), 1 + 2 * 8);
        assert!(frame_tree(&RobotNames::from(64)).matches("<rect").count() <= 1 + ROBOTS_SHOWN * 8);
    }

    #[test]
    fn channels_are_arrows_between_processes() {
        let arrows = [("sim", "slam", vec!["scan", "odometry"]), ("slam", "merge", vec!["submap"])];
        let svg = process_graph(&arrows);
        assert!(svg.contains("<title>scan, odometry</title>") && svg.matches("<rect").count() == 3, "{svg}");
    }
}
