//! What the operator has been told by now: the newest transform of each link, scan of each robot, and maps.
//! State, not a queue: what is newer replaces what is older, however slowly it is looked at.

use crate::measures::{Seen, robot_topic};
use bridge::cdr::DecodeError;
use bridge::ros::{self, Bool, FrameNames, Int32, LaserScan, NameStyle, OccupancyGrid, TfMessage};
use msg::{Link, Pose2, ROBOTS_MAX, RobotId, Stamp};
use nav::sight::{BURGER_BASE_FROM_SCAN, MapView, RobotSight, ScanView};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Frames known at one time: 16 robots with 8 each, twice over.
const FRAMES_MAX: usize = 256;
/// From a robot's base up to the map there are three steps; more than this many is a circle.
const STEPS_MAX: usize = 16;
/// A pose not heard of for this long is no pose any more, seconds.
const POSE_AGE_MAX_S: f64 = 1.0;

#[derive(Clone, Debug)]
struct Edge {
    parent: String,
    parent_from_child: Pose2,
    heard: Stamp,
}

/// A map as it came, and as it was read last.
#[derive(Clone, Debug, Default)]
struct MapSlot {
    raw: Option<Vec<u8>>,
    read: Option<Arc<OccupancyGrid>>,
}

impl MapSlot {
    fn put(&mut self, payload: &[u8]) {
        let raw = self.raw.get_or_insert_default();
        raw.clear();
        raw.extend_from_slice(payload);
    }
}

/// Maps to be read while the picture is free for others; `None` is the merged one.
pub type Maps<T> = Vec<(Option<RobotId>, T)>;

/// Reads maps. One that cannot be read is left out: the map before it stands.
pub fn read_maps(raw: Maps<Vec<u8>>) -> Maps<Arc<OccupancyGrid>> {
    let read = |raw: Vec<u8>| ros::decode(&raw).ok().map(Arc::new);
    raw.into_iter().filter_map(|(of, raw)| Some((of, read(raw)?))).collect()
}

/// One robot by the picture: owned, to be laid under a [`RobotSight`].
#[derive(Clone, Debug)]
pub struct RobotPicture {
    /// Which.
    pub robot: RobotId,
    /// The merged map, or the robot's own while that is not merged.
    pub map: Option<Arc<OccupancyGrid>>,
    /// Whether `map` is the merged one.
    pub merged: bool,
    /// The robot in `map`.
    pub map_from_base: Option<Pose2>,
    /// When the newest scan came, and the scan.
    pub scan: Option<(Stamp, Arc<LaserScan>)>,
    /// Where the sensor sits.
    pub base_from_scan: Pose2,
}

impl RobotPicture {
    /// Borrowed, for the policy.
    pub fn sight(&self) -> RobotSight<'_> {
        let map = self.map.as_deref().and_then(|map| {
            let [x_m, y_m, _] = map.position;
            let origin = Pose2::new(x_m, y_m, yaw_rad(map.orientation));
            MapView::percent(origin, f64::from(map.resolution), (map.width, map.height), &map.data)
        });
        let scan = self.scan.as_ref().map(|(seen, scan)| ScanView {
            seen: *seen,
            base_from_scan: self.base_from_scan,
            angle_min_rad: f64::from(scan.angle_min),
            angle_increment_rad: f64::from(scan.angle_increment),
            range_min_m: f64::from(scan.range_min),
            range_max_m: f64::from(scan.range_max),
            ranges_m: &scan.ranges,
        });
        let (robot, merged, map_from_base) = (self.robot, self.merged, self.map_from_base);
        RobotSight { robot, map, merged, map_from_base, scan }
    }
}

/// What has been told. Stamps are the operator's clock at arrival.
#[derive(Clone, Debug)]
pub struct Picture {
    names: [FrameNames; 2],
    edges: BTreeMap<String, Edge>,
    scans: [Option<(Stamp, Arc<LaserScan>)>; ROBOTS_MAX],
    merged: MapSlot,
    own: [MapSlot; ROBOTS_MAX],
    selected: Option<i32>,
    stopped: bool,
}

impl Default for Picture {
    fn default() -> Self {
        Self {
            names: [NameStyle::Flat, NameStyle::Slash].map(FrameNames::new),
            edges: BTreeMap::new(),
            scans: Default::default(),
            merged: MapSlot::default(),
            own: Default::default(),
            selected: None,
            stopped: false,
        }
    }
}

impl Picture {
    /// Takes in a message that was already counted.
    pub fn take(&mut self, now: Stamp, topic: &str, payload: &[u8], seen: Seen) -> Result<(), DecodeError> {
        match (seen, topic) {
            (Seen::Transforms(message), _) => self.take_transforms(now, message),
            (Seen::Scan(robot, scan), _) => self.scans[robot.index()] = Some((now, Arc::new(scan))),
            (Seen::Other, "/merged_map") => self.merged.put(payload),
            (Seen::Other, "/selected_robot") => self.selected = Some(ros::decode::<Int32>(payload)?.0),
            (Seen::Other, "/emergency_stop") => self.stopped = ros::decode::<Bool>(payload)?.0,
            (Seen::Other, topic) => {
                if let Some((robot, "map")) = robot_topic(topic) {
                    self.own[robot.index()].put(payload);
                }
            }
        }
        Ok(())
    }

    /// The link is down: nobody knows any more what is selected.
    pub fn disconnected(&mut self) {
        self.selected = None;
    }

    /// Which robot `/cmd_vel` goes to, if the bridge says so.
    pub fn selected(&self) -> Option<i32> {
        self.selected
    }

    /// Whether the emergency stop is set.
    pub fn stopped(&self) -> bool {
        self.stopped
    }

    /// The maps that came since the last time, as they came.
    pub fn unread_maps(&mut self) -> Maps<Vec<u8>> {
        let merged = self.merged.raw.take().map(|raw| (None, raw));
        let own = RobotId::first(ROBOTS_MAX).zip(&mut self.own);
        let own = own.filter_map(|(robot, slot)| Some((Some(robot), slot.raw.take()?)));
        merged.into_iter().chain(own).collect()
    }

    /// Puts maps in that have been read.
    pub fn put_maps(&mut self, maps: Maps<Arc<OccupancyGrid>>) {
        for (of, map) in maps {
            let slot = of.map_or(&mut self.merged, |robot| &mut self.own[robot.index()]);
            slot.read = Some(map);
        }
    }

    /// The merged map.
    pub fn merged_map(&self) -> Option<Arc<OccupancyGrid>> {
        self.merged.read.clone()
    }

    /// One robot, as known now.
    pub fn robot(&self, now: Stamp, robot: RobotId) -> RobotPicture {
        let in_merged = self.base_in(now, robot, None).filter(|_| self.merged.read.is_some());
        let (map, map_from_base) = match in_merged {
            Some(pose) => (self.merged.read.clone(), Some(pose)),
            None => (self.own[robot.index()].read.clone(), self.base_in(now, robot, Some(robot))),
        };
        RobotPicture {
            robot,
            map,
            merged: in_merged.is_some(),
            map_from_base,
            scan: self.scans[robot.index()].clone(),
            base_from_scan: self.base_from_scan(robot).unwrap_or(BURGER_BASE_FROM_SCAN),
        }
    }

    fn take_transforms(&mut self, now: Stamp, message: TfMessage) {
        for transform in message.transforms {
            let [x_m, y_m, _] = transform.translation;
            let pose = Pose2::new(x_m, y_m, yaw_rad(transform.rotation));
            let known = self.edges.contains_key(&transform.child_frame_id);
            if pose.is_finite() && (known || self.edges.len() < FRAMES_MAX) {
                let edge = Edge { parent: transform.frame_id, parent_from_child: pose, heard: now };
                self.edges.insert(transform.child_frame_id, edge);
            }
        }
    }

    /// The robot's base in the merged map, or in the map of robot `own`.
    fn base_in(&self, now: Stamp, robot: RobotId, own: Option<RobotId>) -> Option<Pose2> {
        self.names.iter().find_map(|names| {
            let base = names.link(robot, Link::BaseFootprint);
            if now - self.edges.get(base)?.heard > POSE_AGE_MAX_S {
                return None;
            }
            self.walk(base, own.map_or(ros::names::MAP, |own| names.map(own)))
        })
    }

    fn base_from_scan(&self, robot: RobotId) -> Option<Pose2> {
        self.names.iter().find_map(|names| {
            self.walk(names.link(robot, Link::BaseScan), names.link(robot, Link::BaseFootprint))
        })
    }

    /// From a frame up to one of its ancestors.
    fn walk(&self, from: &str, to: &str) -> Option<Pose2> {
        let mut frame = from;
        let mut ancestor_from_child = Pose2::IDENTITY;
        for _ in 0..STEPS_MAX {
            if frame == to {
                return Some(ancestor_from_child);
            }
            let edge = self.edges.get(frame)?;
            ancestor_from_child = edge.parent_from_child * ancestor_from_child;
            frame = &edge.parent;
        }
        None
    }
}

/// Of a rotation about z; of any other, that of its projection on the floor.
fn yaw_rad([x, y, z, w]: [f64; 4]) -> f64 {
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bridge::ros::TransformStamped;
    use bridge::ros::write::spatial;

    fn edge(parent: &str, child: &str, pose: Pose2) -> TransformStamped {
        let (translation, rotation) = spatial(pose);
        TransformStamped {
            stamp: Stamp(0),
            frame_id: parent.into(),
            child_frame_id: child.into(),
            translation,
            rotation,
        }
    }

    fn tell(picture: &mut Picture, now_s: f64, transforms: Vec<TransformStamped>) {
        let seen = Seen::Transforms(TfMessage { transforms });
        picture.take(Stamp::from_seconds(now_s), "/tf", &[], seen).unwrap();
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
    fn a_robot_is_placed_in_its_own_map_first_and_in_the_merged_one_once_known() {
        let robot = RobotId::new(2).unwrap();
        let mut picture = Picture::default();
        let (map_from_odom, odom_from_base) = (Pose2::new(1.0, 0.0, 0.5), Pose2::new(0.3, 0.1, -2.0));
        let scan_at = Pose2::new(-0.04, 0.0, 0.0);
        tell(
            &mut picture,
            0.0,
            vec![
                edge("map_2", "odom_2", map_from_odom),
                edge("odom_2", "base_footprint_2", odom_from_base),
                edge("base_footprint_2", "base_link_2", Pose2::IDENTITY),
                edge("base_link_2", "base_scan_2", scan_at),
            ],
        );
        picture.take(Stamp(0), "/robot2/map", &grid(3), Seen::Other).unwrap();
        picture.take(Stamp(0), "/merged_map", &grid(5), Seen::Other).unwrap();
        let maps = read_maps(picture.unread_maps());
        assert_eq!(maps.len(), 2);
        picture.put_maps(maps);
        let alone = picture.robot(Stamp::from_seconds(0.5), robot);
        assert!(!alone.merged && alone.map.as_ref().unwrap().width == 3);
        assert!(alone.map_from_base.unwrap().distance_m(map_from_odom * odom_from_base) < 1e-9);
        assert!(alone.base_from_scan.distance_m(scan_at) < 1e-9);
        assert!(alone.sight().map.is_some());

        let anchor = Pose2::new(-2.0, 3.0, 1.0);
        tell(&mut picture, 0.6, vec![edge("map", "map_2", anchor)]);
        let merged = picture.robot(Stamp::from_seconds(0.7), robot);
        assert!(merged.merged && merged.map.as_ref().unwrap().width == 5);
        let expected = anchor * map_from_odom * odom_from_base;
        assert!(merged.map_from_base.unwrap().distance_m(expected) < 1e-9);

        let stale = picture.robot(Stamp::from_seconds(5.0), robot);
        assert_eq!(stale.map_from_base, None);
    }

    #[test]
    fn survives_nonsense() {
        let robot = RobotId::new(1).unwrap();
        let mut picture = Picture::default();
        // A circle, a frame that is its own parent, a pose that is no number.
        tell(&mut picture, 0.0, vec![edge("odom_1", "base_footprint_1", Pose2::IDENTITY)]);
        tell(&mut picture, 0.0, vec![edge("base_footprint_1", "odom_1", Pose2::IDENTITY)]);
        tell(&mut picture, 0.0, vec![edge("map", "map", Pose2::new(f64::NAN, 0.0, 0.0))]);
        let many = (0..1000).map(|i| edge("a", &format!("f{i}"), Pose2::IDENTITY)).collect();
        tell(&mut picture, 0.0, many);
        assert!(picture.edges.len() <= FRAMES_MAX);
        assert_eq!(picture.robot(Stamp(0), robot).map_from_base, None);
        // A map that cannot be read leaves the one before in place.
        picture.take(Stamp(0), "/merged_map", &grid(2), Seen::Other).unwrap();
        let good = read_maps(picture.unread_maps());
        picture.put_maps(good);
        picture.take(Stamp(0), "/merged_map", &[0, 1, 0, 0, 7], Seen::Other).unwrap();
        let bad = read_maps(picture.unread_maps());
        assert!(bad.is_empty());
        picture.put_maps(bad);
        assert_eq!(picture.merged_map().unwrap().width, 2);
    }

    #[test]
    fn both_styles_of_names() {
        let robot = RobotId::new(1).unwrap();
        let mut picture = Picture::default();
        tell(
            &mut picture,
            0.0,
            vec![
                edge("robot1/map", "robot1/odom", Pose2::IDENTITY),
                edge("robot1/odom", "robot1/base_footprint", Pose2::new(1.0, 0.0, 0.0)),
            ],
        );
        let pose = picture.robot(Stamp(0), robot).map_from_base.unwrap();
        assert!((pose.x_m - 1.0).abs() < 1e-12);
    }
}
