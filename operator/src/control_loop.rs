//! Control loop that reads the world state, steps the tour and publishes velocities, 20 times a second.

use crate::client::ClientHandle;
use crate::joystick::SimulatedJoystick;
use crate::link_statistics::LinkReport;
use crate::report::{ExplorationReport, MapReport, OperatorReport, RobotReport};
use crate::world_state::{RobotState, decode_maps};
use crate::{OperatorArgs, OperatorError, SharedReceived, lock, stamp_at};
use bridge::{RobotNames, ros};
use msg::RobotId;
use nav::{DriveCommand, ExplorationTour, FleetObservation, RobotObservation, TourConfig, Twist};
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Period of the loop: a headset sends its stick at 20 Hz.
const PERIOD: Duration = Duration::from_millis(50);
/// Time between two requests for the topics, as the connector waits.
const TOPICS_PERIOD: Duration = Duration::from_secs(5);
/// Shortest time between two selections of the same robot, so that two operators do not select in turn at 20 Hz.
const RESELECT_PERIOD: Duration = Duration::from_secs(1);
/// Default length of a turn, seconds: at least what one or two goals take, at most what keeps the others waiting.
const TURN_MIN_S: f64 = 8.0;
const TURN_MAX_S: f64 = 20.0;
/// Turns that each robot should get if the length of the run is known.
const TURNS: f64 = 3.0;

/// The robot selected last by this client.
#[derive(Clone, Copy)]
struct Selection {
    robot: RobotId,
    /// The bridge forgets a client's registrations with its connection.
    connection: u64,
    at: Instant,
}

/// Drives the robots of a fleet.
pub(crate) struct ControlLoop<'a> {
    args: &'a OperatorArgs,
    handle: ClientHandle,
    names: &'a RobotNames,
    received: &'a SharedReceived,
    epoch: Instant,
    joystick: SimulatedJoystick,
    tour: Option<ExplorationTour>,
    robots: BTreeSet<RobotId>,
    selection: Option<Selection>,
    /// Number of velocities published since the start, for the report.
    published: u64,
    commands: Vec<DriveCommand>,
}

impl<'a> ControlLoop<'a> {
    pub(crate) fn new(
        args: &'a OperatorArgs,
        handle: ClientHandle,
        names: &'a RobotNames,
        received: &'a SharedReceived,
        epoch: Instant,
    ) -> Self {
        Self {
            args,
            handle,
            names,
            received,
            epoch,
            joystick: SimulatedJoystick::default(),
            tour: None,
            robots: BTreeSet::new(),
            selection: None,
            published: 0,
            commands: Vec::new(),
        }
    }

    /// Drives until `stop` or the end of the run, then stops the robots.
    pub(crate) fn run(&mut self, stop: &AtomicBool) {
        let end =
            self.args.seconds.and_then(|s| self.epoch.checked_add(Duration::try_from_secs_f64(s).ok()?));
        let mut tick = self.epoch;
        let mut topics_requested = self.epoch;
        if let Some(count) = self.args.robots {
            self.add_robots(RobotId::first(usize::from(count).min(self.names.count())).collect());
        }
        while !stop.load(Ordering::Relaxed) && end.is_none_or(|end| tick < end) {
            if tick.duration_since(topics_requested) >= TOPICS_PERIOD {
                self.handle.request_topics();
                topics_requested = tick;
            }
            self.step(tick);
            // A late tick is skipped, because two commands at once are of no use.
            let now = Instant::now();
            tick += PERIOD;
            match tick.checked_duration_since(now) {
                Some(rest) => std::thread::sleep(rest),
                None => tick = now,
            }
        }
        self.stop_robots();
    }

    /// One period: state in, one velocity for each robot driven out.
    fn step(&mut self, now: Instant) {
        // Decoding a map takes milliseconds; the receiving thread is not blocked meanwhile.
        let encoded_maps = lock(self.received).world.take_encoded_maps();
        let maps = decode_maps(encoded_maps);
        let (states, selected, is_emergency_stopped, listed) = {
            let mut received = lock(self.received);
            received.world.store_maps(maps);
            let at = stamp_at(self.epoch, Instant::now());
            let states: Vec<RobotState> =
                self.robots.iter().map(|robot| received.world.robot(at, *robot)).collect();
            let listed = self.args.robots.is_none().then(|| received.listed_robots.clone());
            let world = &received.world;
            (states, world.selected_robot(), world.is_emergency_stopped(), listed)
        };
        self.add_robots(listed.unwrap_or_default());
        let Some(tour) = &mut self.tour else { return };
        let robots: Vec<RobotObservation> = states.iter().map(RobotState::observation).collect();
        let stamp = stamp_at(self.epoch, Instant::now());
        let observation = FleetObservation { stamp, robots: &robots };
        let mut commands = core::mem::take(&mut self.commands);
        if self.args.all_at_once {
            tour.step_all(&observation, &mut commands);
        } else {
            commands.clear();
            commands.push(tour.step_in_turn(&observation));
        }
        for command in &commands {
            let twist = self.joystick.drive(stamp, command);
            let twist = if is_emergency_stopped { Twist::STOP } else { twist };
            self.publish_velocity(now, DriveCommand { twist, ..*command }, selected);
        }
        self.commands = commands;
    }

    /// Adds robots to the tour and registers their topics.
    fn add_robots(&mut self, robots: BTreeSet<RobotId>) {
        for robot in robots {
            if !self.robots.insert(robot) {
                continue;
            }
            let topic = |rest| self.names.topic(robot, rest);
            self.handle.subscribe(&topic("scan"), "sensor_msgs/LaserScan");
            self.handle.subscribe(&topic("map"), "nav_msgs/OccupancyGrid");
            self.handle.subscribe(&topic("slam_stats"), "std_msgs/Float32MultiArray");
            self.handle.advertise::<ros::Twist>(&velocity_topic(robot));
            match &mut self.tour {
                Some(tour) => tour.add(robot),
                None => self.tour = ExplorationTour::new(self.tour_config(), [robot]),
            }
        }
        if let Some(tour) = &mut self.tour {
            tour.set_time_slice_s(time_slice_s(self.args, self.robots.len()));
        }
    }

    fn tour_config(&self) -> TourConfig {
        TourConfig { time_slice_s: time_slice_s(self.args, 1), seed: self.args.seed, ..TourConfig::default() }
    }

    /// Publishes a velocity on the robot's own topic: `/cmd_vel` would drive the robot that another client has selected meanwhile.
    fn publish_velocity(&mut self, now: Instant, command: DriveCommand, selected: Option<i32>) {
        let DriveCommand { robot, twist: Twist { linear_m_s, angular_rad_s } } = command;
        let twist = ros::Twist { linear: [linear_m_s, 0.0, 0.0], angular: [0.0, 0.0, angular_rad_s] };
        if !self.args.all_at_once {
            self.select_robot(now, robot, selected);
        }
        let is_published = self.handle.publish(&velocity_topic(robot), &twist);
        self.published += u64::from(is_published);
    }

    /// Selects a robot if the bridge has to be told: others see then which one is driven.
    fn select_robot(&mut self, now: Instant, robot: RobotId, selected: Option<i32>) {
        let connection = self.handle.connections();
        let own = self.selection.filter(|own| own.robot == robot && own.connection == connection);
        let since = own.map_or(Duration::MAX, |own| now.saturating_duration_since(own.at));
        let is_other_selected = selected.is_some_and(|number| number != robot.number() as i32);
        if own.is_none() || (is_other_selected && since >= RESELECT_PERIOD) {
            self.selection = Some(Selection { robot, connection, at: now });
            self.handle.publish("/selected_robot", &ros::Int32(robot.number() as i32));
        }
    }

    /// Stops every robot that this operator drives.
    fn stop_robots(&mut self) {
        let stop = ros::Twist::default();
        let driven = self.selection.map(|selection| selection.robot);
        for robot in self.robots.iter().filter(|robot| self.args.all_at_once || driven == Some(**robot)) {
            self.handle.publish(&velocity_topic(*robot), &stop);
        }
    }

    pub(crate) fn report(self, address: String, link: LinkReport) -> Result<OperatorReport, OperatorError> {
        let received = lock(self.received);
        let Some(tour) = self.tour else {
            return Err(OperatorError::NoRobots { address, topics: received.listed_topics });
        };
        let robots = tour.stats().map(|stats| RobotReport {
            robot: stats.robot.number(),
            turns: stats.turns,
            held_s: stats.held_s,
            did: ExplorationReport::from(stats.exploration),
        });
        Ok(OperatorReport {
            address,
            seconds: self.epoch.elapsed().as_secs_f64(),
            robots: robots.collect(),
            commands: self.published,
            map: received.world.merged_map().map(|map| MapReport::of(&map)),
            link,
            not_permitted: received.not_permitted.clone(),
            notices: received.server_texts.iter().cloned().collect(),
        })
    }
}

fn velocity_topic(robot: RobotId) -> String {
    format!("/cmd_vel_{}", robot.number())
}

/// Returns the length of a turn: from the arguments, or such that every robot gets three turns, within bounds.
fn time_slice_s(args: &OperatorArgs, robots: usize) -> f64 {
    let fitting_s = args.seconds.map_or(TURN_MAX_S, |seconds| seconds / (TURNS * robots as f64));
    args.turn_seconds.unwrap_or(fitting_s.clamp(TURN_MIN_S, TURN_MAX_S))
}
