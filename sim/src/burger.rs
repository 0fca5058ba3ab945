//! Dimensions, masses and limits of the TurtleBot3 Burger.
//!
//! Source: ROBOTIS, `turtlebot3_description/urdf/turtlebot3_burger.urdf` and the e-Manual's table
//! "TurtleBot3 Hardware Specifications" (138 x 178 x 192 mm, 1 kg, 0.22 m/s, 2.84 rad/s).
//! Positions are in `base_footprint`, between the wheels: x forward, y left, z up from the floor.

use glam::Vec3;
use parry3d::math::Pose;
use parry3d::shape::{Compound, SharedShape};

/// Radius of a wheel, metres.
pub const WHEEL_RADIUS_M: f64 = 0.033;
/// Distance between the centres of the wheels, metres.
pub const WHEEL_SEPARATION_M: f64 = 0.160;
/// Largest speed of the real robot, m/s.
pub const LINEAR_MAX_M_S: f64 = 0.22;
/// Largest turning rate of the real robot, rad/s.
pub const ANGULAR_MAX_RAD_S: f64 = 2.84;

/// Position of `base_link` in `base_footprint`, metres.
pub const BASE_LINK_M: [f64; 3] = [0.0, 0.0, 0.010];
/// Position of `base_scan` in `base_link`, metres. The LiDAR's plane is 0.182 m above the floor.
pub const SCAN_IN_BASE_LINK_M: [f64; 3] = [-0.032, 0.0, 0.172];
/// Position of `imu_link` in `base_link`, metres.
pub const IMU_IN_BASE_LINK_M: [f64; 3] = [-0.032, 0.0, 0.068];
/// Position of the left wheel in `base_link`, metres. The right wheel has the negative y.
pub const WHEEL_IN_BASE_LINK_M: [f64; 3] = [0.0, 0.080, 0.023];

/// Height of the LiDAR's plane above the floor, metres.
pub const SCAN_HEIGHT_M: f64 = BASE_LINK_M[2] + SCAN_IN_BASE_LINK_M[2];
/// Height of the robot, metres.
pub const HEIGHT_M: f64 = 0.192;
/// Radius of the circle around `base_footprint` that contains the body, metres. It ends at a rear corner.
pub const RADIUS_M: f64 = 0.124;
/// Radius that ROBOTIS's navigation uses, metres: `robot_radius` in `turtlebot3_navigation2/param/burger.yaml`.
/// The corners lie outside of it. The parts that other robots' LiDARs see lie inside.
pub const ROBOT_RADIUS_M: f64 = 0.105;

/// Mass of the body, the LiDAR and the caster, kg.
pub(crate) const CHASSIS_MASS_KG: f32 = 0.825_735 + 0.114 + 0.005;
/// Centre of mass of the chassis, metres. ROBOTIS's model has it above the axle, where the robot would balance
/// on two wheels. Here it is in the middle of the body, where batteries and boards are.
pub(crate) const CHASSIS_CENTRE_M: Vec3 = Vec3::new(-0.032, 0.0, 0.050);
/// Principal moments of inertia of the body, kg m².
pub(crate) const CHASSIS_INERTIA: Vec3 = Vec3::new(2.212e-3, 2.119e-3, 2.006e-3);
/// Mass of a wheel, kg.
pub(crate) const WHEEL_MASS_KG: f32 = 0.028_499;
/// Principal moments of inertia of a wheel, which turns about y, kg m².
pub(crate) const WHEEL_INERTIA: Vec3 = Vec3::new(1.118e-5, 2.071e-5, 1.118e-5);
/// Centre of the caster's ball, metres.
pub(crate) const CASTER_CENTRE_M: Vec3 = Vec3::new(-0.081, 0.0, CASTER_RADIUS_M);
/// Radius of the caster's ball, metres.
pub(crate) const CASTER_RADIUS_M: f32 = 0.006;

/// Centre of the LiDAR's housing, metres. This upright cylinder is the only part in the LiDAR's plane.
pub(crate) const HOUSING_CENTRE_M: Vec3 = Vec3::new(-0.017, 0.0, 0.1755);
/// Radius of the housing, metres.
pub(crate) const HOUSING_RADIUS_M: f32 = 0.055;
/// Half of the housing's height, metres.
pub(crate) const HOUSING_HALF_HEIGHT_M: f32 = 0.015_75;

/// Centres and half sizes of the body's box and of the box around the wheels, metres.
pub(crate) const BOXES_M: [(Vec3, Vec3); 2] = [
    (Vec3::new(-0.032, 0.0, 0.080), Vec3::new(0.070, 0.070, 0.0715)),
    (Vec3::new(0.0, 0.0, 0.039), Vec3::new(0.033, 0.089, 0.033)),
];

/// Returns the robot's shape for collisions: the boxes and the housing.
pub(crate) fn hull() -> SharedShape {
    let boxes = BOXES_M
        .map(|(centre, half)| (Pose::from_translation(centre), SharedShape::cuboid(half.x, half.y, half.z)));
    // parry's cylinders stand along y.
    let upright =
        Pose::from_parts(HOUSING_CENTRE_M, glam::Quat::from_rotation_x(core::f32::consts::FRAC_PI_2));
    let housing = SharedShape::cylinder(HOUSING_HALF_HEIGHT_M, HOUSING_RADIUS_M);
    SharedShape::new(Compound::new([&boxes[..], &[(upright, housing)]].concat()))
}
