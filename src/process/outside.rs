//! A world that is not simulated here, as the bridge hears of it: its channels are the bridge's to write.

use crate::channel;
use crate::ports::ChannelError;
use crate::run::Run;
use crate::shared_memory::{Participant, Writer};
use ::bridge::world::{Heard, World};
use msg::{Odometry, RobotId, Scan, Transforms};

struct RobotWriters {
    scan: Writer<Scan>,
    odometry: Writer<Odometry>,
    transforms: Writer<Transforms>,
}

impl RobotWriters {
    fn open(node: &Participant, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            scan: node.writer(&channel::scan(robot))?,
            odometry: node.writer(&channel::odometry(robot))?,
            transforms: node.writer(&channel::transforms(robot))?,
        })
    }
}

/// The run's world, which passes on what it hears to the channels a simulator would write.
pub fn world(node: &Participant, run: &Run) -> Result<World, ChannelError> {
    let mut robots =
        run.robots().map(|robot| RobotWriters::open(node, robot)).collect::<Result<Vec<_>, _>>()?;
    let mut clock = node.writer(&channel::clock())?;
    Ok(World::new(run.config.fleet.robots, move |heard| match heard {
        Heard::Scan(robot, scan) => robots[robot.index()].scan.send(scan),
        Heard::Odometry(robot, odometry) => robots[robot.index()].odometry.send(odometry),
        Heard::Transforms(robot, transforms) => robots[robot.index()].transforms.send(transforms),
        Heard::Clock(message) => clock.send(message),
    }))
}
