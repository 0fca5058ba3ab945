//! How well one node's pose is known as seen from another one, along the best single way through the graph.

use super::{Edge, Graph};
use nalgebra::{Matrix3, Vector3};

/// Uncertainty of a node's pose as seen from another one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RelativeUncertainty {
    /// Variance of the position along the axis that is known worst, at most, m².
    pub worst_axis_variance_m2: f64,
    /// Variance of the heading, rad².
    pub heading_variance_rad2: f64,
    /// Effect of heading errors that repeat along the way. It is not part of the variances.
    pub bias: SystematicError,
}

/// Error of the pose at the end of a way whose heading bends by one standard deviation of the systematic error.
///
/// A bend that is the same everywhere displaces the end to one side only, and turns it (Kelly, "Linearized error propagation in odometry",
/// International Journal of Robotics Research 23(2), 2004).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SystematicError {
    /// Displacement of the end, in the axes of the map, metres.
    pub moved_m: [f64; 2],
    /// Turn of the end, radians.
    pub turned_rad: f64,
}

impl SystematicError {
    /// The error with one more bend at the beginning of the way, from where the end is at `to_end_m`.
    fn bent(self, bend_rad: f64, to_end_m: [f64; 2]) -> Self {
        let [x_m, y_m] = self.moved_m;
        Self {
            moved_m: [x_m - bend_rad * to_end_m[1], y_m + bend_rad * to_end_m[0]],
            turned_rad: self.turned_rad + bend_rad,
        }
    }

    /// How far the end is displaced, metres.
    pub fn distance_m(&self) -> f64 {
        self.moved_m[0].hypot(self.moved_m[1])
    }

    /// Covariance of the end's pose over (x, y, yaw), in the axes of the map: its errors are all due to one bend.
    pub fn covariance(&self) -> Matrix3<f64> {
        let error = Vector3::new(self.moved_m[0], self.moved_m[1], self.turned_rad);
        error * error.transpose()
    }
}

impl RelativeUncertainty {
    /// The uncertainty beyond one more edge. `to_first_m` leads from the edge's other end to the first node, in the axes of the map. The edge
    /// is `backwards` if it leads to an older node. Independent errors add up as variances, errors that repeat as they are.
    fn beyond(self, edge: &Edge, backwards: bool, to_first_m: [f64; 2], bias_rad_per_m: f64) -> Self {
        let length_squared = edge.a_from_b.x_m.powi(2) + edge.a_from_b.y_m.powi(2);
        let sign = if backwards { 1.0 } else { -1.0 };
        Self {
            worst_axis_variance_m2: self.worst_axis_variance_m2
                + self.heading_variance_rad2 * length_squared
                + edge.variances.worst_axis_m2,
            heading_variance_rad2: self.heading_variance_rad2 + edge.variances.heading_rad2,
            bias: self.bias.bent(sign * bias_rad_per_m * length_squared.sqrt(), to_first_m),
        }
    }

    /// The uncertainty whose variances contain the errors that repeat.
    pub fn with_bias(self) -> Self {
        Self {
            worst_axis_variance_m2: self.worst_axis_variance_m2 + self.bias.distance_m().powi(2),
            heading_variance_rad2: self.heading_variance_rad2 + self.bias.turned_rad.powi(2),
            ..self
        }
    }
}

impl Graph {
    /// How well the nodes around `from` are known as seen from it, along the best single way through the graph to each.
    ///
    /// All ways together would give less. Nodes beyond `worst_axis_variance_max_m2` (m²) are `None`. Heading errors that
    /// repeat are `graph.bias_rad_per_m`.
    pub fn uncertainty_from(
        &self,
        from: u32,
        worst_axis_variance_max_m2: f64,
    ) -> Vec<Option<RelativeUncertainty>> {
        let mut known: Vec<Option<RelativeUncertainty>> = vec![None; self.poses.len()];
        let mut open = std::collections::BinaryHeap::new();
        known[from as usize] = Some(RelativeUncertainty::default());
        open.push((core::cmp::Reverse(0_u64), from));
        while let Some((core::cmp::Reverse(bits), node)) = open.pop() {
            let Some(here) = known[node as usize] else { continue };
            if here.worst_axis_variance_m2.to_bits() != bits {
                continue;
            }
            for edge in self.edges_of(node) {
                let next = if edge.a == node { edge.b } else { edge.a };
                let [first, next_pose] = [from, next].map(|id| self.poses[id as usize]);
                let to_first_m = [first.x_m - next_pose.x_m, first.y_m - next_pose.y_m];
                let there = here.beyond(edge, next < node, to_first_m, self.config.bias_rad_per_m);
                let better = known[next as usize]
                    .is_none_or(|k| there.worst_axis_variance_m2 < k.worst_axis_variance_m2);
                if better && there.worst_axis_variance_m2 <= worst_axis_variance_max_m2 {
                    known[next as usize] = Some(there);
                    open.push((core::cmp::Reverse(there.worst_axis_variance_m2.to_bits()), next));
                }
            }
        }
        known
    }
}
