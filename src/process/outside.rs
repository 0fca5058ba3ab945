//! The channels of an external world: the bridge writes what the simulators write elsewhere.

use crate::channel;
use crate::run::Run;
use crate::shared_memory::{ChannelError, Node, Writer};
use ::bridge::world::{ExternalWorld, WorldMessage};
use msg::{Odometry, RobotId, Scan, Transforms};

struct RobotWriters {
    scan: Writer<Scan>,
    odometry: Writer<Odometry>,
    transforms: Writer<Transforms>,
}

impl RobotWriters {
    fn open(node: &Node, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            scan: node.writer(&channel::scan(robot))?,
            odometry: node.writer(&channel::odometry(robot))?,
            transforms: node.writer(&channel::transforms(robot))?,
        })
    }
}

/// Opens the channels and returns the world that writes accepted messages to them.
pub fn open_world(node: &Node, run: &Run) -> Result<ExternalWorld, ChannelError> {
    let mut robots =
        run.robots().map(|robot| RobotWriters::open(node, robot)).collect::<Result<Vec<_>, _>>()?;
    let mut clock = node.writer(&channel::clock())?;
    Ok(ExternalWorld::new(run.config.fleet.robots, move |message| match message {
        WorldMessage::Scan(robot, scan) => robots[robot.index()].scan.send(scan),
        WorldMessage::Odometry(robot, odometry) => robots[robot.index()].odometry.send(odometry),
        WorldMessage::Transforms(robot, transforms) => robots[robot.index()].transforms.send(transforms),
        WorldMessage::Clock(message) => clock.send(message),
    }))
}
