//! Simulation of one robot, tick by tick.

use crate::body::{Body, upright_pose};
use crate::burger;
use crate::config::{Limits, SimConfig};
use crate::lidar::{Lidar, RangeNoise, Surroundings};
use crate::moving::Outline;
use crate::moving_bodies::MovingBodies;
use crate::noise::{Noise, NoiseStream};
use crate::odometry::WheelOdometry;
use crate::peers::{Peers, SILENT_MAX_S};
use crate::room::{Room, StartError};
use core::f64::consts::FRAC_PI_2;
use core::time::Duration;
use glam::DQuat;
use msg::pose::wrap_angle;
use msg::{
    GroundTruth, Header, MOVING_OBJECTS_MAX, MovingObjects, Odometry, Pose2, ROBOTS_MAX, RobotFrame,
    RobotFrameTransform, RobotId, Scan, Stamp, Transforms, VelocityCommand,
};
use parry3d::math::Pose;
use parry3d::shape::SharedShape;

/// Ticks between two odometry poses with their transforms: 20 Hz.
const ODOMETRY_TICKS: i64 = 5;
/// Ticks per second, 1 / [`Simulator::TICK`].
const TICKS_PER_SECOND: f64 = 100.0;
/// Ticks without contact after which the next contact counts as a new one: 0.2 s.
const CONTACT_GAP_TICKS: i64 = 20;
/// Ticks in which a robot comes to rest from its full speed, with some to spare: its motors take 14.
const BRAKING_TICKS: usize = 40;

/// Simulation of one robot in a room.
///
/// Time advances in ticks of 10 ms. Every fifth tick has odometry and transforms, and some of these have a
/// scan. Those of robot k are k - 1 ticks later than those of robot 1, which spreads the fleet's scans in time.
///
/// ```
/// use msg::{Pose2, RobotId, Scan, VelocityCommand};
/// use sim::{Room, SimConfig, Simulator};
///
/// let room = Room::laboratory();
/// let start: Pose2 = room.starts(1)?[0];
/// let robot = RobotId::new(1).unwrap();
/// let mut simulator = Simulator::new(&room, &SimConfig::default(), robot, start, 42)?;
/// simulator.set_velocity_command(&VelocityCommand { linear_m_s: 0.1, ..VelocityCommand::default() });
///
/// let mut scan: Scan = bytemuck::Zeroable::zeroed();
/// let mut scans = 0;
/// for _ in 0..20 {
///     let tick = simulator.step();
///     if tick.scan_due {
///         simulator.scan_into(&mut scan);
///         scans += 1;
///     }
/// }
/// assert_eq!((scans, scan.ranges_m().len()), (2, 180));
/// # Ok::<(), sim::StartError>(())
/// ```
// More than 12 fields: each part of the simulation is one field, and the rest is the state of a tick.
pub struct Simulator {
    robot: RobotId,
    limits: Limits,
    obstacles: SharedShape,
    body: Body,
    peers: Peers,
    objects: MovingBodies,
    odometry: WheelOdometry,
    lidar: Lidar,
    /// Ticks since the epoch of the run.
    ticks: i64,
    scan_ticks: i64,
    /// Newest command, clamped, and the tick of its arrival.
    command: Option<(VelocityCommand, i64)>,
    contacts: u64,
    last_contact: Option<i64>,
    refused: u64,
}

/// Results of one tick. Only the stamp of each header is set; the channel sets the other fields.
#[derive(Clone, Copy, Debug)]
pub struct StepOutput {
    /// Time of the run after the tick, as published on /clock.
    pub stamp: Stamp,
    /// True pose of the robot after the tick.
    pub truth: GroundTruth,
    /// Transforms between the robot's frames, at 20 Hz.
    pub transforms: Option<Transforms>,
    /// Odometry with the same stamp as the transforms, at 20 Hz.
    pub odometry: Option<Odometry>,
    /// Whether a scan is due, at the LiDAR's rate. If so, call [`Simulator::scan_into`] before the next step.
    pub scan_due: bool,
}

impl Simulator {
    /// Duration of one tick, so that /clock runs at 100 Hz.
    pub const TICK: Duration = Duration::from_millis(10);

    /// Creates a robot at rest in a room, at the epoch of the run.
    ///
    /// # Errors
    /// The configuration is invalid, or the start is not finite, off the floor, or in furniture.
    pub fn new(
        room: &Room,
        config: &SimConfig,
        robot: RobotId,
        world_from_start: Pose2,
        seed: u64,
    ) -> Result<Self, StartError> {
        config.validate()?;
        room.check_start(world_from_start)?;
        let noise = |purpose| Noise::new(seed, robot, purpose);
        let errors = RangeNoise {
            config: config.noise,
            range: noise(NoiseStream::Range),
            dropout: noise(NoiseStream::Dropout),
        };
        let lidar = Lidar::new(config.lidar, errors);
        Ok(Self {
            robot,
            limits: config.limits,
            obstacles: room.obstacles(),
            body: Body::new(room.obstacles(), world_from_start),
            peers: Peers::default(),
            objects: MovingBodies::default(),
            odometry: WheelOdometry::new(&config.noise, noise(NoiseStream::Odometry)),
            scan_ticks: (TICKS_PER_SECOND / config.lidar.rate_hz).round() as i64,
            lidar,
            ticks: 0,
            command: None,
            contacts: 0,
            last_contact: None,
            refused: 0,
        })
    }

    /// Sets the time of the run, for a simulator that joins a running fleet. The time is rounded down to a
    /// whole tick, so that all robots of a run tick at the same stamps. Call it before the first step.
    pub fn set_time(&mut self, now: Stamp) {
        self.ticks = now.0.div_euclid(Self::TICK.as_nanos() as i64);
    }

    /// Skips the time until `now`, for a simulator that was stopped for over `BRAKING_TICKS`. The robot comes to rest
    /// meanwhile: its command is not valid any more.
    pub fn skip_to(&mut self, now: Stamp) {
        self.stop();
        for _ in 0..BRAKING_TICKS {
            self.step();
        }
        self.set_time(now);
    }

    /// Returns the current time of the run.
    pub fn now(&self) -> Stamp {
        Stamp(self.ticks * Self::TICK.as_nanos() as i64)
    }

    /// Sets the commanded velocity, clamped to the limits. It is valid until the timeout of the limits. A
    /// command that is not finite is refused and counted; the previous command stays valid.
    pub fn set_velocity_command(&mut self, command: &VelocityCommand) {
        if !(command.linear_m_s.is_finite() && command.angular_rad_s.is_finite()) {
            self.refused += 1;
            return;
        }
        let Limits { linear_m_s, angular_rad_s, .. } = self.limits;
        let clamped = VelocityCommand {
            linear_m_s: command.linear_m_s.clamp(-linear_m_s, linear_m_s),
            angular_rad_s: command.angular_rad_s.clamp(-angular_rad_s, angular_rad_s),
            ..*command
        };
        self.command = Some((clamped, self.ticks));
    }

    /// Makes the newest command invalid: the robot stops.
    pub fn stop(&mut self) {
        self.command = None;
    }

    /// Sets the pose of a peer, which the LiDAR sees and the robot collides with. A peer without a message
    /// for a second is removed. A message that is not finite, is of the robot itself, or differs from the
    /// current time by over a second is refused and counted.
    pub fn update_peer(&mut self, peer: RobotId, truth: &GroundTruth) {
        let finite = truth.world_from_base.is_finite()
            && truth.linear_m_s.is_finite()
            && truth.angular_rad_s.is_finite();
        let timely = (self.now() - truth.header.stamp).abs() <= SILENT_MAX_S;
        if finite && timely && peer != self.robot {
            self.peers.update(&mut self.body, peer, truth);
        } else {
            self.refused += 1;
        }
    }

    /// Sets where people, doors and boxes are, which the LiDAR sees and the robot collides with. Without newer messages they stand.
    /// A message with invalid values, or over a second ahead of the current time, is refused and counted.
    pub fn update_objects(&mut self, objects: &MovingObjects) {
        let now = self.now();
        self.refused += u64::from(!self.objects.update(&mut self.body, objects, now));
    }

    /// Returns the number of refused commands and messages of peers.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Simulates one tick of [`Simulator::TICK`].
    pub fn step(&mut self) -> StepOutput {
        let (linear_m_s, angular_rad_s) = self.commanded_velocity();
        self.body.set_velocity(linear_m_s, angular_rad_s);
        self.ticks += 1;
        let now = self.now();
        self.peers.advance(&mut self.body, now);
        self.objects.advance(&mut self.body, now);
        let before_rad = self.body.world_from_base().yaw_rad;
        let wheels_rad = self.body.step();
        let turned_rad = wrap_angle(self.body.world_from_base().yaw_rad - before_rad);
        self.odometry.advance(wheels_rad, turned_rad);
        self.count_contacts();

        let phase = self.robot.index() as i64;
        let odometry_due = (self.ticks - phase).rem_euclid(ODOMETRY_TICKS) == 0;
        StepOutput {
            stamp: self.now(),
            truth: self.truth(),
            transforms: odometry_due.then(|| self.transforms()),
            odometry: odometry_due.then(|| self.odometry()),
            scan_due: (self.ticks - phase).rem_euclid(self.scan_ticks) == 0,
        }
    }

    /// Measures a scan at the end of the last tick. Writes all of `scan` except `sent`, `seq` and
    /// `incarnation` of its header.
    pub fn scan_into(&mut self, scan: &mut Scan) {
        scan.header.stamp = self.now();
        let mut peers = [Pose::IDENTITY; ROBOTS_MAX];
        let mut count = 0;
        for (slot, world_from_peer) in peers.iter_mut().zip(self.peers.poses()) {
            *slot = upright_pose(world_from_peer);
            count += 1;
        }
        let mut objects = [Outline::disc([0.0; 2], 0.0); MOVING_OBJECTS_MAX];
        let mut object_count = 0;
        for (slot, outline) in objects.iter_mut().zip(self.objects.outlines()) {
            *slot = outline;
            object_count += 1;
        }
        let surroundings = Surroundings {
            room: &*self.obstacles,
            world_from_peers: &peers[..count],
            objects: &objects[..object_count],
        };
        self.lidar.scan_into(scan, self.body.world_from_chassis(), &surroundings);
    }

    /// Returns the commanded velocity, m/s and rad/s: zero if the newest command is too old.
    fn commanded_velocity(&self) -> (f64, f64) {
        let timeout_ticks = (self.limits.command_timeout_s / Self::TICK.as_secs_f64()).round() as i64;
        match self.command {
            Some((command, given)) if self.ticks - given < timeout_ticks => {
                (command.linear_m_s, command.angular_rad_s)
            }
            _ => (0.0, 0.0),
        }
    }

    fn count_contacts(&mut self) {
        if self.body.touches_obstacle() {
            let is_new = self.last_contact.is_none_or(|last| self.ticks - last > CONTACT_GAP_TICKS);
            self.contacts += u64::from(is_new);
            self.last_contact = Some(self.ticks);
        }
    }

    fn header(&self) -> Header {
        Header { stamp: self.now(), ..Header::default() }
    }

    fn truth(&self) -> GroundTruth {
        let (linear_m_s, angular_rad_s) = self.body.velocity();
        GroundTruth {
            header: self.header(),
            world_from_base: self.body.world_from_base(),
            linear_m_s,
            angular_rad_s,
            contacts: self.contacts,
        }
    }

    fn odometry(&mut self) -> Odometry {
        let period_s = ODOMETRY_TICKS as f64 * Self::TICK.as_secs_f64();
        let (way_m, turn_rad) = self.odometry.take_motion();
        Odometry {
            header: self.header(),
            odom_from_base: self.odometry.odom_from_base(),
            linear_m_s: way_m / period_s,
            angular_rad_s: turn_rad / period_s,
        }
    }

    fn transforms(&self) -> Transforms {
        let [wx, wy, wz] = burger::WHEEL_IN_BASE_LINK_M;
        let [left_rad, right_rad] = self.body.wheel_angles_rad();
        // In the URDF (rpy -1.57 0 0), the z axis of a wheel's frame points along the axle.
        let wheel = |angle_rad| DQuat::from_rotation_x(-FRAC_PI_2) * DQuat::from_rotation_z(angle_rad);
        let [odom, base_link, scan, imu] = transforms_without_wheels(self.odometry.odom_from_base());
        let left =
            frame_transform(RobotFrame::BaseLink, RobotFrame::WheelLeft, [wx, wy, wz], wheel(left_rad));
        let right =
            frame_transform(RobotFrame::BaseLink, RobotFrame::WheelRight, [wx, -wy, wz], wheel(right_rad));
        transforms_message(self.header(), &[odom, base_link, scan, left, right, imu])
    }
}

/// Returns the transforms of a robot whose odometry alone is known, as of a recorded one: those of its wheels are left out.
pub fn transforms_of(odometry: &Odometry) -> Transforms {
    transforms_message(odometry.header, &transforms_without_wheels(odometry.odom_from_base))
}

/// Transforms from `odom` to the base, from there to the chassis, and from the chassis to the LiDAR and to the IMU.
fn transforms_without_wheels(odom_from_base: Pose2) -> [RobotFrameTransform; 4] {
    let Pose2 { x_m, y_m, yaw_rad } = odom_from_base;
    let (turned, still) = (DQuat::from_rotation_z(yaw_rad), DQuat::IDENTITY);
    [
        frame_transform(RobotFrame::Odom, RobotFrame::BaseFootprint, [x_m, y_m, 0.0], turned),
        frame_transform(RobotFrame::BaseFootprint, RobotFrame::BaseLink, burger::BASE_LINK_M, still),
        frame_transform(RobotFrame::BaseLink, RobotFrame::BaseScan, burger::SCAN_IN_BASE_LINK_M, still),
        frame_transform(RobotFrame::BaseLink, RobotFrame::Imu, burger::IMU_IN_BASE_LINK_M, still),
    ]
}

fn transforms_message(header: Header, list: &[RobotFrameTransform]) -> Transforms {
    let mut message = Transforms { header, len: list.len() as u32, ..Transforms::default() };
    message.transforms[..list.len()].copy_from_slice(list);
    message
}

fn frame_transform(
    parent: RobotFrame,
    child: RobotFrame,
    translation_m: [f64; 3],
    rotation: DQuat,
) -> RobotFrameTransform {
    RobotFrameTransform {
        parent_frame: parent as u32,
        child_frame: child as u32,
        translation_m,
        rotation_xyzw: rotation.to_array(),
    }
}
