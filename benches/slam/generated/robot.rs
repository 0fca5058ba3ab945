//! A robot drawn from a seed: its LiDAR, its odometry, how often it scans, and what happens to it on the way.

use super::building::{Building, Point, Wall, distance};
use crate::noise::Noise;
use core::f64::consts::TAU;
use msg::{Pose2, pose::wrap_angle};

/// Speed of the robot, m/s and rad/s.
const SPEED_M_S: f64 = 0.5;
const TURN_RAD_S: f64 = 1.0;
/// Period of the simulation and of live scans, seconds.
const TICK_S: f64 = 0.1;
/// Share of the beams that come back from glass.
const GLASS_RETURNS: f64 = 0.1;
const PERSON_RADIUS_M: f64 = 0.2;
const PERSON_SPEED_M_S: f64 = 1.0;
/// Length of a period without scans, without odometry, or of blindness, seconds.
const PERIOD_S: f64 = 3.0;

/// A LiDAR.
#[derive(Clone, Copy, Debug)]
pub struct Sensor {
    /// Name in tables.
    pub name: &'static str,
    /// Number of beams.
    pub beams: usize,
    /// Field of view, degrees.
    pub view_deg: f64,
    /// Largest range, metres.
    pub range_m: f64,
    /// Standard deviation of a range, metres.
    pub noise_m: f64,
}

/// The sensors: the paper's, TurtleBot3's, a RPLIDAR, a SICK LMS, a Hokuyo, and one of a narrow view.
pub const SENSORS: [Sensor; 6] = [
    Sensor { name: "90 deg, 3.5 m, 91 beams", beams: 91, view_deg: 90.0, range_m: 3.5, noise_m: 0.01 },
    Sensor { name: "90 deg, 12 m, 181 beams", beams: 181, view_deg: 90.0, range_m: 12.0, noise_m: 0.01 },
    Sensor { name: "360 deg, 3.5 m, 360 beams", beams: 360, view_deg: 360.0, range_m: 3.5, noise_m: 0.01 },
    Sensor { name: "360 deg, 12 m, 360 beams", beams: 360, view_deg: 360.0, range_m: 12.0, noise_m: 0.02 },
    Sensor { name: "180 deg, 80 m, 181 beams", beams: 181, view_deg: 180.0, range_m: 80.0, noise_m: 0.01 },
    Sensor { name: "270 deg, 30 m, 1081 beams", beams: 1081, view_deg: 270.0, range_m: 30.0, noise_m: 0.02 },
];

/// What odometry gets wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OdometryKind {
    /// Noise of good wheels.
    Clean,
    /// Distances and turns are up to 5 % too long or too short.
    Scaled,
    /// The heading runs away by 0.02 rad/m.
    Drifting,
    /// Wheels turn without moving the robot now and then.
    Slipping,
    /// It is missing for seconds.
    Missing,
    /// There is none.
    None,
}

impl OdometryKind {
    /// All kinds.
    pub const ALL: [Self; 6] =
        [Self::Clean, Self::Scaled, Self::Drifting, Self::Slipping, Self::Missing, Self::None];
}

/// What happens on the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Nothing.
    Nothing,
    /// No scan comes for some seconds while the robot drives on.
    Gap,
    /// The robot is pushed by some decimetres, which its wheels do not measure.
    Pushed,
    /// The robot is carried some metres along its route, and sees nothing meanwhile.
    Carried,
    /// Nothing is recorded for as long as it takes to carry the robot, and it stands. Not drawn: asked for by `--logs stood`.
    Stood,
    /// The LiDAR sees nothing for some seconds while the robot drives on.
    Blind,
}

impl Event {
    /// All events that are drawn.
    pub const ALL: [Self; 5] = [Self::Nothing, Self::Gap, Self::Pushed, Self::Carried, Self::Blind];
}

/// A robot and its run.
#[derive(Clone, Copy, Debug)]
pub struct Robot {
    /// Its LiDAR.
    pub sensor: Sensor,
    /// Its odometry.
    pub odometry: OdometryKind,
    /// What happens to it.
    pub event: Event,
    /// Distance between scans, metres; 0: ten scans a second.
    pub thinned_m: f64,
    /// Number of people who walk through the building.
    pub people: usize,
    /// Share of beams that do not return.
    pub dropout: f64,
}

/// A scan with the truth.
pub struct Step {
    /// Time, seconds.
    pub stamp_s: f64,
    /// The true pose.
    pub truth: Pose2,
    /// The pose by odometry, if there is one.
    pub odometry: Option<Pose2>,
    /// Ranges, metres; above the sensor's largest range: nothing returned.
    pub ranges_m: Vec<f32>,
}

/// Drives a robot along the building's route.
pub fn drive(building: &Building, robot: &Robot, noise: &mut Noise) -> Vec<Step> {
    let poses = poses_of_route(&building.route);
    let mut wheels = Wheels::new(robot.odometry, noise);
    let mut people: Vec<Person> = (0..robot.people).map(|_| Person::new(building, noise)).collect();
    // The event comes in the middle half of the run.
    let event_at = (poses.len() as f64 * noise.between(0.25, 0.75)) as usize;
    let ticks = (PERIOD_S / TICK_S) as usize;
    let (mut steps, mut last_scan): (Vec<Step>, Option<Pose2>) = (Vec::new(), None);
    let mut push = Pose2::IDENTITY;
    let mut skip = 0;
    let mut waited_s = 0.0;
    for (tick, planned) in poses.iter().enumerate() {
        let during = (event_at..event_at + ticks).contains(&tick);
        if tick == event_at {
            match robot.event {
                Event::Pushed => {
                    push = Pose2::new(
                        noise.between(-0.25, 0.25),
                        noise.between(-0.25, 0.25),
                        noise.between(-0.3, 0.3),
                    );
                }
                Event::Stood => {
                    waited_s = 2.0 * PERIOD_S;
                    (0..2 * ticks)
                        .for_each(|_| people.iter_mut().for_each(|person| person.walk(building, noise)));
                }
                Event::Carried => skip = ticks * 2,
                _ => {}
            }
        }
        people.iter_mut().for_each(|person| person.walk(building, noise));
        if skip > 0 {
            // Its wheels stand while it is carried, and nothing is recorded.
            skip -= 1;
            wheels.forget(*planned * push);
            continue;
        }
        let truth = *planned * push;
        wheels.turn(truth, tick, noise);
        if (robot.event == Event::Gap && during) || !is_due(robot, last_scan, truth) {
            continue;
        }
        last_scan = Some(truth);
        let is_blind = robot.event == Event::Blind && during;
        let ranges_m = scan(building, &people, robot, truth, is_blind, noise);
        let stamp_s = 1.0 + waited_s + tick as f64 * TICK_S;
        steps.push(Step { stamp_s, truth, odometry: wheels.pose(tick), ranges_m });
    }
    steps
}

/// Returns whether a scan is taken here: always, or after some distance or half a radian.
fn is_due(robot: &Robot, last: Option<Pose2>, truth: Pose2) -> bool {
    last.is_none_or(|last| {
        let moved = last.between(truth);
        robot.thinned_m == 0.0 || moved.x_m.hypot(moved.y_m) >= robot.thinned_m || moved.yaw_rad.abs() >= 0.5
    })
}

/// Returns a pose for each tick: the robot turns on the spot at each corner.
fn poses_of_route(route: &[Point]) -> Vec<Pose2> {
    let mut poses: Vec<Pose2> = Vec::new();
    for leg in route.windows(2) {
        let length_m = distance(leg[0], leg[1]);
        if length_m < 1e-6 {
            continue;
        }
        let heading = f64::atan2(leg[1][1] - leg[0][1], leg[1][0] - leg[0][0]);
        if let Some(last) = poses.last().copied() {
            let turn = wrap_angle(heading - last.yaw_rad);
            let ticks = (turn.abs() / (TURN_RAD_S * TICK_S)).ceil() as usize;
            poses.extend((1..=ticks).map(|tick| {
                Pose2::new(last.x_m, last.y_m, wrap_angle(last.yaw_rad + turn * tick as f64 / ticks as f64))
            }));
        }
        let ticks = (length_m / (SPEED_M_S * TICK_S)).ceil() as usize;
        poses.extend((0..=ticks).map(|tick| {
            let share = tick as f64 / ticks as f64;
            let at = [0, 1].map(|axis| leg[0][axis] + share * (leg[1][axis] - leg[0][axis]));
            Pose2::new(at[0], at[1], heading)
        }));
    }
    poses
}

/// The wheels' account of the motion.
struct Wheels {
    kind: OdometryKind,
    scale: [f64; 2],
    odometry: Pose2,
    before: Option<Pose2>,
    slips_until: usize,
    missing_from: usize,
}

impl Wheels {
    fn new(kind: OdometryKind, noise: &mut Noise) -> Self {
        let scaled = kind == OdometryKind::Scaled;
        let mut scale = || if scaled { noise.between(0.95, 1.05) } else { 1.0 };
        let scale = [scale(), scale()];
        let missing_from = 200 + noise.below(600);
        Self { kind, scale, odometry: Pose2::IDENTITY, before: None, slips_until: 0, missing_from }
    }

    fn forget(&mut self, truth: Pose2) {
        self.before = Some(truth);
    }

    fn turn(&mut self, truth: Pose2, tick: usize, noise: &mut Noise) {
        let Some(before) = self.before.replace(truth) else { return };
        let moved = before.between(truth);
        let way_m = moved.x_m.hypot(moved.y_m);
        let drift = if self.kind == OdometryKind::Drifting { 0.02 * way_m } else { 0.0 };
        let mut forward = moved.x_m * self.scale[0] * (1.0 + 0.02 * noise.normal());
        let yaw = moved.yaw_rad * self.scale[1] * (1.0 + 0.02 * noise.normal())
            + drift
            + 0.002 * way_m * noise.normal();
        if self.kind == OdometryKind::Slipping && tick >= self.slips_until && noise.uniform() < 0.003 {
            self.slips_until = tick + 10;
        }
        if tick < self.slips_until {
            // The wheels turn twice as far as the robot moves.
            forward *= 2.0;
        }
        self.odometry = self.odometry * Pose2::new(forward, moved.y_m * self.scale[0], wrap_angle(yaw));
    }

    fn pose(&self, tick: usize) -> Option<Pose2> {
        let ticks = (PERIOD_S / TICK_S) as usize;
        match self.kind {
            OdometryKind::None => None,
            OdometryKind::Missing
                if tick % 1000 >= self.missing_from && tick % 1000 < self.missing_from + ticks =>
            {
                None
            }
            _ => Some(self.odometry),
        }
    }
}

/// A person who walks from place to place along the route.
struct Person {
    at: Point,
    to: Point,
}

impl Person {
    fn new(building: &Building, noise: &mut Noise) -> Self {
        let mut place = || building.route[noise.below(building.route.len())];
        Self { at: place(), to: place() }
    }

    fn walk(&mut self, building: &Building, noise: &mut Noise) {
        let left_m = distance(self.at, self.to);
        let step_m = PERSON_SPEED_M_S * TICK_S;
        if left_m < step_m {
            self.to = building.route[noise.below(building.route.len())];
            return;
        }
        self.at = [0, 1].map(|axis| self.at[axis] + step_m * (self.to[axis] - self.at[axis]) / left_m);
    }
}

fn scan(
    building: &Building,
    people: &[Person],
    robot: &Robot,
    truth: Pose2,
    is_blind: bool,
    noise: &mut Noise,
) -> Vec<f32> {
    let sensor = robot.sensor;
    let nothing = (sensor.range_m + 1.0) as f32;
    if is_blind {
        return vec![nothing; sensor.beams];
    }
    let at = [truth.x_m, truth.y_m];
    let near = |wall: &&Wall| {
        let middle = [0, 1].map(|axis| (wall.from[axis] + wall.to[axis]) / 2.0);
        distance(at, middle) - distance(wall.from, wall.to) / 2.0 < sensor.range_m
    };
    let walls: Vec<&Wall> = building.walls.iter().filter(near).collect();
    (0..sensor.beams)
        .map(|beam| {
            let angle = truth.yaw_rad + beam_angle_rad(sensor, beam);
            let direction = [angle.cos(), angle.sin()];
            let mut range_m = f64::INFINITY;
            for wall in &walls {
                if let Some(hit_m) = hit_wall(at, direction, wall)
                    && hit_m < range_m
                    && (!wall.is_glass || noise.uniform() < GLASS_RETURNS)
                {
                    range_m = hit_m;
                }
            }
            let persons = people.iter().filter_map(|person| hit_circle(at, direction, person.at));
            range_m = persons.fold(range_m, f64::min);
            if range_m > sensor.range_m || noise.uniform() < robot.dropout {
                return nothing;
            }
            (range_m + sensor.noise_m * noise.normal()).max(0.05) as f32
        })
        .collect()
}

/// Returns the angle of a beam from the robot's heading, radians.
pub fn beam_angle_rad(sensor: Sensor, beam: usize) -> f64 {
    let [first, increment] = angles_rad(sensor);
    first + increment * beam as f64
}

/// Returns the angle of the first beam and the angle between two, radians.
pub fn angles_rad(sensor: Sensor) -> [f64; 2] {
    let view = sensor.view_deg.to_radians();
    if view >= TAU - 1e-6 {
        [-view / 2.0, view / sensor.beams as f64]
    } else {
        [-view / 2.0, view / (sensor.beams - 1) as f64]
    }
}

fn hit_wall(at: Point, direction: Point, wall: &Wall) -> Option<f64> {
    let along = [wall.to[0] - wall.from[0], wall.to[1] - wall.from[1]];
    let cross = direction[0] * along[1] - direction[1] * along[0];
    if cross.abs() < 1e-12 {
        return None;
    }
    let offset = [wall.from[0] - at[0], wall.from[1] - at[1]];
    let range_m = (offset[0] * along[1] - offset[1] * along[0]) / cross;
    let share = (offset[0] * direction[1] - offset[1] * direction[0]) / cross;
    (range_m > 0.0 && (0.0..=1.0).contains(&share)).then_some(range_m)
}

fn hit_circle(at: Point, direction: Point, centre: Point) -> Option<f64> {
    let offset = [centre[0] - at[0], centre[1] - at[1]];
    let along = offset[0] * direction[0] + offset[1] * direction[1];
    let aside2 = offset[0].powi(2) + offset[1].powi(2) - along * along;
    let depth2 = PERSON_RADIUS_M * PERSON_RADIUS_M - aside2;
    (along > PERSON_RADIUS_M && depth2 > 0.0).then(|| along - depth2.sqrt())
}
