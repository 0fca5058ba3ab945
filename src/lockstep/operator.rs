//! The operator of a fleet in lockstep: the scripted tour, with the data that a client of the bridge receives.

use crate::channel;
use crate::clock::Epoch;
use crate::ports::{ChannelError, Clock, Ports, ReadMapPort, ReadPort, WritePort};
use crate::process::Component;
use crate::process::heartbeat::{HealthCounters, Heartbeat};
use crate::run::Run;
use msg::{
    Correction, DenseMap, MapTransforms, Monotonic, Odometry, Pose2, RobotId, Role, Scan, VelocityCommand,
};
use nav::{ExplorationTour, FleetObservation, MapView, RobotObservation, ScanView, TourConfig};
use operator::joystick::SimulatedJoystick;
use std::cell::Cell;
use std::rc::Rc;

/// The operator acts at 20 Hz, as a headset's stick is read.
const PERIOD_NS: u64 = 50_000_000;

/// Drives the robots by the scripted tour.
pub struct Operator<P: Ports> {
    tour: Option<ExplorationTour>,
    joystick: SimulatedJoystick,
    together: bool,
    robots: Vec<RobotInputs<P>>,
    merged_map: MapInput<P>,
    map_transforms: P::Reader<MapTransforms>,
    newest_transforms: MapTransforms,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    epoch: Epoch,
    due: Monotonic,
    /// No velocity is sent until then.
    idle_until: Rc<Cell<Monotonic>>,
}

/// A map as the operator receives it.
struct MapInput<P: Ports> {
    reader: P::MapReader,
    grid: DenseMap,
    drawn: bool,
}

impl<P: Ports> MapInput<P> {
    fn new(reader: P::MapReader) -> Self {
        Self { reader, grid: DenseMap::default(), drawn: false }
    }

    fn poll(&mut self) {
        if self.reader.poll() {
            self.grid.update(self.reader.map());
            self.drawn = true;
        }
    }

    fn view(&self) -> Option<MapView<'_>> {
        if self.drawn { MapView::from_log_odds(self.grid.view()) } else { None }
    }
}

/// The data that the operator receives of one robot, and its stick.
struct RobotInputs<P: Ports> {
    robot: RobotId,
    corrections: P::Reader<Correction>,
    odometry: P::Reader<Odometry>,
    scans: P::Reader<Scan>,
    map: MapInput<P>,
    commands: P::Writer<VelocityCommand>,
    map_from_odom: Option<Pose2>,
    odom_from_base: Pose2,
    scan: Option<<P::Reader<Scan> as ReadPort<Scan>>::Received>,
}

impl<P: Ports> Operator<P> {
    /// Opens the channels. `together`: drives all robots at once, not one after the other. No velocity is sent before
    /// `idle_until`.
    pub fn open(
        ports: &P,
        run: &Run,
        together: bool,
        idle_until: Rc<Cell<Monotonic>>,
    ) -> Result<Self, ChannelError> {
        let config = TourConfig { seed: run.config.fleet.seed, ..TourConfig::default() };
        let clock = ports.clock();
        Ok(Self {
            tour: ExplorationTour::new(config, run.robots()),
            joystick: SimulatedJoystick::default(),
            together,
            robots: run.robots().map(|robot| RobotInputs::open(ports, robot)).collect::<Result<_, _>>()?,
            merged_map: MapInput::new(ports.map_reader(&channel::merged_map())?),
            map_transforms: ports.reader(&channel::map_transforms())?,
            newest_transforms: MapTransforms::default(),
            heartbeat: Heartbeat::new(ports, run, Role::Bridge, None)?,
            epoch: run.epoch,
            due: clock.now(),
            clock,
            idle_until,
        })
    }

    fn drive(&mut self) {
        let Some(tour) = &mut self.tour else { return };
        let stamp = self.epoch.stamp(self.clock.now());
        let merged = self.merged_map.view();
        let robots: Vec<RobotObservation<'_>> =
            self.robots.iter().map(|robot| robot.observation(merged, &self.newest_transforms)).collect();
        let observation = FleetObservation { stamp, robots: &robots };
        let mut drive_commands = Vec::new();
        if self.together {
            tour.step_all(&observation, &mut drive_commands);
        } else {
            drive_commands.push(tour.step_in_turn(&observation));
        }
        drop(robots);
        if self.clock.now() < self.idle_until.get() {
            return;
        }
        for drive_command in drive_commands {
            let twist = self.joystick.drive(stamp, &drive_command);
            self.robots[drive_command.robot.index()].commands.send_with(|command| {
                command.header.stamp = stamp;
                command.linear_m_s = twist.linear_m_s;
                command.angular_rad_s = twist.angular_rad_s;
            });
        }
    }
}

impl<P: Ports> Component for Operator<P> {
    fn step(&mut self) -> Monotonic {
        self.merged_map.poll();
        if let Some(transforms) = self.map_transforms.newest() {
            self.newest_transforms = *transforms;
        }
        self.robots.iter_mut().for_each(RobotInputs::poll);
        let now = self.clock.now();
        if now >= self.due {
            self.drive();
            self.due = Monotonic((self.due.0 + PERIOD_NS).max(now.0));
        }
        self.heartbeat.publish_if_due(HealthCounters::default);
        self.due
    }
}

impl<P: Ports> RobotInputs<P> {
    fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            robot,
            corrections: ports.reader(&channel::correction(robot))?,
            odometry: ports.reader(&channel::odometry(robot))?,
            scans: ports.reader(&channel::scan(robot))?,
            map: MapInput::new(ports.map_reader(&channel::map(robot))?),
            commands: ports.writer(&channel::command(robot))?,
            map_from_odom: None,
            odom_from_base: Pose2::IDENTITY,
            scan: None,
        })
    }

    fn poll(&mut self) {
        if let Some(correction) = self.corrections.newest() {
            self.map_from_odom = Some(correction.map_from_odom);
        }
        if let Some(odometry) = self.odometry.newest() {
            self.odom_from_base = odometry.odom_from_base;
        }
        if let Some(scan) = self.scans.newest() {
            self.scan = Some(scan);
        }
        self.map.poll();
    }

    /// Returns the robot for the tour: in its own map while its transform to the merged one is unknown.
    fn observation<'a>(
        &'a self,
        merged: Option<MapView<'a>>,
        transforms: &MapTransforms,
    ) -> RobotObservation<'a> {
        let transform = transforms.robots[self.robot.index()];
        let is_merged = transform.known != 0;
        let map_from_robot_map = if is_merged { transform.map_from_robot_map } else { Pose2::IDENTITY };
        RobotObservation {
            robot: self.robot,
            map: if is_merged { merged } else { self.map.view() },
            in_merged_map: is_merged,
            map_from_base: self
                .map_from_odom
                .map(|map_from_odom| map_from_robot_map * map_from_odom * self.odom_from_base),
            scan: self.scan.as_deref().map(ScanView::from_burger_scan),
        }
    }
}
