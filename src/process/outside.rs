//! The channels of an external world: the bridge writes them in place of the simulators.

use crate::channel;
use crate::ports::ChannelError;
use crate::run::Run;
use crate::shared_memory::{Participant, Writer};
use ::bridge::world::{ExternalWorld, WorldMessage};
use msg::{Odometry, RobotId, Scan, Transforms};

struct RobotWriters {
    scan: Writer<Scan>,
    odometry: Writer<Odometry>,
    transforms: Writer<Transforms>,
}

impl RobotWriters {
    fn open(participant: &Participant, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            scan: participant.writer(&channel::scan(robot))?,
            odometry: participant.writer(&channel::odometry(robot))?,
            transforms: participant.writer(&channel::transforms(robot))?,
        })
    }
}

/// Opens the channels and returns the world that writes accepted messages to them.
pub fn open_world(participant: &Participant, run: &Run) -> Result<ExternalWorld, ChannelError> {
    let mut robots =
        run.robots().map(|robot| RobotWriters::open(participant, robot)).collect::<Result<Vec<_>, _>>()?;
    let mut clock = participant.writer(&channel::clock())?;
    Ok(ExternalWorld::new(run.config.robot_names(), move |message| match message {
        WorldMessage::Scan(robot, scan) => robots[robot.index()].scan.send(scan),
        WorldMessage::Odometry(robot, odometry) => robots[robot.index()].odometry.send(odometry),
        WorldMessage::Transforms(robot, transforms) => robots[robot.index()].transforms.send(transforms),
        WorldMessage::Clock(message) => clock.send(message),
    }))
}
