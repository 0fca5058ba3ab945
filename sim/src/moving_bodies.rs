//! People, doors and boxes as obstacles: kinematic bodies that follow the messages of the process `objects`.

use crate::body::Body;
use crate::moving::{Outline, is_valid};
use core::f32::consts::FRAC_PI_2;
use glam::{Quat, Vec3};
use msg::{MOVING_OBJECTS_MAX, MovingObject, MovingObjects, ObjectKind, Pose2, Stamp};
use parry3d::math::Pose;
use parry3d::shape::SharedShape;
use rapier3d::dynamics::RigidBodyHandle;

/// Distance between two poses above which a body is placed instead of moved, metres: a box that was carried, or messages that are missing.
const JUMP_MIN_M: f64 = 0.12;
/// Half of the bodies' height, metres: all are higher than a robot.
const HALF_HEIGHT_M: f32 = 0.25;
/// Time by which a message may be ahead of the simulator, seconds: the simulator was stopped meanwhile.
const AHEAD_MAX_S: f64 = 1.0;

/// An object with its body.
#[derive(Clone, Copy)]
struct MovingBody {
    body: RigidBodyHandle,
    object: MovingObject,
    /// Pose of its body in this simulation.
    world_from_object: Pose2,
    present: bool,
}

/// All objects that move in the room, in the order of the message.
pub(crate) struct MovingBodies {
    bodies: [Option<MovingBody>; MOVING_OBJECTS_MAX],
    stamp: Stamp,
}

impl Default for MovingBodies {
    fn default() -> Self {
        Self { bodies: [None; MOVING_OBJECTS_MAX], stamp: Stamp(i64::MIN) }
    }
}

impl MovingBodies {
    /// Records a message; one that is older than the newest is ignored. Returns false if it is invalid or ahead of `now`.
    pub(crate) fn update(&mut self, body: &mut Body, message: &MovingObjects, now: Stamp) -> bool {
        let is_whole = message.objects().iter().all(is_valid);
        if !is_whole || message.header.stamp - now > AHEAD_MAX_S {
            return false;
        }
        if message.header.stamp <= self.stamp {
            return true;
        }
        self.stamp = message.header.stamp;
        let age_s = now - self.stamp;
        for (slot, object) in self.bodies.iter_mut().zip(message.objects()) {
            let known = slot.get_or_insert_with(|| {
                let world_from_object = object.world_from_object_after(age_s);
                let handle = body.insert_obstacle(shape(object), world_from_object);
                MovingBody { body: handle, object: *object, world_from_object, present: true }
            });
            // A body keeps its size, which does not change in a run.
            known.object = MovingObject { half_size_m: known.object.half_size_m, ..*object };
        }
        for gone in self.bodies.iter_mut().skip(message.objects().len()).flatten() {
            gone.object.is_present = 0;
        }
        true
    }

    /// Moves every body to its pose at `now`, the end of the next physics step.
    pub(crate) fn advance(&mut self, body: &mut Body, now: Stamp) {
        let age_s = now - self.stamp;
        for known in self.bodies.iter_mut().flatten() {
            if known.object.is_present == 0 {
                if known.present {
                    body.hide_obstacle(known.body);
                }
                known.present = false;
                continue;
            }
            let next = known.object.world_from_object_after(age_s);
            if !known.present || next.distance_m(known.world_from_object) > JUMP_MIN_M {
                body.place_obstacle(known.body, next);
            } else {
                body.move_obstacle(known.body, next);
            }
            (known.present, known.world_from_object) = (true, next);
        }
    }

    /// Iterates over the outlines of the objects that are there.
    pub(crate) fn outlines(&self) -> impl Iterator<Item = Outline> + '_ {
        let present = self.bodies.iter().flatten().filter(|known| known.present);
        present.map(|known| Outline::of_object(&known.object, known.world_from_object))
    }
}

/// Returns the shape of an object that stands on the floor, and its pose in the object.
fn shape(object: &MovingObject) -> (SharedShape, Pose) {
    let [x_m, y_m] = object.half_size_m.map(|m| m as f32);
    let centre = Vec3::new(0.0, 0.0, HALF_HEIGHT_M);
    match object.kind() {
        // parry's cylinders stand along y.
        Some(ObjectKind::Person) => (
            SharedShape::cylinder(HALF_HEIGHT_M, x_m),
            Pose::from_parts(centre, Quat::from_rotation_x(FRAC_PI_2)),
        ),
        _ => (SharedShape::cuboid(x_m, y_m, HALF_HEIGHT_M), Pose::from_translation(centre)),
    }
}
