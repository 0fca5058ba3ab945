//! One run: a method explores a room with a fleet, and what it took.

use crate::burgard::Burgard;
use crate::driver::{Driver, Other, Scene, Task};
use crate::methods::{Coordinated, Greedy, Kind, Method};
use crate::world::{Robot, Starts, World};
use msg::Pose2;
use nav::coordination::{CoordinationPhase, GoalProgress};
use nav::geometry::distance_m;
use nav::{
    CoordinationConfig, DriveCommand, ExplorationTour, FleetExploration, FleetNavigator, FleetObservation,
    NavigatedRobot, NavigationInput, NavigatorConfig, RobotObservation, TourConfig, Twist,
};
use sim::{Room, RoomKind};
use std::time::{Duration, Instant};

/// Coverages whose times are measured.
pub const SHARES: [f64; 3] = [0.90, 0.95, 0.99];
/// Control steps per second.
const STEPS_PER_SECOND: usize = 20;
/// Time between two points of the curve of coverage, seconds.
pub const CURVE_PERIOD_S: usize = 5;

/// Distance from a place from which a robot has left it, metres: more than it moves while it looks around or evades.
const LEFT_PLACE_M: f64 = 0.5;

/// What is run.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub room: RoomKind,
    pub seed: u64,
    pub robots: usize,
    pub starts: Starts,
    pub method: Kind,
    pub limit_s: usize,
    /// Coverage at which a run ends although its method goes on, 0 to 1.
    pub enough: f64,
    /// Parameters of the coordinator.
    pub config: CoordinationConfig,
}

/// What a run took.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub case: Case,
    /// Times of [`SHARES`], seconds.
    pub times_s: [Option<f64>; 3],
    pub end_s: f64,
    pub coverage: f64,
    pub travelled_m: f64,
    pub overlap: f64,
    /// Each contact, with its robot, time and place.
    pub contacts: Vec<String>,
    pub separation_m: f64,
    /// Longest time in which no robot left the place where it was, seconds.
    pub stood_s: f64,
    pub plans: u32,
    pub path_plans: u32,
    /// Time of computation per robot and simulated second, of choosing and of driving, milliseconds.
    pub choose_ms: f64,
    pub drive_ms: f64,
    pub longest_choice_ms: f64,
    /// Coverage every five seconds.
    pub curve: Vec<f32>,
    pub leftovers: Vec<String>,
    pub stopped_by: &'static str,
}

impl Outcome {
    fn new(case: Case) -> Self {
        Self {
            case,
            times_s: [None; 3],
            end_s: 0.0,
            coverage: 0.0,
            travelled_m: 0.0,
            overlap: 0.0,
            contacts: Vec::new(),
            separation_m: 0.0,
            stood_s: 0.0,
            plans: 0,
            path_plans: 0,
            choose_ms: 0.0,
            drive_ms: 0.0,
            longest_choice_ms: 0.0,
            curve: Vec::new(),
            leftovers: Vec::new(),
            stopped_by: "limit",
        }
    }

    /// Records the contacts of the last step, whose velocities are given.
    fn record_contacts(&mut self, at_s: f64, world: &World, twists: &[Twist]) {
        for (robot, twist) in world.robots.iter().zip(twists).filter(|(robot, _)| robot.new_contacts > 0) {
            let Pose2 { x_m, y_m, yaw_rad } = robot.pose();
            let contact = format!(
                "contact of {} at {at_s:.1} s, x {x_m:.3} m, y {y_m:.3} m, yaw {yaw_rad:.3} rad, commanded {:.3} m/s, {:.2} rad/s",
                robot.id, twist.linear_m_s, twist.angular_rad_s
            );
            self.contacts.extend((0..robot.new_contacts).map(|_| contact.clone()));
        }
    }
}

/// Runs a case. Returns the world at its end too, for pictures.
pub fn run(case: Case) -> Result<(Outcome, World), String> {
    let room = Room::generate(case.room, case.seed);
    let mut world = World::new(&room, case.robots, case.starts, case.seed)?;
    let mut pilot: Box<dyn Pilot> = match case.method {
        Kind::Tour => Box::new(TourPilot::new(case)?),
        Kind::Navigated => Box::new(NavigatorPilot::new(case.config)),
        _ => Box::new(MethodPilot::new(case)),
    };
    let mut outcome = Outcome::new(case);
    let mut twists = vec![Twist::STOP; case.robots];
    let mut standstill = Standstill::new(&world);
    for step in 0..case.limit_s * STEPS_PER_SECOND {
        world.step(&twists);
        outcome.record_contacts(step as f64 / STEPS_PER_SECOND as f64, &world, &twists);
        if step % STEPS_PER_SECOND == 0 {
            let coverage = world.coverage();
            let seconds = step / STEPS_PER_SECOND;
            if seconds.is_multiple_of(CURVE_PERIOD_S) {
                outcome.curve.push(coverage as f32);
            }
            for (share, time) in SHARES.iter().zip(&mut outcome.times_s) {
                if coverage >= *share && time.is_none() {
                    *time = Some(seconds as f64);
                    outcome.overlap = world.overlap();
                }
            }
            outcome.coverage = coverage;
            outcome.end_s = seconds as f64;
            outcome.stood_s = outcome.stood_s.max(standstill.update_s(&world, seconds as f64));
            if coverage >= case.enough {
                outcome.stopped_by = "enough seen";
                break;
            }
        }
        pilot.step(&world, &mut twists);
        if pilot.is_done() {
            outcome.stopped_by = "method";
            break;
        }
    }
    outcome.coverage = world.coverage();
    outcome.travelled_m = world.robots.iter().map(|robot| robot.travelled_m).sum();
    outcome.separation_m = world.separation_m;
    pilot.describe(&mut outcome);
    let robot_seconds = outcome.end_s.max(1.0) * case.robots as f64;
    outcome.choose_ms /= robot_seconds;
    outcome.drive_ms /= robot_seconds;
    Ok((outcome, world))
}

/// How long no robot of a fleet has left its place.
struct Standstill {
    places_m: Vec<[f64; 2]>,
    since_s: f64,
}

impl Standstill {
    fn new(world: &World) -> Self {
        Self { places_m: Self::places_m(world), since_s: 0.0 }
    }

    fn places_m(world: &World) -> Vec<[f64; 2]> {
        world.robots.iter().map(|robot| [robot.pose().x_m, robot.pose().y_m]).collect()
    }

    /// Looks where the robots are, and returns how long none has left its place, seconds.
    fn update_s(&mut self, world: &World, now_s: f64) -> f64 {
        let now_m = Self::places_m(world);
        let has_left = |(was, is): (&[f64; 2], &[f64; 2])| distance_m(*was, *is) > LEFT_PLACE_M;
        if self.places_m.iter().zip(&now_m).any(has_left) {
            (self.places_m, self.since_s) = (now_m, now_s);
        }
        now_s - self.since_s
    }
}

/// Drives a whole fleet.
trait Pilot {
    fn step(&mut self, world: &World, twists: &mut [Twist]);
    fn is_done(&self) -> bool;
    fn describe(&self, outcome: &mut Outcome);
}

/// A method that chooses goals, and a driver for each robot.
struct MethodPilot {
    method: Box<dyn Method>,
    drivers: Vec<Driver>,
    tasks: Vec<Option<Task>>,
    choosing: Duration,
    longest: Duration,
    driving: Duration,
}

impl MethodPilot {
    fn new(case: Case) -> Self {
        let method: Box<dyn Method> = match case.method {
            Kind::Coordinated | Kind::Tour | Kind::Navigated => Box::new(Coordinated::new(case.config)),
            Kind::Greedy => Box::new(Greedy::new(case.robots)),
            Kind::Burgard => Box::new(Burgard::new(case.robots)),
        };
        Self {
            method,
            drivers: (0..case.robots).map(|_| Driver::new()).collect(),
            tasks: vec![None; case.robots],
            choosing: Duration::ZERO,
            longest: Duration::ZERO,
            driving: Duration::ZERO,
        }
    }
}

impl Pilot for MethodPilot {
    fn step(&mut self, world: &World, twists: &mut [Twist]) {
        let begun = Instant::now();
        let progress: Vec<GoalProgress> = self.drivers.iter().map(|driver| driver.progress).collect();
        self.method.choose(world, &progress, &mut self.tasks);
        let chosen = Instant::now();
        self.choosing += chosen - begun;
        self.longest = self.longest.max(chosen - begun);
        for (index, (driver, robot)) in self.drivers.iter_mut().zip(&world.robots).enumerate() {
            driver.set_task(self.tasks[index].clone());
            let other = |(i, other): (usize, &Robot)| Other {
                position_m: [other.pose().x_m, other.pose().y_m],
                goes_first: i < index,
            };
            let others: Vec<Other> =
                world.robots.iter().enumerate().filter(|(i, _)| *i != index).map(other).collect();
            twists[index] = driver.step(&Scene {
                now: world.now,
                map: world.map_view(),
                pose: robot.pose(),
                scan: robot.scan_view(),
                others: &others,
            });
        }
        self.driving += chosen.elapsed();
    }

    fn is_done(&self) -> bool {
        self.method.is_done()
    }

    fn describe(&self, outcome: &mut Outcome) {
        outcome.plans = self.method.plans();
        outcome.path_plans = self.drivers.iter().map(|driver| driver.plans).sum();
        outcome.leftovers = self.method.leftovers();
        outcome.choose_ms = self.choosing.as_secs_f64() * 1e3;
        outcome.drive_ms = self.driving.as_secs_f64() * 1e3;
        outcome.longest_choice_ms = self.longest.as_secs_f64() * 1e3;
    }
}

/// The scripted tour, which plans and drives by itself.
struct TourPilot {
    tour: ExplorationTour,
    commands: Vec<DriveCommand>,
    driving: Duration,
}

impl TourPilot {
    fn new(case: Case) -> Result<Self, String> {
        let config = TourConfig { seed: case.seed, ..TourConfig::default() };
        let tour = ExplorationTour::new(config, msg::RobotId::first(case.robots)).ok_or("no robots")?;
        Ok(Self { tour, commands: Vec::new(), driving: Duration::ZERO })
    }
}

fn observe<'a>(world: &'a World, robot: &'a Robot) -> RobotObservation<'a> {
    RobotObservation {
        robot: robot.id,
        map: Some(world.map_view()),
        in_merged_map: true,
        map_from_base: Some(robot.pose()),
        scan: robot.scan_view(),
    }
}

impl Pilot for TourPilot {
    fn step(&mut self, world: &World, twists: &mut [Twist]) {
        let robots: Vec<RobotObservation> = world.robots.iter().map(|robot| observe(world, robot)).collect();
        let begun = Instant::now();
        self.tour.step_all(&FleetObservation { stamp: world.now, robots: &robots }, &mut self.commands);
        self.driving += begun.elapsed();
        for command in &self.commands {
            twists[command.robot.index()] = command.twist;
        }
    }

    fn is_done(&self) -> bool {
        false
    }

    fn describe(&self, outcome: &mut Outcome) {
        outcome.drive_ms = self.driving.as_secs_f64() * 1e3;
        outcome.plans = self.tour.stats().map(|stats| stats.exploration.plans).sum();
    }
}

/// The coordinator and the fleet's navigator, as the process `nav` has them.
struct NavigatorPilot {
    exploration: FleetExploration,
    navigator: FleetNavigator,
    choosing: Duration,
    longest: Duration,
    driving: Duration,
}

impl NavigatorPilot {
    fn new(config: CoordinationConfig) -> Self {
        Self {
            exploration: FleetExploration::new(config),
            navigator: FleetNavigator::new(NavigatorConfig::default()),
            choosing: Duration::ZERO,
            longest: Duration::ZERO,
            driving: Duration::ZERO,
        }
    }
}

impl Pilot for NavigatorPilot {
    fn step(&mut self, world: &World, twists: &mut [Twist]) {
        let navigated = |robot| NavigatedRobot {
            observation: observe(world, robot),
            odom_from_base: Some(robot.pose()),
            map_from_robot_map: None,
            uncertainty: None,
        };
        let robots: Vec<NavigatedRobot> = world.robots.iter().map(navigated).collect();
        let input = NavigationInput { stamp: world.now, robots: &robots, exclusion_zones: &[] };
        let begun = Instant::now();
        self.exploration.step(&mut self.navigator, &input, &|_| false);
        let chosen = Instant::now();
        self.choosing += chosen - begun;
        self.longest = self.longest.max(chosen - begun);
        self.navigator.step(&input);
        self.driving += chosen.elapsed();
        twists.fill(Twist::STOP);
        for robot in self.navigator.robots() {
            twists[robot.robot.index()] = robot.twist.unwrap_or(Twist::STOP);
        }
    }

    fn is_done(&self) -> bool {
        self.exploration.phase() != CoordinationPhase::Exploring
    }

    fn describe(&self, outcome: &mut Outcome) {
        outcome.plans = self.exploration.plans();
        outcome.choose_ms = self.choosing.as_secs_f64() * 1e3;
        outcome.drive_ms = self.driving.as_secs_f64() * 1e3;
        outcome.longest_choice_ms = self.longest.as_secs_f64() * 1e3;
    }
}
