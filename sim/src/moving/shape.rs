//! Outlines of moving things and of robots on the floor.

use msg::{MovingObject, ObjectKind, Pose2};
use parry3d::query::Ray;

/// A rectangle with rounded corners: a disc if it has no length, as of a person or a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outline {
    /// Position of the centre in `world`, metres.
    pub(crate) centre_m: [f64; 2],
    /// Cosine and sine of the heading of its x axis.
    axis: [f64; 2],
    /// Half of the rectangle's length along both axes, metres.
    half_m: [f64; 2],
    /// Radius of the corners, which adds to the length, metres.
    radius_m: f64,
}

impl Outline {
    /// Returns a disc.
    pub(crate) fn disc(centre_m: [f64; 2], radius_m: f64) -> Self {
        Self { centre_m, axis: [1.0, 0.0], half_m: [0.0; 2], radius_m }
    }

    /// Returns a rectangle with sharp corners.
    pub(crate) fn rectangle(world_from_centre: Pose2, half_m: [f64; 2]) -> Self {
        let Pose2 { x_m, y_m, yaw_rad } = world_from_centre;
        let (sin, cos) = yaw_rad.sin_cos();
        Self { centre_m: [x_m, y_m], axis: [cos, sin], half_m, radius_m: 0.0 }
    }

    /// Returns the outline of an object at a pose.
    pub(crate) fn of_object(object: &MovingObject, world_from_object: Pose2) -> Self {
        match object.kind() {
            Some(ObjectKind::Person) => {
                Self::disc([world_from_object.x_m, world_from_object.y_m], object.half_size_m[0])
            }
            _ => Self::rectangle(world_from_object, object.half_size_m),
        }
    }

    /// Returns the distance from a point to the outline, metres; 0 or less inside of it.
    pub(crate) fn distance_m(&self, point_m: [f64; 2]) -> f64 {
        let [x, y] = self.in_axes(point_m);
        let outside = [x.abs() - self.half_m[0], y.abs() - self.half_m[1]];
        outside[0].max(0.0).hypot(outside[1].max(0.0)) + outside[0].max(outside[1]).min(0.0) - self.radius_m
    }

    /// Returns the radius of the circle around the centre that contains the outline, metres.
    pub(crate) fn bound_m(&self) -> f64 {
        self.half_m[0].hypot(self.half_m[1]) + self.radius_m
    }

    /// Iterates over points of the outline of a rectangle, at most `step_m` apart.
    pub(crate) fn border_m(&self, step_m: f64) -> impl Iterator<Item = [f64; 2]> + '_ {
        let [a, b] = self.half_m;
        let corners = [[-a, -b], [a, -b], [a, b], [-a, b]];
        (0..4).flat_map(move |side| {
            let (from, to) = (corners[side], corners[(side + 1) % 4]);
            let length_m = (to[0] - from[0]).hypot(to[1] - from[1]);
            let steps = (length_m / step_m).ceil().max(1.0) as usize;
            (0..steps).map(move |step| {
                let share = step as f64 / steps as f64;
                self.in_world([0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis])))
            })
        })
    }

    /// Returns the distance from a point to the centre, metres.
    pub(crate) fn distance_of_centre_m(&self, [x, y]: [f64; 2]) -> f64 {
        (self.centre_m[0] - x).hypot(self.centre_m[1] - y)
    }

    /// Returns the distance along a ray to the walls above the outline, from outside, metres; `None` if it is `far_m` or more. The outline
    /// is a disc or has sharp corners.
    pub(crate) fn cast(&self, ray: &Ray, far_m: f32) -> Option<f32> {
        let from = [f64::from(ray.origin.x) - self.centre_m[0], f64::from(ray.origin.y) - self.centre_m[1]];
        let direction = [f64::from(ray.dir.x), f64::from(ray.dir.y)];
        let (along, aside) = (dot(from, direction), from[0] * direction[1] - from[1] * direction[0]);
        let (squared, bound_m) = (dot(direction, direction), self.bound_m());
        // A beam that passes the circle around it.
        if aside * aside > bound_m * bound_m * squared || squared == 0.0 {
            return None;
        }
        let distance_m = if self.half_m == [0.0; 2] {
            let discriminant = along * along - squared * (dot(from, from) - self.radius_m * self.radius_m);
            (-along - discriminant.max(0.0).sqrt()) / squared
        } else {
            self.enter_rectangle(from, direction)?
        };
        (0.0..f64::from(far_m)).contains(&distance_m).then_some(distance_m as f32)
    }

    /// Returns where a line enters the rectangle, in lengths of `direction`; `from` is seen from the centre.
    fn enter_rectangle(&self, from: [f64; 2], direction: [f64; 2]) -> Option<f64> {
        let (from, direction) = (self.turned_in(from), self.turned_in(direction));
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..2 {
            if direction[axis] == 0.0 {
                if from[axis].abs() > self.half_m[axis] {
                    return None;
                }
                continue;
            }
            let ends = [-1.0, 1.0].map(|side| (side * self.half_m[axis] - from[axis]) / direction[axis]);
            (enter, leave) = (enter.max(ends[0].min(ends[1])), leave.min(ends[0].max(ends[1])));
        }
        (enter <= leave).then_some(enter)
    }

    fn in_axes(&self, point_m: [f64; 2]) -> [f64; 2] {
        self.turned_in([0, 1].map(|axis| point_m[axis] - self.centre_m[axis]))
    }

    /// Turns a vector of `world` into the axes of the outline.
    fn turned_in(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [cos, sin] = self.axis;
        [cos * x + sin * y, cos * y - sin * x]
    }

    fn in_world(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [cos, sin] = self.axis;
        [self.centre_m[0] + cos * x - sin * y, self.centre_m[1] + sin * x + cos * y]
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn distances_are_those_of_a_turned_rectangle_and_of_a_disc() {
        let leaf = Outline::rectangle(Pose2::new(1.0, 2.0, core::f64::consts::FRAC_PI_2), [0.5, 0.1]);
        for (point, expected) in [
            ([1.0, 3.0], 0.5),
            ([1.4, 2.0], 0.3),
            ([1.0, 2.0], -0.1),
            ([1.4, 2.9], 0.5),
            ([1.05, 2.0], -0.05),
        ] {
            assert!((leaf.distance_m(point) - expected).abs() < 1e-12, "{point:?}");
        }
        assert!((Outline::disc([0.0; 2], 0.2).distance_m([0.5, 0.0]) - 0.3).abs() < 1e-12);
        assert!(leaf.border_m(0.05).all(|point| leaf.distance_m(point).abs() < 1e-12));
    }

    #[test]
    fn beams_end_at_the_outline() {
        let leaf = Outline::rectangle(Pose2::new(2.0, 0.0, core::f64::consts::FRAC_PI_2), [0.5, 0.1]);
        let person = Outline::disc([2.0, 0.0], 0.25);
        let beam = |yaw_rad: f32| Ray::new(Vec3::ZERO, Vec3::new(yaw_rad.cos(), yaw_rad.sin(), 0.0));
        let near = |found: Option<f32>, expected: f32| found.is_some_and(|m| (m - expected).abs() < 1e-5);
        assert!(near(leaf.cast(&beam(0.0), 9.0), 1.9));
        assert!(near(person.cast(&beam(0.0), 9.0), 1.75));
        assert!(near(leaf.cast(&beam(0.2), 9.0), 1.9 / 0.2f32.cos()));
        for (outline, yaw_rad, far_m) in
            [(leaf, 0.3, 9.0), (leaf, 3.0, 9.0), (person, 0.13, 9.0), (person, 0.0, 1.7)]
        {
            assert_eq!(outline.cast(&beam(yaw_rad), far_m), None, "{yaw_rad} {far_m}");
        }
    }
}
