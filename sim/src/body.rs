//! Physics of the robot, a differential drive of three rigid bodies on an ideal floor.
//!
//! The bodies are the chassis and two wheels, joined by two revolute joints with velocity motors. The
//! wheels and the caster touch only the floor, a plane at z = 0. The hull touches the room, the peers, and
//! the floor when the robot lies on its side.

use crate::burger::{
    self, ANGULAR_MAX_RAD_S, CASTER_CENTRE_M, CASTER_RADIUS_M, CHASSIS_CENTRE_M, CHASSIS_INERTIA,
    CHASSIS_MASS_KG, LINEAR_MAX_M_S, WHEEL_INERTIA, WHEEL_MASS_KG, WHEEL_RADIUS_M, WHEEL_SEPARATION_M,
};
use core::f64::consts::{PI, TAU};
use glam::{Quat, Vec3};
use msg::Pose2;
use rapier3d::prelude::*;

/// Duration of one physics step, seconds.
pub(crate) const STEP_S: f32 = 0.01;
/// Largest motion of a robot in a step, metres and radians: three times what its wheels can do, as another robot may push it.
const STEP_MAX_M: f32 = 3.0 * LINEAR_MAX_M_S as f32 * STEP_S;
const STEP_MAX_RAD: f32 = 3.0 * ANGULAR_MAX_RAD_S as f32 * STEP_S;
/// Standard gravity, m/s².
const GRAVITY_M_S2: f32 = 9.81;
/// Motor torque per error of a wheel's speed, N m s. The load of driving then reduces a speed by 0.2 %.
const MOTOR_GAIN: f32 = 0.5;
/// Largest torque of a wheel's motor, N m: 1.4 m/s² for the whole robot, half of what would make it slip.
/// The real motors are stronger and limited by their firmware. At an obstacle the simulated motors stall,
/// where the real ones may slip or climb.
const MOTOR_TORQUE_MAX: f32 = 0.025;
/// Coefficient of friction of a rubber tyre on a floor.
const WHEEL_FRICTION: f32 = 1.0;
/// Coefficient of friction of the plastic hull on furniture.
const HULL_FRICTION: f32 = 0.3;

const FLOOR: Group = Group::GROUP_1;
const ROOM: Group = Group::GROUP_2;
const PEER: Group = Group::GROUP_3;
const ROLLING: Group = Group::GROUP_4;
const HULL: Group = Group::GROUP_5;

fn groups(member: Group, touches: Group) -> InteractionGroups {
    InteractionGroups::new(member, touches, InteractionTestMode::And)
}

/// Physics of one robot among the room's obstacles and its peers.
pub(crate) struct Body {
    world: PhysicsWorld,
    chassis: RigidBodyHandle,
    hull: ColliderHandle,
    floor: ColliderHandle,
    /// Left and right wheel.
    wheels: [Wheel; 2],
    /// Last finite poses of chassis, left and right wheel.
    finite_poses: [Pose; 3],
}

#[derive(Clone, Copy)]
struct Wheel {
    body: RigidBodyHandle,
    joint: ImpulseJointHandle,
    /// Angle by which the wheel has turned since the start, radians; unbounded.
    angle_rad: f64,
}

impl Body {
    pub(crate) fn new(obstacles: SharedShape, world_from_base: Pose2) -> Self {
        let mut world = PhysicsWorld::new();
        world.gravity = Vec3::new(0.0, 0.0, -GRAVITY_M_S2);
        world.integration_parameters = solver_parameters();

        let floor = ColliderBuilder::new(SharedShape::halfspace(Vec3::Z))
            .friction(WHEEL_FRICTION)
            .collision_groups(groups(FLOOR, ROLLING | HULL));
        let floor = world.insert_collider(floor, None);
        let room = ColliderBuilder::new(obstacles).collision_groups(groups(ROOM, HULL));
        world.insert_collider(room, None);

        let world_from_chassis = upright_pose(world_from_base);
        let (chassis, hull) = insert_chassis(&mut world, world_from_chassis);
        let wheels = [1.0, -1.0].map(|side| insert_wheel(&mut world, chassis, world_from_chassis, side));
        let finite_poses = [Pose::IDENTITY; 3];
        let mut body = Self { world, chassis, hull, floor, wheels, finite_poses };
        body.save_finite_poses();
        body
    }

    /// Sets the motors' speeds from a velocity of `base_footprint`.
    pub(crate) fn set_velocity(&mut self, linear_m_s: f64, angular_rad_s: f64) {
        for (wheel, side) in self.wheels.iter().zip([-1.0, 1.0]) {
            let rim_m_s = linear_m_s + side * angular_rad_s * WHEEL_SEPARATION_M / 2.0;
            let joint = self.world.impulse_joints.get_mut(wheel.joint, false);
            if let Some(revolute) = joint.and_then(|joint| joint.data.as_revolute_mut()) {
                revolute.set_motor_velocity((rim_m_s / WHEEL_RADIUS_M) as f32, MOTOR_GAIN);
            }
        }
    }

    /// Simulates one physics step of 10 ms. Returns the angles by which the wheels turned: left, right; radians.
    pub(crate) fn step(&mut self) -> [f64; 2] {
        self.world.step();
        self.limit_step();
        if !self.save_finite_poses() {
            self.restore_finite_poses();
        }
        let chassis = self.world_from_chassis().rotation;
        let mut deltas_rad = [0.0; 2];
        for (wheel, delta_rad) in self.wheels.iter_mut().zip(&mut deltas_rad) {
            let turned = chassis.inverse() * self.world.bodies[wheel.body].position().rotation;
            let angle_rad = 2.0 * f64::from(turned.y).atan2(f64::from(turned.w));
            *delta_rad = (angle_rad - wheel.angle_rad + PI).rem_euclid(TAU) - PI;
            wheel.angle_rad += *delta_rad;
        }
        deltas_rad
    }

    /// Returns the pose of `base_footprint` in `world`, in three dimensions.
    pub(crate) fn world_from_chassis(&self) -> Pose {
        *self.world.bodies[self.chassis].position()
    }

    /// Returns the pose of `base_footprint` in `world`, projected onto the floor.
    pub(crate) fn world_from_base(&self) -> Pose2 {
        let pose = self.world_from_chassis();
        let forward = pose.rotation * Vec3::X;
        let yaw_rad = f64::from(forward.y).atan2(f64::from(forward.x));
        Pose2::new(pose.translation.x.into(), pose.translation.y.into(), yaw_rad)
    }

    /// Returns the velocity of `base_footprint`: forward in m/s, and about z in rad/s.
    pub(crate) fn velocity(&self) -> (f64, f64) {
        let chassis = &self.world.bodies[self.chassis];
        let pose = chassis.position();
        let forward = pose.rotation * Vec3::X;
        (chassis.velocity_at_point(pose.translation).dot(forward).into(), chassis.angvel().z.into())
    }

    /// Returns the angles of the left and the right wheel, radians.
    pub(crate) fn wheel_angles_rad(&self) -> [f64; 2] {
        self.wheels.map(|wheel| wheel.angle_rad)
    }

    /// Returns whether the hull touches anything but the floor.
    pub(crate) fn touches_obstacle(&self) -> bool {
        let mut pairs = self.world.contact_pairs_with(self.hull);
        pairs.any(|pair| {
            pair.collider1 != self.floor && pair.collider2 != self.floor && pair.has_any_active_contact()
        })
    }

    /// Adds the body of a peer to the world.
    pub(crate) fn insert_peer(&mut self, world_from_base: Pose2) -> RigidBodyHandle {
        self.insert_obstacle((burger::hull(), Pose::IDENTITY), world_from_base)
    }

    /// Adds the body of something else that moves: its shape, with the shape's pose in it, and its pose.
    pub(crate) fn insert_obstacle(
        &mut self,
        (shape, obstacle_from_shape): (SharedShape, Pose),
        world_from_obstacle: Pose2,
    ) -> RigidBodyHandle {
        let body = RigidBodyBuilder::kinematic_position_based().pose(upright_pose(world_from_obstacle));
        let collider = ColliderBuilder::new(shape)
            .position(obstacle_from_shape)
            .friction(HULL_FRICTION)
            .collision_groups(groups(PEER, HULL));
        self.world.insert(body, collider).0
    }

    /// Sets the pose of a body that was added at once, without motion.
    pub(crate) fn place_obstacle(&mut self, obstacle: RigidBodyHandle, world_from_obstacle: Pose2) {
        let body = &mut self.world.bodies[obstacle];
        body.set_enabled(true);
        body.set_position(upright_pose(world_from_obstacle), true);
    }

    /// Moves a body that was added to a pose in the next physics step, so that it pushes what it meets.
    pub(crate) fn move_obstacle(&mut self, obstacle: RigidBodyHandle, world_from_obstacle: Pose2) {
        self.world.bodies[obstacle].set_next_kinematic_position(upright_pose(world_from_obstacle));
    }

    /// Removes a body that was added until it is placed again.
    pub(crate) fn hide_obstacle(&mut self, obstacle: RigidBodyHandle) {
        self.world.bodies[obstacle].set_enabled(false);
    }

    fn handles(&self) -> [RigidBodyHandle; 3] {
        [self.chassis, self.wheels[0].body, self.wheels[1].body]
    }

    /// Shortens a step in which the robot moved farther than [`STEP_MAX_M`] and [`STEP_MAX_RAD`]: robots that drive into each other overlap,
    /// as each is simulated on its own, and the solver undoes an overlap of centimetres at once.
    fn limit_step(&mut self) {
        let [before, ..] = self.finite_poses;
        let after = self.world_from_chassis();
        let moved_m = (after.translation - before.translation).length();
        let turned_rad = before.rotation.angle_between(after.rotation);
        let share = (STEP_MAX_M / moved_m).min(STEP_MAX_RAD / turned_rad);
        // Poses that are not finite are restored.
        if share.is_nan() || share >= 1.0 {
            return;
        }
        for (handle, before) in self.handles().into_iter().zip(self.finite_poses) {
            let body = &mut self.world.bodies[handle];
            let after = *body.position();
            let translation = before.translation.lerp(after.translation, share);
            let rotation = before.rotation.slerp(after.rotation, share);
            let (linear, angular) = (body.linvel() * share, body.angvel() * share);
            body.set_position(Pose::from_parts(translation, rotation), true);
            body.set_linvel(linear, true);
            body.set_angvel(angular, true);
        }
    }

    /// Saves the bodies' poses if all are finite. Returns whether they are.
    fn save_finite_poses(&mut self) -> bool {
        let poses = self.handles().map(|handle| *self.world.bodies[handle].position());
        let finite = poses.iter().all(Pose::is_finite);
        if finite {
            self.finite_poses = poses;
        }
        finite
    }

    /// Sets the bodies to their last finite poses, at rest.
    fn restore_finite_poses(&mut self) {
        for (handle, pose) in self.handles().into_iter().zip(self.finite_poses) {
            let body = &mut self.world.bodies[handle];
            body.set_position(pose, true);
            body.set_linvel(Vec3::ZERO, true);
            body.set_angvel(Vec3::ZERO, true);
        }
    }
}

/// Returns the pose in three dimensions of a robot that stands on the floor.
pub(crate) fn upright_pose(world_from_base: Pose2) -> Pose {
    let Pose2 { x_m, y_m, yaw_rad } = world_from_base;
    Pose::from_parts(Vec3::new(x_m as f32, y_m as f32, 0.0), Quat::from_rotation_z(yaw_rad as f32))
}

/// Size of the smallest parts, metres. rapier scales its tolerances, which suit parts of 1 m, by it.
const LENGTH_UNIT_M: f32 = 0.02;
/// Natural frequency of the contacts with the floor, Hz. rapier's default is too soft for light wheels.
const CONTACT_FREQUENCY_HZ: f32 = 300.0;

/// Returns rapier's settings for wheels of 28 g that carry 1 kg.
///
/// With rapier's defaults the wheels sink in by 0.8 mm, roll 1.2 % short, and creep while the robot stands.
/// Soft contacts yield by their own body's mass, and one iteration does not carry the load over the joints.
fn solver_parameters() -> IntegrationParameters {
    let mut parameters = IntegrationParameters {
        dt: STEP_S,
        length_unit: LENGTH_UNIT_M,
        num_solver_iterations: 2,
        num_internal_pgs_iterations: 8,
        num_internal_stabilization_iterations: 4,
        ..IntegrationParameters::default()
    };
    parameters.static_contact_softness.natural_frequency = CONTACT_FREQUENCY_HZ;
    parameters
}

fn insert_chassis(world: &mut PhysicsWorld, pose: Pose) -> (RigidBodyHandle, ColliderHandle) {
    let mass = MassProperties::new(CHASSIS_CENTRE_M, CHASSIS_MASS_KG, CHASSIS_INERTIA);
    let chassis = RigidBodyBuilder::dynamic().pose(pose).can_sleep(false).additional_mass_properties(mass);
    let chassis = world.insert_body(chassis);
    let hull = ColliderBuilder::new(burger::hull())
        .density(0.0)
        .friction(HULL_FRICTION)
        .collision_groups(groups(HULL, ROOM | PEER | FLOOR));
    // `Min` keeps the caster without friction. By default rapier averages it with the floor's friction.
    let caster = ColliderBuilder::ball(CASTER_RADIUS_M)
        .translation(CASTER_CENTRE_M)
        .density(0.0)
        .friction(0.0)
        .friction_combine_rule(CoefficientCombineRule::Min)
        .collision_groups(groups(ROLLING, FLOOR));
    world.insert_collider(caster, Some(chassis));
    (chassis, world.insert_collider(hull, Some(chassis)))
}

/// Adds a wheel; `side` is 1 for the left wheel and -1 for the right.
///
/// The tyre is a ball, which touches the floor in one point below the wheel's centre, as the kinematic
/// model assumes.
fn insert_wheel(world: &mut PhysicsWorld, chassis: RigidBodyHandle, at: Pose, side: f32) -> Wheel {
    let radius_m = WHEEL_RADIUS_M as f32;
    let hub = Vec3::new(0.0, side * WHEEL_SEPARATION_M as f32 / 2.0, radius_m);
    let mass = MassProperties::new(Vec3::ZERO, WHEEL_MASS_KG, WHEEL_INERTIA);
    let body = RigidBodyBuilder::dynamic()
        .pose(at * Pose::from_translation(hub))
        .can_sleep(false)
        .additional_mass_properties(mass);
    let tyre = ColliderBuilder::ball(radius_m)
        .density(0.0)
        .friction(WHEEL_FRICTION)
        .collision_groups(groups(ROLLING, FLOOR));
    let (body, _) = world.insert(body, tyre);
    // rapier's default motor scales with inertia and would hardly move so light a wheel.
    let joint = RevoluteJointBuilder::new(Vec3::Y)
        .local_anchor1(hub)
        .local_anchor2(Vec3::ZERO)
        .contacts_enabled(false)
        .motor_model(MotorModel::ForceBased)
        .motor_velocity(0.0, MOTOR_GAIN)
        .motor_max_force(MOTOR_TORQUE_MAX);
    let joint = world.insert_impulse_joint(chassis, body, joint);
    Wheel { body, joint, angle_rad: 0.0 }
}
