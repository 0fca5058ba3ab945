//! Poses in space as ROS sends them, checked, and what they are in the plane: a robot's pose, a scanner's mount.

use msg::Pose2;
use msg::pose::yaw_of_quaternion;

/// Largest difference of a quaternion's length from 1; it is normalised.
const UNIT_TOLERANCE: f64 = 0.01;
/// Largest distance from a frame's origin, metres.
const DISTANCE_MAX_M: f64 = 1e6;
/// Largest tilt of a scanner that measures in the plane, upright or upside down, degrees: 6 % of a range.
pub const TILT_MAX_DEG: f64 = 20.0;

/// Pose of a frame in its parent, in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpatialPose {
    position_m: [f64; 3],
    /// Unit quaternion x, y, z, w.
    rotation: [f64; 4],
}

/// Pose of a scanner that measures in the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScannerMount {
    /// Pose of the scanner on the robot's base.
    pub base_from_scan: Pose2,
    /// The scanner hangs upside down: its beams turn the other way.
    pub is_upside_down: bool,
    /// Angle between the scanner's plane and the base's, degrees: at most [`TILT_MAX_DEG`].
    pub tilt_deg: f64,
}

impl ScannerMount {
    /// Returns the mount of an upright, level scanner.
    pub fn upright(base_from_scan: Pose2) -> Self {
        Self { base_from_scan, is_upside_down: false, tilt_deg: 0.0 }
    }
}

impl SpatialPose {
    /// Pose of a frame in itself.
    pub const IDENTITY: Self = Self { position_m: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };

    /// Returns the pose of a position in metres and a quaternion x, y, z, w; `None` if they are no pose.
    pub fn checked(position_m: [f64; 3], rotation: [f64; 4]) -> Option<Self> {
        let length = rotation.iter().map(|part| part * part).sum::<f64>().sqrt();
        let is_near = position_m.iter().all(|part| part.abs() <= DISTANCE_MAX_M);
        // NaN fails each comparison.
        let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
        (is_near && is_unit).then(|| Self { position_m, rotation: rotation.map(|part| part / length) })
    }

    /// Returns the pose in the plane.
    pub fn planar(&self) -> Pose2 {
        Pose2::new(self.position_m[0], self.position_m[1], yaw_of_quaternion(self.rotation))
    }

    /// Returns the pose in this pose's parent of a frame whose pose in this frame is `child`.
    pub fn compose(&self, child: &Self) -> Self {
        let [ax, ay, az, aw] = self.rotation;
        let [bx, by, bz, bw] = child.rotation;
        let offset = self.rotate(child.position_m);
        Self {
            position_m: std::array::from_fn(|axis| self.position_m[axis] + offset[axis]),
            rotation: [
                aw * bx + ax * bw + ay * bz - az * by,
                aw * by - ax * bz + ay * bw + az * bx,
                aw * bz + ax * by - ay * bx + az * bw,
                aw * bw - ax * bx - ay * by - az * bz,
            ],
        }
    }

    /// Returns the pose of the parent in this frame.
    pub fn inverse(&self) -> Self {
        let [x, y, z, w] = self.rotation;
        let turned_back = Self { position_m: [0.0; 3], rotation: [-x, -y, -z, w] };
        let position_m = turned_back.rotate(self.position_m.map(|part| -part));
        Self { position_m, ..turned_back }
    }

    /// Returns how far another pose in the same parent is from this one: metres, and the angle between them in radians, 0 to pi.
    pub fn distance(&self, other: &Self) -> (f64, f64) {
        let parts = self.position_m.iter().zip(other.position_m);
        let distance_m = parts.map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
        let [x, y, z, w] = self.inverse().compose(other).rotation;
        // A quaternion and its negative are one rotation.
        let sine = (x * x + y * y + z * z).sqrt();
        (distance_m, 2.0 * sine.atan2(w.abs()))
    }

    /// Returns the mount of a scanner with this pose on the base.
    ///
    /// # Errors
    /// The scanner's plane is tilted: its angle to the base's, degrees.
    pub fn mount(&self) -> Result<ScannerMount, f64> {
        let [x, y, ..] = self.rotation;
        let tilt_deg = (1.0 - 2.0 * (x * x + y * y)).clamp(-1.0, 1.0).acos().to_degrees();
        let is_upside_down = tilt_deg >= 180.0 - TILT_MAX_DEG;
        if tilt_deg > TILT_MAX_DEG && !is_upside_down {
            return Err(tilt_deg);
        }
        // The yaw is the direction of the scanner's x axis, whichever way up it is.
        let tilt_deg = if is_upside_down { 180.0 - tilt_deg } else { tilt_deg };
        Ok(ScannerMount { base_from_scan: self.planar(), is_upside_down, tilt_deg })
    }

    /// Returns the frame turned by half a turn about its own x axis: what lay at the angle a in its plane lies at -a.
    ///
    /// The scans of a scanner upside down, mirrored, are upright in this frame.
    pub fn turned_over(&self) -> Self {
        let [x, y, z, w] = self.rotation;
        Self { rotation: [w, z, -y, -x], ..*self }
    }

    /// Returns the frame with its z axis up: as it is, or turned over.
    pub fn upright(&self) -> Self {
        let [x, y, ..] = self.rotation;
        let is_down = 1.0 - 2.0 * (x * x + y * y) < 0.0;
        if is_down { self.turned_over() } else { *self }
    }

    /// Returns the position in metres and the unit quaternion x, y, z, w.
    pub fn parts(&self) -> ([f64; 3], [f64; 4]) {
        (self.position_m, self.rotation)
    }

    /// Rotates a vector from this frame into the parent's axes.
    fn rotate(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [qx, qy, qz, w] = self.rotation;
        let cross = |[ax, ay, az]: [f64; 3], [bx, by, bz]: [f64; 3]| {
            [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
        };
        let axis = [qx, qy, qz];
        let twice = cross(axis, [x, y, z]).map(|part| 2.0 * part);
        let again = cross(axis, twice);
        std::array::from_fn(|i| [x, y, z][i] + w * twice[i] + again[i])
    }
}

/// Returns the pose in the plane of a position in metres and a quaternion x, y, z, w; `None` if they are no pose.
pub fn planar_pose(position: [f64; 3], rotation: [f64; 4]) -> Option<Pose2> {
    SpatialPose::checked(position, rotation).map(|pose| pose.planar())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about(axis: [f64; 3], degrees: f64) -> SpatialPose {
        let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
        let [x, y, z] = axis.map(|part| part * sin);
        SpatialPose::checked([0.0; 3], [x, y, z, cos]).unwrap()
    }

    #[test]
    fn poses_in_the_plane_compose_as_in_the_plane() {
        let turned =
            |x, y, degrees: f64| SpatialPose { position_m: [x, y, 0.3], ..about([0.0, 0.0, 1.0], degrees) };
        let (a, b) = (turned(1.0, 2.0, 90.0), turned(0.5, -0.25, 30.0));
        let (found, expected) = (a.compose(&b).planar(), a.planar() * b.planar());
        for (found, expected) in
            [(found.x_m, expected.x_m), (found.y_m, expected.y_m), (found.yaw_rad, expected.yaw_rad)]
        {
            assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
        }
    }

    #[test]
    fn a_pose_composed_with_its_inverse_is_the_identity_and_distances_are_in_space() {
        for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]] {
            for degrees in [0.0, 30.0, 170.0, -90.0, 350.0] {
                let pose = SpatialPose { position_m: [1.0, -2.0, 0.5], ..about(axis, degrees) };
                for both in [pose.compose(&pose.inverse()), pose.inverse().compose(&pose)] {
                    let (metres, radians) = both.distance(&SpatialPose::IDENTITY);
                    assert!(metres < 1e-12 && radians < 1e-7, "{both:?}");
                }
                let (metres, radians) = SpatialPose::IDENTITY.distance(&pose);
                let shorter = if degrees > 180.0 { 360.0 - degrees } else { degrees.abs() };
                assert!((metres - 5.25_f64.sqrt()).abs() < 1e-12, "{metres}");
                assert!((radians.to_degrees() - shorter).abs() < 1e-6, "{radians} of {degrees} degrees");
            }
        }
    }

    #[test]
    fn a_frame_turned_over_mirrors_the_points_of_its_plane() {
        for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.6, -0.8]] {
            for degrees in [0.0, 30.0, 175.0, 180.0] {
                let frame = about(axis, degrees);
                for angle in [0.0_f64, 0.4, 2.0, -1.1] {
                    let point = |sign: f64| [angle.cos(), sign * angle.sin(), 0.0];
                    let (found, expected) =
                        (frame.turned_over().rotate(point(-1.0)), frame.rotate(point(1.0)));
                    let apart = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                    assert!(apart < 1e-12, "{found:?} instead of {expected:?}");
                }
            }
        }
    }

    #[test]
    fn a_scanner_is_upright_upside_down_or_refused_by_its_tilt() {
        let (roll, pitch) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        for axis in [roll, pitch] {
            for (degrees, expected) in
                [(0.0, Some(false)), (19.0, Some(false)), (161.0, Some(true)), (180.0, Some(true))]
            {
                let found = about(axis, degrees).mount().ok().map(|mount| mount.is_upside_down);
                assert_eq!(found, expected, "{degrees} degrees about {axis:?}");
            }
            for degrees in [21.0, 90.0, 159.0] {
                let tilt = about(axis, degrees).mount().unwrap_err();
                assert!((tilt - degrees).abs() < 1e-6, "{tilt} instead of {degrees}");
            }
        }
        // Upside down about the y axis: the scanner looks back.
        let yaw = about(pitch, 180.0).mount().unwrap().base_from_scan.yaw_rad;
        assert!((yaw.abs() - std::f64::consts::PI).abs() < 1e-6, "{yaw}");
    }
}
