//! Encodes the fleet's messages as CDR, without an intermediate message and without allocating.

use crate::cdr::{Dialect, Writer};
use crate::names::{FrameNames, MAP};
use msg::{
    GridView, IndexRect, MapTransforms, Odometry, Pose2, PoseEstimate, RobotFrame, RobotFrameTransform,
    RobotId, RobotStats, Scan, Stamp, Transforms,
};

/// Writes builtin_interfaces/Time: whole seconds and the remaining nanoseconds.
pub fn stamp(to: &mut Writer<'_>, stamp: Stamp) {
    let (sec, nanosec) = stamp.sec_nanosec();
    to.i32(sec);
    to.u32(nanosec);
}

/// Writes std_msgs/Header. ROS 1's `seq`, which its publishers set themselves, is 0.
pub fn header(to: &mut Writer<'_>, at: Stamp, frame_id: &str) {
    if to.dialect() == Dialect::Ros1 {
        to.u32(0);
    }
    stamp(to, at);
    to.string(frame_id);
}

/// Writes geometry_msgs/Pose, or geometry_msgs/Transform, which has the same layout: metres; quaternion x, y, z, w.
pub fn pose(to: &mut Writer<'_>, position: [f64; 3], orientation: [f64; 4]) {
    to.f64s(&position);
    to.f64s(&orientation);
}

/// Writes geometry_msgs/TransformStamped: the pose of frame `child` in `frame`, metres and a unit quaternion.
pub fn transform(
    to: &mut Writer<'_>,
    at: Stamp,
    frame: &str,
    child: &str,
    translation: [f64; 3],
    rotation: [f64; 4],
) {
    header(to, at, frame);
    to.string(child);
    pose(to, translation, rotation);
}

/// Writes nav_msgs/MapMetaData; `loaded` is the time of the content.
pub fn map_info(
    to: &mut Writer<'_>,
    loaded: Stamp,
    resolution_m: f32,
    (width, height): (u32, u32),
    position: [f64; 3],
    orientation: [f64; 4],
) {
    stamp(to, loaded);
    to.f32(resolution_m);
    to.u32(width);
    to.u32(height);
    pose(to, position, orientation);
}

/// Writes std_msgs/Float32MultiArray without dimensions.
pub fn float_array(to: &mut Writer<'_>, data: &[f32]) {
    to.count(0);
    to.u32(0);
    to.f32_seq(data);
}

/// Converts a planar pose into position and quaternion (x, y, z, w).
pub fn spatial(planar: Pose2) -> ([f64; 3], [f64; 4]) {
    let (sin, cos) = (0.5 * planar.yaw_rad).sin_cos();
    ([planar.x_m, planar.y_m, 0.0], [0.0, 0.0, sin, cos])
}

/// Writes geometry_msgs/TransformStamped of a planar pose.
pub fn planar_transform(to: &mut Writer<'_>, at: Stamp, frame: &str, child: &str, frame_from_child: Pose2) {
    let (translation, rotation) = spatial(frame_from_child);
    transform(to, at, frame, child, translation, rotation);
}

/// Writes sensor_msgs/LaserScan: ranges in metres, angles in radians, no intensities.
pub fn laser_scan(to: &mut Writer<'_>, frame_id: &str, scan: &Scan) {
    let ranges = scan.ranges_m();
    let angle_max = scan.angle_rad(ranges.len().saturating_sub(1));
    header(to, scan.header.stamp, frame_id);
    to.f32(scan.angle_min_rad);
    to.f32(angle_max);
    to.f32(scan.angle_increment_rad);
    to.f32(scan.time_increment_s);
    to.f32(scan.scan_time_s);
    to.f32(scan.range_min_m);
    to.f32(scan.range_max_m);
    to.f32_seq(ranges);
    to.count(0);
}

/// Writes tf2_msgs/TFMessage with one robot's transforms. Frames of unknown code are left out.
pub fn transforms(to: &mut Writer<'_>, names: &FrameNames, robot: RobotId, message: &Transforms) {
    some_transforms(to, names, &[(robot, message)], |_| true);
}

/// Writes tf2_msgs/TFMessage with those transforms of several robots whose child is `wanted`.
pub fn some_transforms(
    to: &mut Writer<'_>,
    names: &FrameNames,
    robots: &[(RobotId, &Transforms)],
    wanted: impl Fn(RobotFrame) -> bool,
) {
    let known = |transform: &RobotFrameTransform| {
        let child = RobotFrame::from_code(transform.child_frame).filter(|child| wanted(*child))?;
        Some((
            RobotFrame::from_code(transform.parent_frame)?,
            child,
            transform.translation_m,
            transform.rotation_xyzw,
        ))
    };
    to.count(robots.iter().flat_map(|(_, message)| message.transforms()).filter_map(known).count());
    for (robot, message) in robots {
        for (parent, child, translation, rotation) in message.transforms().iter().filter_map(known) {
            let (parent, child) = (names.robot_frame(*robot, parent), names.robot_frame(*robot, child));
            transform(to, message.header.stamp, parent, child, translation, rotation);
        }
    }
}

/// Writes tf2_msgs/TFMessage with the transform that SLAM owns: the robot's map from its odometry (REP-105).
///
/// Before it stands the merged map from the robot's map, where it is known: both at one stamp, so that the chain is found there.
pub fn map_from_odom(
    to: &mut Writer<'_>,
    names: &FrameNames,
    robot: RobotId,
    stamp: Stamp,
    (map_from_robot_map, map_from_odom): (Option<Pose2>, Pose2),
) {
    let (map, odom) = (names.map(robot), names.robot_frame(robot, RobotFrame::Odom));
    to.count(1 + usize::from(map_from_robot_map.is_some()));
    if let Some(map_from_robot_map) = map_from_robot_map {
        planar_transform(to, stamp, MAP, map, map_from_robot_map);
    }
    planar_transform(to, stamp, map, odom, map_from_odom);
}

/// Writes geometry_msgs/PoseWithCovarianceStamped: SLAM's pose of the robot in its map.
///
/// The covariance is row-major over x, y, z and the rotations about them; z, roll and pitch have none.
pub fn pose_estimate(to: &mut Writer<'_>, frame_id: &str, message: &PoseEstimate) {
    header(to, message.header.stamp, frame_id);
    let (position, orientation) = spatial(message.map_from_base);
    pose(to, position, orientation);
    let [xx, xy, x_yaw, yy, y_yaw, yaw_yaw] = message.covariance;
    let mut covariance = [0.0; 36];
    for (place, value) in [(0, xx), (1, xy), (5, x_yaw), (7, yy), (11, y_yaw), (35, yaw_yaw)] {
        covariance[place] = value;
        covariance[place % 6 * 6 + place / 6] = value;
    }
    to.f64s(&covariance);
}

/// Writes tf2_msgs/TFMessage: the merged map from each robot's map, where known.
pub fn map_transforms(to: &mut Writer<'_>, names: &FrameNames, at: Stamp, message: &MapTransforms) {
    let placed =
        || RobotId::first(message.robots.len()).filter(|robot| message.robots[robot.index()].known == 1);
    to.count(placed().count());
    for robot in placed() {
        let map_from_robot_map = message.robots[robot.index()].map_from_robot_map;
        planar_transform(to, at, MAP, names.map(robot), map_from_robot_map);
    }
}

/// Writes nav_msgs/Odometry. Covariances are row-major over x, y, z and the rotations about them.
pub fn odometry(
    to: &mut Writer<'_>,
    frame_id: &str,
    child_frame_id: &str,
    message: &Odometry,
    pose_covariance: &[f64; 36],
    twist_covariance: &[f64; 36],
) {
    header(to, message.header.stamp, frame_id);
    to.string(child_frame_id);
    let (position, orientation) = spatial(message.odom_from_base);
    pose(to, position, orientation);
    to.f64s(pose_covariance);
    to.f64s(&[message.linear_m_s, 0.0, 0.0, 0.0, 0.0, message.angular_rad_s]);
    to.f64s(twist_covariance);
}

/// Writes std_msgs/Float32MultiArray as the paper's `slam_stats`:
/// [free, occupied, unknown, total, width, height, resolution], cells and metres.
pub fn slam_stats(to: &mut Writer<'_>, stats: &RobotStats) {
    let total =
        [stats.free_cells, stats.occupied_cells, stats.unknown_cells].map(u64::from).iter().sum::<u64>();
    let (free, occupied, unknown) =
        (stats.free_cells as f32, stats.occupied_cells as f32, stats.unknown_cells as f32);
    let size = [stats.width as f32, stats.height as f32, stats.resolution_m as f32];
    float_array(to, &[free, occupied, unknown, total as f32, size[0], size[1], size[2]]);
}

/// Writes nav_msgs/OccupancyGrid. `values` is [`msg::grid::trinary_table`] or [`msg::grid::percent_table`].
pub fn occupancy_grid(to: &mut Writer<'_>, frame_id: &str, values: &[i8; 256], grid: GridView<'_>) {
    let GridView { header: about, cells } = grid;
    let (position, orientation) = spatial(about.origin);
    let size = (about.width, about.height);
    header(to, about.header.stamp, frame_id);
    map_info(to, about.header.stamp, about.resolution_m as f32, size, position, orientation);
    to.byte_seq_with(cells.len(), |bytes| write_values(bytes, cells, values));
}

/// Writes map_msgs/OccupancyGridUpdate: the cells of `area`, which lies in the grid, as [`occupancy_grid`] has them.
pub fn occupancy_grid_update(
    to: &mut Writer<'_>,
    frame_id: &str,
    values: &[i8; 256],
    grid: GridView<'_>,
    area: IndexRect,
) {
    header(to, grid.header.header.stamp, frame_id);
    to.i32(area.x0 as i32);
    to.i32(area.y0 as i32);
    grid_area(to, values, grid, area);
}

/// Writes width, height and cells of a rectangle of a grid.
pub(crate) fn grid_area(to: &mut Writer<'_>, values: &[i8; 256], grid: GridView<'_>, area: IndexRect) {
    to.u32(area.width() as u32);
    to.u32(area.height() as u32);
    let rows = grid.cells.chunks_exact((grid.header.width as usize).max(1)).skip(area.y0 as usize);
    to.byte_seq_with(area.width() * area.height(), |bytes| {
        for (place, row) in bytes.chunks_exact_mut(area.width().max(1)).zip(rows) {
            write_values(place, &row[area.x0 as usize..area.x1 as usize], values);
        }
    });
}

/// Cells converted together: most of a map is blocks of one value, which are filled without a table look-up each.
const BLOCK: usize = 64;

fn write_values(bytes: &mut [u8], cells: &[i8], values: &[i8; 256]) {
    let of = |cell: i8| values[cell as u8 as usize] as u8;
    let (blocks, rest) = cells.as_chunks::<BLOCK>();
    let (places, rest_places) = bytes.as_chunks_mut::<BLOCK>();
    for (place, block) in places.iter_mut().zip(blocks) {
        let differing = block.iter().fold(0, |bits, cell| bits | (cell ^ block[0]));
        if differing == 0 {
            place.fill(of(block[0]));
        } else {
            place.iter_mut().zip(block).for_each(|(byte, cell)| *byte = of(*cell));
        }
    }
    rest_places.iter_mut().zip(rest).for_each(|(byte, cell)| *byte = of(*cell));
}
