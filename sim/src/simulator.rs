//! One robot's time, tick by tick.

use crate::body::{Body, upright};
use crate::burger;
use crate::config::{Limits, SimConfig};
use crate::lidar::{Lidar, RangeErrors};
use crate::noise::{Noise, Purpose};
use crate::odometry::WheelOdometry;
use crate::peers::{Peers, SILENT_MAX_S};
use crate::room::{Room, StartError};
use core::f64::consts::FRAC_PI_2;
use core::time::Duration;
use glam::DQuat;
use msg::pose::wrap_angle;
use msg::{
    GroundTruth, Header, Link, LinkTransform, Odometry, Pose2, ROBOTS_MAX, RobotId, Scan, Stamp, Transforms,
    VelocityCommand,
};
use parry3d::math::Pose;
use parry3d::shape::SharedShape;

/// Ticks between two odometry poses and their transforms: 20 Hz.
const ODOMETRY_TICKS: i64 = 5;
/// A touch counts as a new one after so many ticks without.
const APART_TICKS: i64 = 20;

/// One robot in its room.
///
/// Time advances in ticks of 10 ms. Odometry and transforms come with every fifth, scans with some of
/// those; robot k's come k - 1 ticks later than robot 1's, so that a fleet's scans do not all come at once.
pub struct Simulator {
    robot: RobotId,
    limits: Limits,
    obstacles: SharedShape,
    body: Body,
    peers: Peers,
    odometry: WheelOdometry,
    lidar: Lidar,
    /// Ticks since the epoch of the run.
    ticks: i64,
    scan_ticks: i64,
    /// Clamped, and the tick it was given at.
    command: Option<(VelocityCommand, i64)>,
    contacts: u64,
    last_touch: Option<i64>,
    refused: u64,
}

/// What one tick brought. Of each header only the stamp is set: the channel does the rest.
#[derive(Clone, Copy, Debug)]
pub struct Tick {
    /// The run's time after the tick: what /clock says.
    pub stamp: Stamp,
    /// Where the robot is.
    pub truth: GroundTruth,
    /// At 20 Hz.
    pub transforms: Option<Transforms>,
    /// At 20 Hz, with the transforms.
    pub odometry: Option<Odometry>,
    /// At the LiDAR's rate, on a tick that has odometry: call [`Simulator::scan_into`] now.
    pub scan_due: bool,
}

impl Simulator {
    /// One tick: /clock runs at 100 Hz.
    pub const TICK: Duration = Duration::from_millis(10);

    /// Puts a robot into a room at the epoch of the run, standing still.
    ///
    /// # Errors
    /// The configuration makes no sense; the start is not a number, off the floor, or in furniture.
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
        let errors = RangeErrors {
            config: config.noise,
            range: noise(Purpose::Range),
            dropout: noise(Purpose::Dropout),
        };
        let lidar = Lidar::new(config.lidar, errors);
        Ok(Self {
            robot,
            limits: config.limits,
            obstacles: room.obstacles(),
            body: Body::new(room.obstacles(), world_from_start),
            peers: Peers::default(),
            odometry: WheelOdometry::new(&config.noise, noise(Purpose::Odometry)),
            scan_ticks: (100.0 / config.lidar.rate_hz).round() as i64,
            lidar,
            ticks: 0,
            command: None,
            contacts: 0,
            last_touch: None,
            refused: 0,
        })
    }

    /// Sets the run's time, as a simulator does that joins a run under way. Rounded down to a whole
    /// tick, so that all robots of a run tick at the same stamps. Call it before the first step.
    pub fn join_at(&mut self, now: Stamp) {
        self.ticks = now.0.div_euclid(Self::TICK.as_nanos() as i64);
    }

    /// The run's time now.
    pub fn now(&self) -> Stamp {
        Stamp(self.ticks * Self::TICK.as_nanos() as i64)
    }

    /// Takes a wished velocity, valid from now until the timeout of the limits, and clamps it to them.
    /// One that is not a number is refused and counted; the one before stays valid.
    pub fn command(&mut self, command: &VelocityCommand) {
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

    /// Mirrors a peer: the LiDAR sees it and the robot bumps into it, until it is silent for a second.
    /// A truth that is not a number, of the robot itself, or of another time than now (by over a
    /// second) is refused and counted.
    pub fn see(&mut self, peer: RobotId, truth: &GroundTruth) {
        let finite = truth.world_from_base.is_finite()
            && truth.linear_m_s.is_finite()
            && truth.angular_rad_s.is_finite();
        let timely = (self.now() - truth.header.stamp).abs() <= SILENT_MAX_S;
        if finite && timely && peer != self.robot {
            self.peers.see(&mut self.body, peer, truth);
        } else {
            self.refused += 1;
        }
    }

    /// How many commands and truths were refused.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// One tick of [`Simulator::TICK`].
    pub fn step(&mut self) -> Tick {
        let (linear_m_s, angular_rad_s) = self.wished_velocity();
        self.body.drive(linear_m_s, angular_rad_s);
        self.ticks += 1;
        let now = self.now();
        self.peers.advance(&mut self.body, now);
        let before_rad = self.body.world_from_base().yaw_rad;
        let wheels_rad = self.body.step();
        let turned_rad = wrap_angle(self.body.world_from_base().yaw_rad - before_rad);
        self.odometry.advance(wheels_rad, turned_rad);
        self.count_contacts();

        let phase = self.robot.index() as i64;
        let odometry_due = (self.ticks - phase).rem_euclid(ODOMETRY_TICKS) == 0;
        Tick {
            stamp: self.now(),
            truth: self.truth(),
            transforms: odometry_due.then(|| self.transforms()),
            odometry: odometry_due.then(|| self.odometry()),
            scan_due: (self.ticks - phase).rem_euclid(self.scan_ticks) == 0,
        }
    }

    /// Measures at the end of the last tick. Writes all of `scan` but `sent`, `seq` and `run` of its header.
    pub fn scan_into(&mut self, scan: &mut Scan) {
        scan.header.stamp = self.now();
        let mut peers = [Pose::IDENTITY; ROBOTS_MAX];
        let mut count = 0;
        for (slot, world_from_peer) in peers.iter_mut().zip(self.peers.poses()) {
            *slot = upright(world_from_peer);
            count += 1;
        }
        self.lidar.scan_into(scan, &*self.obstacles, self.body.world_from_chassis(), &peers[..count]);
    }

    /// Forward m/s and rad/s that are in force now: zero once the last command is too old.
    fn wished_velocity(&self) -> (f64, f64) {
        let timeout_ticks = (self.limits.command_timeout_s / Self::TICK.as_secs_f64()).round() as i64;
        match self.command {
            Some((command, given)) if self.ticks - given < timeout_ticks => {
                (command.linear_m_s, command.angular_rad_s)
            }
            _ => (0.0, 0.0),
        }
    }

    fn count_contacts(&mut self) {
        if self.body.touches() {
            let apart = self.last_touch.is_none_or(|last| self.ticks - last > APART_TICKS);
            self.contacts += u64::from(apart);
            self.last_touch = Some(self.ticks);
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
        let (way_m, turn_rad) = self.odometry.take_way();
        Odometry {
            header: self.header(),
            odom_from_base: self.odometry.odom_from_base(),
            linear_m_s: way_m / period_s,
            angular_rad_s: turn_rad / period_s,
        }
    }

    fn transforms(&self) -> Transforms {
        let Pose2 { x_m, y_m, yaw_rad } = self.odometry.odom_from_base();
        let [wx, wy, wz] = burger::WHEEL_IN_BASE_LINK_M;
        let [left_rad, right_rad] = self.body.wheel_angles_rad();
        // A wheel's frame lies on its side, z along the axle (URDF: rpy -1.57 0 0), and turns about it.
        let wheel = |angle_rad| DQuat::from_rotation_x(-FRAC_PI_2) * DQuat::from_rotation_z(angle_rad);
        let still = DQuat::IDENTITY;
        let links = [
            link(Link::Odom, Link::BaseFootprint, [x_m, y_m, 0.0], DQuat::from_rotation_z(yaw_rad)),
            link(Link::BaseFootprint, Link::BaseLink, burger::BASE_LINK_M, still),
            link(Link::BaseLink, Link::BaseScan, burger::SCAN_IN_BASE_LINK_M, still),
            link(Link::BaseLink, Link::WheelLeft, [wx, wy, wz], wheel(left_rad)),
            link(Link::BaseLink, Link::WheelRight, [wx, -wy, wz], wheel(right_rad)),
            link(Link::BaseLink, Link::Imu, burger::IMU_IN_BASE_LINK_M, still),
        ];
        let mut transforms =
            Transforms { header: self.header(), len: links.len() as u32, ..Transforms::default() };
        transforms.links[..links.len()].copy_from_slice(&links);
        transforms
    }
}

fn link(parent: Link, child: Link, translation_m: [f64; 3], rotation: DQuat) -> LinkTransform {
    LinkTransform {
        parent: parent as u32,
        child: child as u32,
        translation_m,
        rotation_xyzw: rotation.to_array(),
    }
}
