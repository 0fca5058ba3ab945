//! The TurtleBot3 Burger's figures.
//!
//! Source: ROBOTIS, `turtlebot3_description/urdf/turtlebot3_burger.urdf` and the e-Manual's table
//! "TurtleBot3 Hardware Specifications" (138 x 178 x 192 mm, 1 kg, 0.22 m/s, 2.84 rad/s).
//! All in `base_footprint`: x forward, y left, z up from the floor, between the wheels.

use glam::Vec3;
use parry3d::math::Pose;
use parry3d::shape::{Compound, SharedShape};

/// Radius of a wheel, metres.
pub const WHEEL_RADIUS_M: f64 = 0.033;
/// Distance between the wheels' middles, metres.
pub const WHEEL_SEPARATION_M: f64 = 0.160;
/// The fastest the real robot drives, m/s.
pub const LINEAR_MAX_M_S: f64 = 0.22;
/// The fastest the real robot turns, rad/s.
pub const ANGULAR_MAX_RAD_S: f64 = 2.84;

/// `base_footprint` from `base_link`.
pub const BASE_LINK_M: [f64; 3] = [0.0, 0.0, 0.010];
/// `base_link` from `base_scan`: the LiDAR looks from 0.182 m above the floor.
pub const SCAN_IN_BASE_LINK_M: [f64; 3] = [-0.032, 0.0, 0.172];
/// `base_link` from `imu_link`.
pub const IMU_IN_BASE_LINK_M: [f64; 3] = [-0.032, 0.0, 0.068];
/// `base_link` from the left wheel; the right one's y is negative.
pub const WHEEL_IN_BASE_LINK_M: [f64; 3] = [0.0, 0.080, 0.023];

/// Height of the LiDAR's plane above the floor, metres.
pub const SCAN_HEIGHT_M: f64 = BASE_LINK_M[2] + SCAN_IN_BASE_LINK_M[2];
/// Height of the robot, metres.
pub const HEIGHT_M: f64 = 0.192;
/// The farthest point of the body from the middle between the wheels, seen from above, metres:
/// a rear corner of the body.
pub const RADIUS_M: f64 = 0.124;
/// What ROBOTIS's navigation takes for its radius: `robot_radius` in
/// `turtlebot3_navigation2/param/burger.yaml`. The corners reach beyond it, what its peers' LiDARs see of it does not.
pub const ROBOT_RADIUS_M: f64 = 0.105;

/// Mass of body, LiDAR and caster, kg.
pub(crate) const CHASSIS_MASS_KG: f32 = 0.825_735 + 0.114 + 0.005;
/// The model puts the centre of mass above the axle, where the robot would balance on two wheels;
/// batteries and boards sit in the middle of the body, behind it.
pub(crate) const CHASSIS_CENTRE_M: Vec3 = Vec3::new(-0.032, 0.0, 0.050);
/// Principal moments of inertia of the body, kg m².
pub(crate) const CHASSIS_INERTIA: Vec3 = Vec3::new(2.212e-3, 2.119e-3, 2.006e-3);
/// Mass of a wheel, kg.
pub(crate) const WHEEL_MASS_KG: f32 = 0.028_499;
/// Principal moments of inertia of a wheel that turns about y, kg m².
pub(crate) const WHEEL_INERTIA: Vec3 = Vec3::new(1.118e-5, 2.071e-5, 1.118e-5);
/// Where the caster's ball is.
pub(crate) const CASTER_CENTRE_M: Vec3 = Vec3::new(-0.081, 0.0, CASTER_RADIUS_M);
/// Radius of the caster's ball, metres.
pub(crate) const CASTER_RADIUS_M: f32 = 0.006;

/// Middle of the LiDAR's housing, an upright cylinder, which alone of the body reaches the LiDAR's plane.
pub(crate) const HOUSING_CENTRE_M: Vec3 = Vec3::new(-0.017, 0.0, 0.1755);
/// Radius of the housing, metres.
pub(crate) const HOUSING_RADIUS_M: f32 = 0.055;
/// Half the height of the housing, metres.
pub(crate) const HOUSING_HALF_HEIGHT_M: f32 = 0.015_75;

/// Middles and half sizes of the body's box and the box around the wheels.
pub(crate) const BOXES_M: [(Vec3, Vec3); 2] = [
    (Vec3::new(-0.032, 0.0, 0.080), Vec3::new(0.070, 0.070, 0.0715)),
    (Vec3::new(0.0, 0.0, 0.039), Vec3::new(0.033, 0.089, 0.033)),
];

/// What bumps into things: the boxes and the housing.
pub(crate) fn hull() -> SharedShape {
    let boxes = BOXES_M
        .map(|(centre, half)| (Pose::from_translation(centre), SharedShape::cuboid(half.x, half.y, half.z)));
    // parry's cylinders stand along y.
    let upright =
        Pose::from_parts(HOUSING_CENTRE_M, glam::Quat::from_rotation_x(core::f32::consts::FRAC_PI_2));
    let housing = SharedShape::cylinder(HOUSING_HALF_HEIGHT_M, HOUSING_RADIUS_M);
    SharedShape::new(Compound::new([&boxes[..], &[(upright, housing)]].concat()))
}
