//! Links: which older nodes a node is aligned with, and what the alignment must stand up to.

use super::BackEnd;
use crate::align::{Reference, align};
use crate::cloud::SEE_THROUGH_M;
use crate::config::LinkConfig;
use crate::graph::{EdgeKind, RelativeUncertainty, SystematicError, UNOBSERVED};
use msg::{Pose2, pose::wrap_angle};
use nalgebra::Matrix3;
use posegraph::limit_information;

/// Scans from afar see other sides of things: a metre between viewpoints counts so much as a metre
/// between what is looked at.
const VIEWPOINT: f64 = 0.5;
/// Variances (m², rad²) of a node's pose as seen from the few before it: 10 cm and 55 mrad, what wheels lose over them.
const SEQUENTIAL: RelativeUncertainty = RelativeUncertainty {
    worst_axis_variance_m2: 0.01,
    heading_variance_rad2: 0.003,
    bias: SystematicError { moved_m: [0.0; 2], turned_rad: 0.0 },
};
/// An alignment may move the pose by this many standard deviations of what is known. One that moves it farther has found another surface.
const CORRECTION_SIGMAS: f64 = 3.0;
/// The position may move by this on top, the error of the alignment itself, metres.
const CORRECTION_M: f64 = 0.05;
/// The heading may turn by this on top, for the same reason, radians.
const CORRECTION_RAD: f64 = 0.02;
/// Two near links of a node lead to nodes at least this far apart in order.
const NEAR_NODE_GAP_MIN: u32 = 3;

/// Whether the relative pose of two scans is known so well that the scans may be compared.
pub(super) fn is_well_constrained(known: RelativeUncertainty, l: &LinkConfig) -> bool {
    known.worst_axis_variance_m2 < l.sigma_max_m.powi(2)
        && known.heading_variance_rad2 < l.sigma_max_rad.powi(2)
}

impl BackEnd {
    pub(super) fn link_sequential(&mut self, id: u32) {
        for back in 1..=self.config.links.sequential as u32 {
            if let Some(older) = id.checked_sub(back) {
                self.link(older, id, SEQUENTIAL);
            }
        }
    }

    pub(super) fn uncertainty_from(&self, id: u32) -> Vec<Option<RelativeUncertainty>> {
        self.graph.uncertainty_from(id, self.config.closures.window_max_m.powi(2))
    }

    /// Links a node to nearby nodes whose relative pose is well known. Returns how many.
    pub(super) fn link_near(&mut self, id: u32, relative: &[Option<RelativeUncertainty>]) -> usize {
        let l = &self.config.links;
        let here = self.graph.poses()[id as usize];
        let seen = here.apply(self.nodes[id as usize].cloud.centroid_m());
        let mut near: Vec<(f64, u32)> = (0..self.nodes.len() as u32)
            .filter(|other| other.abs_diff(id) > l.sequential as u32)
            .filter_map(|other| {
                let known = relative.get(other as usize).copied().flatten()?;
                let pose = self.graph.poses()[other as usize];
                let [x, y] = pose.apply(self.nodes[other as usize].cloud.centroid_m());
                let apart = (x - seen[0]).hypot(y - seen[1]);
                (is_well_constrained(known, l) && apart < l.distance_max_m)
                    .then_some((apart + VIEWPOINT * here.distance_m(pose), other))
            })
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut chosen: Vec<u32> = Vec::with_capacity(l.near);
        for (_, other) in near {
            if chosen.len() < l.near && chosen.iter().all(|c| c.abs_diff(other) >= NEAR_NODE_GAP_MIN) {
                chosen.push(other);
            }
        }
        let known = |other: u32| relative[other as usize].unwrap_or_default();
        chosen.iter().filter(|&&other| self.link(other.min(id), other.max(id), known(other))).count()
    }

    /// Aligns b's scan with a's and keeps the measurement if the scans agree.
    fn link(&mut self, a: u32, b: u32, known: RelativeUncertainty) -> bool {
        let l = &self.config.links;
        let (older, newer) = (&self.nodes[a as usize], &self.nodes[b as usize]);
        let enough = older.cloud.points().len().min(newer.cloud.points().len());
        if !newer.is_tracked
            || older.disconnected_component != newer.disconnected_component
            || enough < self.config.tracking.points_min
            || self.has_link(a, b)
        {
            return false;
        }
        let guess = self.graph.poses()[a as usize].between(self.graph.poses()[b as usize]);
        let reference = Reference { cloud: &older.cloud, frame_from_cloud: Pose2::IDENTITY };
        let fit = align(&newer.cloud, guess, core::iter::once(reference), None, &self.config.alignment);
        if fit.overlap < l.overlap_min {
            return false;
        }
        let moved = fit.frame_from_cloud.distance_m(guess);
        let turned = wrap_angle(fit.frame_from_cloud.yaw_rad - guess.yaw_rad).abs();
        if moved > CORRECTION_SIGMAS * known.worst_axis_variance_m2.sqrt() + CORRECTION_M
            || turned > CORRECTION_SIGMAS * known.heading_variance_rad2.sqrt() + CORRECTION_RAD
        {
            return false;
        }
        let agreement = older.cloud.compare(&newer.cloud, fit.frame_from_cloud, SEE_THROUGH_M);
        if !agreement.is_sound(l.agreement_min) {
            return false;
        }
        let is_measured = self.nodes[a as usize + 1..=b as usize].iter().all(|node| node.unmeasured_s == 0.0);
        // Noise of normals claims to determine the motion along a corridor: without odometry nothing else would.
        let information =
            if is_measured { fit.information_for_links(l) } else { fit.information_without_noise };
        let information = self.limit_information(information);
        let drift = self.drift(fit.frame_from_cloud);
        self.graph.add_link([a, b], fit.frame_from_cloud, information, fit.degenerate_direction_rad, drift);
        true
    }

    pub(super) fn drift(&self, a_from_b: Pose2) -> [f64; 2] {
        let distance_m = a_from_b.x_m.hypot(a_from_b.y_m);
        [self.config.links.drift_m_per_m * distance_m, self.config.links.drift_rad_per_m * distance_m]
    }

    fn has_link(&self, a: u32, b: u32) -> bool {
        self.graph.edges_of(b).any(|e| e.kind == EdgeKind::ScanMatch && e.a == a && e.b == b)
    }

    /// Information that claims no more than the least standard deviations allow, and nothing where nothing was seen.
    pub(super) fn limit_information(&self, information: Matrix3<f64>) -> Matrix3<f64> {
        let l = &self.config.links;
        limit_information(information, [l.sigma_min_m, l.sigma_min_rad], UNOBSERVED)
    }
}
