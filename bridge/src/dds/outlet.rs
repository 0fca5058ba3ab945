//! The fleet's messages through the ROS 2 door.

use super::door::Door;
use crate::outlet::Outlet;
use crate::ros::{names, write};
use msg::{
    Clock, Correction, FleetStats, GridView, Link, MapTransforms, Odometry, RobotId, Scan, Transforms,
};

impl Outlet for Door {
    fn scan(&self, robot: RobotId, scan: &Scan) {
        self.of_robot(robot, |door, now| {
            let Some(topic) = door.topics.scan.get(robot.index()) else { return };
            let frame = door.names.link(robot, Link::BaseScan);
            door.out.send(*topic, now, |to| write::laser_scan(to, frame, scan));
        });
    }

    /// What moves goes to /tf; the rest once to /tf_static.
    fn transforms(&self, robot: RobotId, transforms: &Transforms) {
        self.of_robot(robot, |door, now| {
            let Some(fixed_transforms) = door.topics.fixed_transforms else { return };
            let moving = |link: Link| !link.is_fixed();
            door.out.send(door.topics.transforms, now, |to| {
                write::some_transforms(to, &door.names, &[(robot, transforms)], moving);
            });
            if door.fixed[robot.index()].is_none() {
                door.fixed[robot.index()] = Some(*transforms);
                let all = RobotId::first(door.fixed.len()).zip(&door.fixed);
                let seen: Vec<_> = all.filter_map(|(robot, seen)| Some((robot, seen.as_ref()?))).collect();
                door.out.send(fixed_transforms, now, |to| {
                    write::some_transforms(to, &door.names, &seen, Link::is_fixed);
                });
            }
        });
    }

    fn correction(&self, robot: RobotId, correction: &Correction) {
        self.of_robot(robot, |door, now| {
            if door.outside {
                door.now = door.now.max(correction.header.stamp);
            }
            door.out.send(door.topics.transforms, now, |to| {
                write::correction(to, &door.names, robot, correction)
            });
            let frame = door.names.map(robot);
            door.out
                .send(door.topics.pose[robot.index()], now, |to| write::pose_estimate(to, frame, correction));
        });
    }

    fn map_transforms(&self, map_transforms: &MapTransforms) {
        self.with(|door, now| {
            let changed = door.map_transforms.is_none_or(|before| before.robots != map_transforms.robots);
            door.map_transforms = Some(*map_transforms);
            if changed {
                door.send_map_transforms(now);
            }
        });
    }

    fn clock(&self, clock: &Clock) {
        self.with(|door, now| {
            door.now = clock.header.stamp;
            let Some(topic) = door.topics.clock else { return };
            door.out.send(topic, now, |to| write::stamp(to, clock.header.stamp));
        });
    }

    fn odometry(&self, robot: RobotId, odometry: &Odometry) {
        self.of_robot(robot, |door, now| {
            let Some(topic) = door.topics.odometry.get(robot.index()) else { return };
            let (odom, base) =
                (door.names.link(robot, Link::Odom), door.names.link(robot, Link::BaseFootprint));
            door.out.send(*topic, now, |to| {
                write::odometry(to, odom, base, odometry);
            });
        });
    }

    fn map(&self, robot: RobotId, map: GridView<'_>) {
        self.of_robot(robot, |door, now| {
            let frame = door.names.map(robot);
            door.out.send(door.topics.map[robot.index()], now, |to| {
                write::occupancy_grid(to, frame, &door.percent, map);
            });
        });
    }

    fn merged_map(&self, map: GridView<'_>) {
        self.with(|door, now| {
            let topic = door.topics.merged_map;
            door.out.send(topic, now, |to| write::occupancy_grid(to, names::MAP, &door.percent, map));
            door.out.send_as(door.topics.merged_map_as_map, topic, now);
        });
    }

    fn stats(&self, stats: &FleetStats) {
        self.with(|door, now| {
            for (robot, topic) in stats.robots.iter().zip(&door.topics.stats) {
                door.out.send(*topic, now, |to| write::slam_stats(to, robot));
            }
        });
    }

    fn merge_edges(&self, json: &str) {
        self.with(|door, now| {
            let topic = door.topics.merge_edges;
            door.out.send(topic, now, |to| to.string(json));
        });
    }
}
