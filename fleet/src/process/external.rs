//! The channels of an external world: the bridge writes them in place of the simulators.

use crate::channel;
use crate::ports::{ChannelError, Ports, WritePort};
use crate::run::Run;
use ::bridge::world::{ExternalWorld, WorldMessage};
use msg::{Battery, Odometry, RobotId, Scan, Transforms};

struct RobotWriters<P: Ports> {
    scan: P::Writer<Scan>,
    odometry: P::Writer<Odometry>,
    transforms: P::Writer<Transforms>,
    battery: P::Writer<Battery>,
}

impl<P: Ports> RobotWriters<P> {
    fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            scan: ports.writer(&channel::scan(robot))?,
            odometry: ports.writer(&channel::odometry(robot))?,
            transforms: ports.writer(&channel::transforms(robot))?,
            battery: ports.writer(&channel::battery(robot))?,
        })
    }
}

/// Opens the channels and returns the world that writes accepted messages to them.
pub fn open_world<P: Ports + 'static>(ports: &P, run: &Run) -> Result<ExternalWorld, ChannelError> {
    let mut robots =
        run.robots().map(|robot| RobotWriters::<P>::open(ports, robot)).collect::<Result<Vec<_>, _>>()?;
    let mut clock = ports.writer(&channel::clock())?;
    Ok(ExternalWorld::new(run.config.robot_names(), move |message| match message {
        WorldMessage::Scan(robot, scan) => robots[robot.index()].scan.send(scan),
        WorldMessage::OdometryRestart(robot) => robots[robot.index()].odometry.begin_anew(),
        WorldMessage::Odometry(robot, odometry) => robots[robot.index()].odometry.send(odometry),
        WorldMessage::Transforms(robot, transforms) => robots[robot.index()].transforms.send(transforms),
        WorldMessage::Battery(robot, battery) => robots[robot.index()].battery.send(battery),
        WorldMessage::Clock(message) => clock.send(message),
    }))
}
