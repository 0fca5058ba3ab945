//! The navigation process: drives robots to the goals of people and programs.
//!
//! Its velocities go to the bridge, which passes them on like any client's and stops a robot 0.3 s after the last one.
//! While no robot has a goal it reads no sensor, draws no plan and waits for the next command.

mod commands;
mod exploration;
mod holds;
mod inputs;
mod outputs;
pub mod state_file;
mod zones;

use super::heartbeat::{HealthCounters, Heartbeat};
use super::scan_demand::ScanDemandSender;
use super::{Error, Listens, ProcessLoop, serve};
use crate::channel;
use crate::clock::Epoch;
use crate::job_thread::{JobThread, JobWorker};
use crate::ports::{Clock as _, Ports};
use crate::progress::WatchedThread;
use crate::realtime::lower_priority;
use crate::run::Run;
use crate::stop::Stop;
use crate::storage::{DiskStorage, Storage};
use ::nav::{FleetNavigator, GoalFrame, GoalPose, NavigationGoal, NavigationState, NavigatorConfig};
use exploration::Exploration;
use holds::Holds;
use inputs::Inputs;
use msg::{
    Monotonic, NavigationCommand, NavigationFrame, NavigationPose, PauseReason, Pose2, RobotId, Role,
    ScanPurpose,
};
use outputs::{Decision, RobotOutputs};
use state_file::{Found, NavigationFile, SavedGoal, SavedState, StateWriter};
use std::time::Duration;
use zones::Zones;

/// Period of the control loop: 20 Hz, as operators send velocities.
const PERIOD: Duration = Duration::from_millis(50);
/// Niceness of this process (nice(2)): plans take some 10 ms, in which transforms and scans pass it. Where other programs keep all
/// cores busy, it still has a quarter of a core: eight exploring robots take a tenth, and a step that takes longer than 0.3 s stops them.
const NICE: i32 = 5;

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    lower_priority(NICE);
    let participant = run.attach(Role::Nav, None)?;
    let mut process = NavigationProcess::open(&participant, run, DiskStorage, JobThread::start)?;
    serve(&mut process, run.progress(Role::Nav, None, WatchedThread::Main), &|| stop.requested());
    Ok(())
}

/// The navigator with its channels.
// More than 12 fields: the navigator, what it reads and writes, and when it is due.
pub struct NavigationProcess<P: Ports, W> {
    navigator: FleetNavigator,
    inputs: Inputs<P>,
    robots: Vec<RobotChannels<P>>,
    exploration: Exploration<P>,
    zones: Zones<P>,
    holds: Holds<P>,
    saved: StateWriter<W>,
    scan_demand: ScanDemandSender<P>,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    epoch: Epoch,
    /// Moment of the next control step, while a robot has a goal.
    due: Monotonic,
    refused: u64,
    listeners: Vec<P::Listener>,
}

/// Commands of one robot, and where its state goes.
struct RobotChannels<P: Ports> {
    robot: RobotId,
    commands: P::Reader<NavigationCommand>,
    outputs: RobotOutputs<P>,
    /// Number of the newest command; older ones are not applied.
    newest: u64,
    /// Number of the goal's command.
    goal: u64,
    /// Why the newest goal was refused.
    refusal: Option<&'static str>,
    /// Why the goal was paused last.
    pause_reason: PauseReason,
}

impl<P: Ports, W: JobWorker<SavedState, bool>> NavigationProcess<P, W> {
    /// Opens the channels, and goes on with what an earlier process of this run had not ended.
    pub fn open<S: Storage>(
        ports: &P,
        run: &Run,
        storage: S,
        start_files: impl FnOnce(NavigationFile<S>) -> std::io::Result<W>,
    ) -> Result<Self, Error> {
        let file = NavigationFile::new(run, storage);
        let found = file.read();
        let saved = if let Found::State(saved) = &found { Some((**saved).clone()) } else { None };
        let clock = ports.clock();
        let channels = |robot| {
            Ok(RobotChannels {
                robot,
                commands: ports.reader(&channel::goal(robot))?,
                outputs: RobotOutputs::open(ports, robot)?,
                newest: 0,
                goal: 0,
                refusal: None,
                pause_reason: PauseReason::Person,
            })
        };
        let of_robots = run.robots().map(|robot| ports.listener(&channel::goal(robot)));
        let listeners =
            of_robots.chain([ports.listener(&channel::explore()), ports.listener(&channel::zone_command())]);
        let mut process = Self {
            navigator: FleetNavigator::new(NavigatorConfig::of_robots(run.config.slam.map.robot_radius_m)),
            inputs: Inputs::open(ports, run)?,
            robots: run.robots().map(channels).collect::<Result<_, crate::ports::ChannelError>>()?,
            exploration: Exploration::open(ports, run)?,
            zones: Zones::open(ports)?,
            holds: Holds::open(ports, run)?,
            saved: StateWriter::new(start_files(file)?, saved),
            scan_demand: ScanDemandSender::open(ports, run, ScanPurpose::Navigation)?,
            heartbeat: Heartbeat::new(ports, run, Role::Nav, None)?,
            due: clock.now(),
            clock,
            epoch: run.epoch,
            refused: 0,
            listeners: listeners.collect::<Result<_, _>>()?,
        };
        if let Found::State(saved) = found {
            process.restore(*saved);
            return Ok(process);
        }
        if let Err(why) = process.zones.add_furniture(run) {
            tracing::warn!("the room's furniture makes no exclusion zones: {why}");
        }
        match found {
            Found::Lost => process.ignore_earlier_commands(),
            _ if run.config.fleet.explore => process.explore(),
            _ => {}
        }
        // A process that takes this one's place must know that it is not the first.
        process.save();
        Ok(process)
    }

    /// Carries out no command that was sent before now: channels keep those that an earlier process has carried out.
    fn ignore_earlier_commands(&mut self) {
        let now = self.clock.now().0;
        self.robots.iter_mut().for_each(|channels| channels.newest = now);
        self.exploration.ignore_commands_until(now);
        self.zones.ignore_commands_until(now);
    }

    /// Begins to explore without a command.
    fn explore(&mut self) {
        let now = self.clock.now();
        self.exploration.start(&mut self.navigator, now.0, self.epoch.stamp(now));
    }

    /// Goes on with what an earlier process of this run had not ended.
    fn restore(&mut self, saved: SavedState) {
        let now = self.epoch.stamp(self.clock.now());
        for (number, newest) in saved.commands {
            if let Some(channels) = self.robots.iter_mut().find(|channels| channels.robot.number() == number)
            {
                channels.newest = newest;
            }
        }
        self.exploration.restore(&saved.exploration);
        self.zones.restore(&saved.zones);
        self.holds.restore(&saved.holds);
        for saved in saved.goals {
            let Some(channels) =
                self.robots.iter_mut().find(|channels| channels.robot.number() == saved.robot)
            else {
                continue;
            };
            let Ok(goal) = NavigationGoal::new(saved.frame(), saved.poses()) else { continue };
            channels.goal = saved.goal;
            self.navigator.set_goal_from(now, channels.robot, goal, saved.next_pose);
            if let Some(code) = saved.paused {
                channels.pause_reason = PauseReason::from_code(code).unwrap_or_default();
                self.navigator.pause(channels.robot);
            }
        }
    }

    /// Whether there is something to drive for.
    fn is_active(&self) -> bool {
        self.navigator.is_active() || self.exploration.is_active()
    }

    /// One control step of all robots that have goals.
    fn navigate(&mut self, now: Monotonic) {
        self.inputs.receive(now);
        let silent = self.inputs.silent_robots(now);
        let is_silent = |robot: RobotId| silent.contains(&robot);
        let (navigator, inputs, epoch) = (&mut self.navigator, &mut self.inputs, self.epoch);
        let (exploration, zones) = (&mut self.exploration, self.zones.zones());
        self.heartbeat.measure(|| {
            inputs.observe(epoch.stamp(now), now, zones, |input| {
                exploration.step(navigator, input, &is_silent);
                navigator.step(input);
            });
        });
    }

    /// Publishes what was decided; velocities only after a control step, so that none is sent twice.
    fn publish(&mut self, now: Monotonic, is_stepped: bool) {
        let stamp = self.epoch.stamp(now);
        self.exploration.publish(stamp, now);
        self.zones.publish(stamp);
        for channels in &mut self.robots {
            if self.exploration.is_driving(channels.robot) {
                (channels.goal, channels.refusal) = (self.exploration.number(), None);
            }
            let navigation = self.navigator.robots().find(|navigation| navigation.robot == channels.robot);
            let decision = Decision {
                navigation,
                is_stepped,
                has_command: channels.newest != 0,
                goal: channels.goal,
                refusal: channels.refusal,
                pause_reason: channels.pause_reason,
                in_merged_map: self.inputs.is_merged(channels.robot),
                is_exploring: self.exploration.includes(channels.robot),
            };
            channels.outputs.publish(stamp, now, &decision);
        }
    }

    /// Asks for the scans of the robots that are driven, where they are on other machines.
    fn demand_scans(&mut self, now: Monotonic) {
        let (navigator, is_exploring) = (&self.navigator, self.exploration.is_active());
        let is_active = |robot: &RobotId| {
            navigator.robots().any(|navigation| navigation.robot == *robot && navigation.state.is_active())
        };
        let robots = self.robots.iter().map(|channels| channels.robot);
        self.scan_demand.update(robots.filter(|robot| is_exploring || is_active(robot)), now);
    }

    /// Saves the goals that are being driven to, or wait, and the exploration; its own goals are found again.
    fn save(&mut self) {
        let now = self.clock.now();
        let goals = self.robots.iter().filter_map(|channels| {
            let navigation = self.navigator.robots().find(|navigation| navigation.robot == channels.robot)?;
            let goal = self
                .navigator
                .goal(channels.robot)
                .filter(|_| !self.exploration.is_driving(channels.robot))?;
            Some(SavedGoal::new(
                (channels.robot, channels.goal),
                goal,
                navigation.next_pose.unwrap_or(0),
                (navigation.state == NavigationState::Paused).then_some(channels.pause_reason),
            ))
        });
        let state = SavedState {
            commands: self.robots.iter().map(|channels| (channels.robot.number(), channels.newest)).collect(),
            goals: goals.collect(),
            exploration: self.exploration.saved(),
            zones: self.zones.saved(),
            holds: self.holds.saved(),
        };
        self.saved.write(state, now);
    }
}

impl<P: Ports, W: JobWorker<SavedState, bool>> ProcessLoop for NavigationProcess<P, W> {
    fn step(&mut self) -> Monotonic {
        let now = self.clock.now();
        let was_active = self.is_active();
        // A goal that comes after an interruption is not paused by it.
        let mut has_commands = self.pause_interrupted();
        has_commands |= self.receive_commands(now);
        has_commands |= self.pause_held();
        let is_active = self.is_active();
        if is_active && !was_active {
            self.due = now;
        }
        let is_due = is_active && now >= self.due;
        if is_due || has_commands {
            let is_stepped = is_active || was_active;
            if is_stepped {
                self.navigate(now);
            }
            self.publish(now, is_stepped);
            self.demand_scans(now);
            self.save();
            self.due = Monotonic(self.due.0.max(now.0.saturating_sub(PERIOD.as_nanos() as u64))) + PERIOD;
        }
        let counters = HealthCounters { refused: self.refused, ..HealthCounters::default() };
        if now >= self.heartbeat.due() {
            self.robots.iter().for_each(|channels| channels.outputs.refresh());
            // A goal that is paused is reported, too.
            self.publish(now, false);
            self.save();
            self.exploration.refresh();
            self.zones.refresh();
        }
        self.heartbeat.publish_if_due(|| counters);
        if self.is_active() { self.due.min(self.heartbeat.due()) } else { self.heartbeat.due() }
    }
}

impl<P: Ports, W> Listens<P::Listener> for NavigationProcess<P, W> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        self.listeners.iter()
    }
}

/// Poses of a command in the frame of the navigator.
fn goal_poses(poses: &[NavigationPose], frame_from_poses: Pose2) -> Vec<GoalPose> {
    let pose = |pose: &NavigationPose| GoalPose {
        position_m: frame_from_poses.apply([pose.x_m, pose.y_m]),
        yaw_rad: (!pose.yaw_rad.is_nan()).then_some(pose.yaw_rad + frame_from_poses.yaw_rad),
    };
    poses.iter().map(pose).collect()
}

impl<P: Ports> Inputs<P> {
    /// Returns the goal of a command, in the merged map or in the robot's own; or why it is refused.
    fn goal(&self, robot: RobotId, command: &NavigationCommand) -> Result<NavigationGoal, &'static str> {
        const NO_POSE: &str = "where the goal's frame lies is not known yet: no pose of its robot";
        let of = command.frame_robot().unwrap_or(robot);
        let of_from_poses = match command.frame().ok_or("the goal's frame is not known")? {
            NavigationFrame::MergedMap => None,
            NavigationFrame::RobotMap => Some(Pose2::IDENTITY),
            NavigationFrame::Odom => Some(self.robot_map_from_odom(of).ok_or(NO_POSE)?),
            NavigationFrame::Base => Some(self.robot_map_from_base(of).ok_or(NO_POSE)?),
        };
        let (frame, frame_from_poses) = match of_from_poses {
            None => (GoalFrame::MergedMap, Pose2::IDENTITY),
            Some(of_from_poses) if of == robot => (GoalFrame::RobotMap, of_from_poses),
            Some(of_from_poses) => {
                let unknown = "the goal is in another robot's frame, whose map is not merged yet";
                let map_from_of = self.map_from_robot_map(of).ok_or(unknown)?;
                (GoalFrame::MergedMap, map_from_of * of_from_poses)
            }
        };
        NavigationGoal::new(frame, goal_poses(command.poses(), frame_from_poses))
            .map_err(|_| "the goal has no pose, or one that is not finite within 100 km of the origin")
    }
}
