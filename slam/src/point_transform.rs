//! Pose in single precision, which transforms many points.

use msg::Pose2;

/// A pose in single precision that transforms points, its sine and cosine computed once.
#[derive(Clone, Copy, Debug)]
pub struct PointTransform {
    x: f32,
    y: f32,
    sin: f32,
    cos: f32,
}

impl PointTransform {
    /// The transform of a pose.
    pub fn new(pose: Pose2) -> Self {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        Self { x: pose.x_m as f32, y: pose.y_m as f32, sin: sin as f32, cos: cos as f32 }
    }

    /// Rotates and translates a point, metres.
    pub fn point(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [self.cos * x - self.sin * y + self.x, self.sin * x + self.cos * y + self.y]
    }

    /// Rotates a direction.
    pub fn direction(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [self.cos * x - self.sin * y, self.sin * x + self.cos * y]
    }
}
