//! Appends a node to the graph: where the front end has it, with odometry's edge to the node before.

use super::{BREAK_SIGMAS, BackEnd};
use crate::front_end::{SPEED_SIGMA_SHARE, UNMEASURED_MAX_S};
use crate::graph::EdgeKind;
use crate::node::Node;
use msg::Pose2;
use nalgebra::{Matrix3, Vector3};
use posegraph::information_from_sigmas;

/// Without odometry, the front end's own motion is this many times as uncertain as odometry would be.
const UNMEASURED_FACTOR: f64 = 5.0;

/// Standard deviation of the position of a robot that may have been kidnapped, metres: a person carries it some metres, and seldom. Along one
/// axis it is less than what takes a part of the path from the map, so that a LiDAR that starts again in a corridor goes on; along both it is more.
const KIDNAPPED_SIGMA_M: f64 = 1.2;

impl BackEnd {
    /// Appends a node at its pose relative to the node before, with an odometry edge, or at the pose where the robot was
    /// located.
    pub(super) fn append_node(&mut self, mut node: Node) {
        self.node_ids.front_ids.push(node.id);
        self.lifelong.contradicted.push(0);
        node.id = self.nodes.len() as u32;
        if let Some(estimate) = self.location.next_node_estimate.take() {
            self.reliability.unmeasured_s = 0.0;
            return self.add_node_at_initial_pose(node, estimate);
        }
        let Some(previous) = self.nodes.last() else {
            self.graph.add_node(node.local_from_base);
            self.nodes.push(node);
            return;
        };
        self.reliability.unmeasured_s += node.unmeasured_s;
        if self.reliability.unmeasured_s > UNMEASURED_MAX_S {
            node.odometry_break = true;
        }
        if node.odometry_break {
            self.reliability.unmeasured_s = 0.0;
        }
        let moved = previous.local_from_base.between(node.local_from_base);
        let (a, b) = (previous.id, node.id);
        let previous_component = previous.disconnected_component;
        let map_from_node = self.graph.poses()[a as usize] * moved;
        self.loop_closures.travelled_m += moved.x_m.hypot(moved.y_m);
        self.graph.add_node(map_from_node);
        let measured = node.previous_from_this.unwrap_or(moved);
        let (kind, information) = if node.odometry_break {
            self.forget_searches();
            (EdgeKind::OdometryBreak, BREAK_SIGMAS.information())
        } else {
            (EdgeKind::Odometry, self.odometry_information(&node, measured))
        };
        node.disconnected_component = if node.odometry_break { Some(b) } else { previous_component };
        self.nodes.push(node);
        self.graph.add_edge([a, b], measured, information, kind, [0.0; 2]);
    }

    fn odometry_information(&self, node: &Node, moved: Pose2) -> Matrix3<f64> {
        let sigmas = self.configured_odometry_sigmas(moved);
        let is_measured = node.previous_from_this.is_some();
        let scales = if is_measured { self.odometry_noise.scales() } else { [UNMEASURED_FACTOR; 2] };
        let speed_sigma_m_s = SPEED_SIGMA_SHARE * self.config.odometry.speed_max_m_s;
        let kidnapped_sigma_m = if node.possibly_kidnapped { KIDNAPPED_SIGMA_M } else { 0.0 };
        let m = scales[0] * sigmas[0] + speed_sigma_m_s * f64::from(node.unmeasured_s) + kidnapped_sigma_m;
        let rad = scales[1] * sigmas[1];
        motion_information(moved, m, rad)
    }
}

/// Information of a motion whose heading errs with `sigma_rad` in all, as a random walk along the straight line between its
/// ends, and whose distances err with `sigma_m`. An error of the heading turns what is left of the way, so that the end's position
/// errs together with its heading: a heading that a scan corrects corrects the position, too (Thrun, Burgard, Fox, "Probabilistic Robotics",
/// 2005, section 5.4, as a propagated covariance).
fn motion_information(moved: Pose2, sigma_m: f64, sigma_rad: f64) -> Matrix3<f64> {
    // The walk w has variance 1 at the end: the integrals of (1 - s) dw over the way have variance 1/3, and covariance 1/2 with w.
    let sideways_m = Vector3::new(-moved.y_m, moved.x_m, 0.0) * sigma_rad;
    let heading = Vector3::new(0.0, 0.0, sigma_rad);
    let along = Matrix3::from_diagonal(&Vector3::new(sigma_m * sigma_m, sigma_m * sigma_m, 0.0));
    let coupled = (sideways_m * heading.transpose() + heading * sideways_m.transpose()) / 2.0;
    let covariance =
        along + sideways_m * sideways_m.transpose() / 3.0 + coupled + heading * heading.transpose();
    covariance.try_inverse().unwrap_or_else(|| information_from_sigmas(sigma_m, sigma_rad))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::{Rng, SeedableRng};

    /// Sum of twelve uniform numbers: nearly normal, of variance 1.
    fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
        (0..12).map(|_| random.next_u64() as f64 / u64::MAX as f64).sum::<f64>() - 6.0
    }

    #[test]
    fn the_covariance_of_a_motion_is_that_of_ways_whose_heading_walks_at_random() {
        const STEPS: usize = 50;
        let (moved, sigma_m, sigma_rad) = (Pose2::new(1.2, -0.5, 0.7), 1e-4, 0.2);
        let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut sum = Matrix3::zeros();
        let ways = 4000;
        for _ in 0..ways {
            let (mut heading_rad, mut end_m) = (0.0_f64, [0.0; 2]);
            for _ in 0..STEPS {
                heading_rad += sigma_rad / (STEPS as f64).sqrt() * normal(&mut random);
                let (sin, cos) = heading_rad.sin_cos();
                let step = [moved.x_m, moved.y_m].map(|v| v / STEPS as f64);
                end_m[0] += cos * step[0] - sin * step[1];
                end_m[1] += sin * step[0] + cos * step[1];
            }
            let error = Vector3::new(end_m[0] - moved.x_m, end_m[1] - moved.y_m, heading_rad);
            sum += error * error.transpose();
        }
        let seen = sum / f64::from(ways);
        let covariance = motion_information(moved, sigma_m, sigma_rad).try_inverse().unwrap();
        let apart = (seen - covariance).norm() / covariance.norm();
        assert!(apart < 0.1, "seen {seen}, computed {covariance}");
    }

    #[test]
    fn a_heading_that_is_corrected_turns_half_of_the_way() {
        // Odometry says 2 m ahead; the heading at the end turns out to be 0.2 rad to the left.
        let information = motion_information(Pose2::new(2.0, 0.0, 0.0), 0.01, 0.3);
        let place = information.fixed_view::<2, 2>(0, 0).into_owned();
        let coupling = information.fixed_view::<2, 1>(0, 2).into_owned();
        let moved_m = -(place.try_inverse().unwrap() * coupling) * 0.2;
        assert!((moved_m[1] - 0.2).abs() < 0.01 && moved_m[0].abs() < 1e-9, "{moved_m}");
    }
}
