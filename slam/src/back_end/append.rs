//! Appends a node to the graph: where the front end has it, with odometry's edge to the node before.

use super::{BREAK_M, BREAK_RAD, BackEnd};
use crate::front_end::{SPEED_SIGMA_SHARE, UNMEASURED_MAX_S};
use crate::graph::EdgeKind;
use crate::node::Node;
use msg::Pose2;
use nalgebra::{Matrix3, Vector3};
use posegraph::information_from_sigmas;

/// Without odometry, the front end's own motion is this many times as uncertain as odometry would be.
const UNMEASURED_FACTOR: f64 = 5.0;

impl BackEnd {
    /// Appends a node at its pose relative to the node before, with an odometry edge, or at the pose where the robot was
    /// located.
    pub(super) fn append_node(&mut self, mut node: Node) {
        self.numbers.front_ids.push(node.id);
        self.lifelong.contradicted.push(0);
        node.id = self.nodes.len() as u32;
        if let Some(estimate) = self.location.next_node_estimate.take() {
            self.doubts.unmeasured_s = 0.0;
            return self.add_node_at_initial_pose(node, estimate);
        }
        let Some(previous) = self.nodes.last() else {
            self.graph.add_node(node.local_from_base);
            self.nodes.push(node);
            return;
        };
        self.doubts.unmeasured_s += node.unmeasured_s;
        if self.doubts.unmeasured_s > UNMEASURED_MAX_S {
            node.odometry_break = true;
        }
        if node.odometry_break {
            self.doubts.unmeasured_s = 0.0;
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
            (EdgeKind::OdometryBreak, information_from_sigmas(BREAK_M, BREAK_RAD))
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
        let m = scales[0] * sigmas[0] + speed_sigma_m_s * f64::from(node.unmeasured_s);
        let rad = scales[1] * sigmas[1];
        Matrix3::from_diagonal(&Vector3::new(1.0 / (m * m), 1.0 / (m * m), 1.0 / (rad * rad)))
    }
}
