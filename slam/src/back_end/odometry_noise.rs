//! How good this robot's odometry is, learned from the scans.
//!
//! The configuration's standard deviations have to hold for the worst wheels. Where scans determine the motion between two
//! nodes, its difference from odometry tells how much better or worse these wheels are: the ratio of the squared error to
//! the configured variance (innovation-based adaptive estimation; Mehra, "Approaches to adaptive filtering", IEEE
//! Transactions on Automatic Control 1972). It counts where the scans determine nothing: along corridors, and in how far a
//! closure may be from where odometry has it.

use super::BackEnd;
use crate::graph::{Edge, EdgeKind};
use msg::Pose2;
use nalgebra::Matrix3;

/// The configuration counts as much as so many nodes: some 8 m of path.
const PRIOR_NODES: f64 = 24.0;
/// Errors are also summed over so many nodes: what repeats, as a wrong wheel radius, grows with the path and not with its root.
const BLOCK_NODES: u32 = 8;
/// Nodes that are remembered: some 100 m of path.
const MEMORY_NODES: f64 = 400.0;
/// One slip of the wheels counts no more than so many standard deviations, squared.
const CHI_SQUARED_MAX: f64 = 25.0;
/// Odometry is never taken to be better or worse than the configuration says by more than these factors.
const SCALE_MIN: f64 = 0.25;
const SCALE_MAX: f64 = 2.0;
/// Scans determine a motion if they do it so much better than odometry: a share of its standard deviation.
const DETERMINED_SHARE: f64 = 0.5;
/// A shorter motion says nothing about distances, metres.
const DRIVEN_M: f64 = 0.15;
/// Information added to each coordinate before inversion, 1/m² and 1/rad².
const REGULARISATION: f64 = 1e-4;

/// Share of the configured errors of odometry that repeat from node to node. With all of them, 20 m of a bare corridor driven with
/// exact wheels would be no part of the map.
const SYSTEMATIC_SHARE: f64 = 0.5;

/// Mean of squared errors in variances, with the configuration as a prior.
#[derive(Clone, Copy, Debug)]
struct MeanSquare {
    sum: f64,
    weight: f64,
    memory: f64,
}

impl MeanSquare {
    fn new(prior: f64, memory: f64) -> Self {
        Self { sum: prior, weight: prior, memory }
    }

    fn add(&mut self, chi_squared: f64, weight: f64) {
        let kept = ((self.memory - weight) / self.weight).min(1.0);
        self.sum = self.sum * kept + chi_squared.min(CHI_SQUARED_MAX) * weight;
        self.weight = self.weight * kept + weight;
    }

    fn mean(&self) -> f64 {
        self.sum / self.weight
    }
}

/// Ratio of the true standard deviation to the configured one, of distances or of headings.
#[derive(Clone, Copy, Debug)]
struct NoiseScale<const N: usize> {
    single: MeanSquare,
    blocks: MeanSquare,
    sum: [f64; N],
    variance: f64,
    count: u32,
}

impl<const N: usize> NoiseScale<N> {
    fn new() -> Self {
        let blocks = f64::from(BLOCK_NODES);
        Self {
            single: MeanSquare::new(PRIOR_NODES, MEMORY_NODES),
            blocks: MeanSquare::new(PRIOR_NODES / blocks, MEMORY_NODES / blocks),
            sum: [0.0; N],
            variance: 0.0,
            count: 0,
        }
    }

    /// Adds the error of a motion over so many nodes, of which odometry has this variance by the configuration.
    fn observe(&mut self, error: [f64; N], variance: f64, nodes: u32) {
        let squared = |v: &[f64; N]| v.iter().map(|e| e * e).sum::<f64>() / N as f64;
        self.single.add(squared(&error) / variance, f64::from(nodes));
        self.sum.iter_mut().zip(error).for_each(|(sum, error)| *sum += error);
        self.variance += variance;
        self.count += nodes;
        if self.count >= BLOCK_NODES {
            self.blocks
                .add(squared(&self.sum) / self.variance, f64::from(self.count) / f64::from(BLOCK_NODES));
            (self.sum, self.variance, self.count) = ([0.0; N], 0.0, 0);
        }
    }

    fn scale(&self) -> f64 {
        self.single.mean().max(self.blocks.mean()).sqrt().clamp(SCALE_MIN, SCALE_MAX)
    }
}

/// A motion over a few nodes by odometry.
#[derive(Clone, Copy, Debug)]
struct OdometryMotion {
    /// The node that it starts at, and the one that it ends at.
    nodes: [u32; 2],
    first_from_last: Pose2,
    /// What the wheels measured too much besides, where scans contradicted them: (x, y, yaw), metres and radians.
    slip: [f64; 3],
    /// Variances by the configuration, m² and rad².
    variances: [f64; 2],
}

/// Ratios of distances and of headings.
#[derive(Clone, Copy, Debug)]
struct MotionNoise {
    distance: NoiseScale<2>,
    heading: NoiseScale<1>,
}

impl MotionNoise {
    fn new() -> Self {
        Self { distance: NoiseScale::new(), heading: NoiseScale::new() }
    }

    fn scales(&self) -> [f64; 2] {
        [self.distance.scale(), self.heading.scale()]
    }
}

/// How much better or worse this robot's odometry is than the configuration says.
#[derive(Clone, Copy, Debug)]
pub(super) struct OdometryNoise {
    /// Of what odometry's edges in the graph have: slips that scans contradicted are taken out of them.
    of_edges: MotionNoise,
    /// Of the wheels, slips included: so they err where scans contradict nothing.
    of_wheels: MotionNoise,
    /// The last nodes of the motions that distances and headings were learned from: no part of the path counts twice.
    learned_until: [u32; 2],
}

impl OdometryNoise {
    pub fn new() -> Self {
        Self { of_edges: MotionNoise::new(), of_wheels: MotionNoise::new(), learned_until: [0; 2] }
    }

    /// Factors of the configured standard deviations of odometry's edges: of distances and of headings.
    pub fn scales(&self) -> [f64; 2] {
        self.of_edges.scales()
    }

    /// Takes over new numbers of the nodes that were learned from.
    pub fn renumber(&mut self, number: impl Fn(u32) -> u32) {
        self.learned_until = self.learned_until.map(number);
    }

    /// Compares a motion by odometry with the same one by the scans, if they determine it and it was not learned from before.
    fn observe(&mut self, odometry: &OdometryMotion, link: &Edge) {
        let information = link.information + Matrix3::identity() * REGULARISATION;
        let Some(covariance) = information.try_inverse() else { return };
        let moved = odometry.first_from_last;
        let error = link.a_from_b.between(moved);
        let [slip_x_m, slip_y_m, slip_rad] = odometry.slip;
        let [first, last] = odometry.nodes;
        let [limit_m2, limit_rad2] = odometry.variances.map(|variance| DETERMINED_SHARE.powi(2) * variance);
        let position = covariance.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().max();
        let nodes = last - first;
        if first >= self.learned_until[0] && position < limit_m2 && moved.x_m.hypot(moved.y_m) > DRIVEN_M {
            let [of_edges, of_wheels] =
                [0.0, 1.0].map(|slip| [error.x_m + slip * slip_x_m, error.y_m + slip * slip_y_m]);
            self.of_edges.distance.observe(of_edges, odometry.variances[0], nodes);
            self.of_wheels.distance.observe(of_wheels, odometry.variances[0], nodes);
            self.learned_until[0] = last;
        }
        if first >= self.learned_until[1] && covariance[(2, 2)] < limit_rad2 {
            self.of_edges.heading.observe([error.yaw_rad], odometry.variances[1], nodes);
            self.of_wheels.heading.observe([error.yaw_rad + slip_rad], odometry.variances[1], nodes);
            self.learned_until[1] = last;
        }
    }
}

impl BackEnd {
    /// Learns from the motion to a node how good odometry is: from the shortest one that a link determines as well. One
    /// from the node before is too short where odometry is good: it errs less over 0.3 m than two scans do.
    pub(super) fn learn_odometry_noise(&mut self, id: u32) {
        let edge_to = |from: u32, to: u32, kind: EdgeKind| {
            self.graph.edges_of(to).find(|e| e.kind == kind && (e.a, e.b) == (from, to)).copied()
        };
        let mut motion = OdometryMotion {
            nodes: [id; 2],
            first_from_last: Pose2::IDENTITY,
            slip: [0.0; 3],
            variances: [0.0; 2],
        };
        let mut noise = self.odometry_noise;
        for first in (id.saturating_sub(self.config.links.sequential as u32)..id).rev() {
            let next = first + 1;
            let Some(step) = edge_to(first, next, EdgeKind::Odometry) else { break };
            if self.nodes[next as usize].previous_from_this.is_none() {
                break;
            }
            motion.nodes[0] = first;
            motion.first_from_last = step.a_from_b * motion.first_from_last;
            let slip = self.nodes[next as usize].slip;
            motion.slip = core::array::from_fn(|i| motion.slip[i] + slip[i]);
            let sigmas = self.configured_odometry_sigmas(step.a_from_b);
            motion.variances = core::array::from_fn(|i| motion.variances[i] + sigmas[i].powi(2));
            if let Some(link) = edge_to(first, id, EdgeKind::ScanMatch) {
                noise.observe(&motion, &link);
            }
        }
        self.odometry_noise = noise;
    }

    /// Errors of odometry that repeat from node to node, as a wrong wheel radius or wheels that slip now and then make them, metres and
    /// radians per metre.
    pub(super) fn systematic_odometry_errors(&self) -> [f64; 2] {
        let [scale_m, scale_rad] = self.odometry_noise.of_wheels.scales();
        let c = &self.config.odometry;
        [SYSTEMATIC_SHARE * scale_m * c.sigma_m_per_m, SYSTEMATIC_SHARE * scale_rad * c.sigma_rad_per_m]
    }

    /// Standard deviations of a motion by odometry as configured, metres and radians.
    pub(super) fn configured_odometry_sigmas(&self, moved: Pose2) -> [f64; 2] {
        let c = &self.config.odometry;
        let (distance_m, turn_rad) = (moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs());
        [
            c.sigma_m + c.sigma_m_per_m * distance_m,
            c.sigma_rad + c.sigma_rad_per_rad * turn_rad + c.sigma_rad_per_m * distance_m,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::back_end::testing::straight_path;
    use crate::graph::PoseVariances;
    use posegraph::information_from_sigmas;

    const SIGMAS: [f64; 2] = [0.05, 0.04];

    /// The scales after `nodes` motions of 0.3 m whose error by odometry is `error(node)`.
    fn learned(nodes: u32, link_sigma: f64, error: impl Fn(u32) -> Pose2) -> [f64; 2] {
        let mut noise = OdometryNoise::new();
        for node in 0..nodes {
            let a_from_b = Pose2::new(0.3, 0.0, 0.1);
            let link = Edge {
                a: node,
                b: node + 1,
                a_from_b,
                information: information_from_sigmas(link_sigma, link_sigma),
                degenerate_direction_rad: None,
                kind: EdgeKind::ScanMatch,
                is_active: true,
                variances: PoseVariances::default(),
                response: 0.0,
            };
            let motion = OdometryMotion {
                nodes: [node, node + 1],
                first_from_last: a_from_b * error(node),
                slip: [0.0; 3],
                variances: SIGMAS.map(|sigma| sigma.powi(2)),
            };
            noise.observe(&motion, &link);
        }
        noise.scales()
    }

    /// Errors of alternating sign, of so many configured standard deviations.
    fn alternating(sigmas: f64) -> impl Fn(u32) -> Pose2 {
        move |node| {
            let sign = if node % 2 == 0 { sigmas } else { -sigmas };
            Pose2::new(sign * SIGMAS[0], sign * SIGMAS[0], sign * SIGMAS[1])
        }
    }

    #[test]
    fn good_wheels_are_believed_more_and_bad_ones_less_after_some_path() {
        assert_eq!(learned(0, 0.005, alternating(0.0)), [1.0, 1.0]);
        for scale in learned(400, 0.005, alternating(0.1)) {
            assert!((SCALE_MIN..0.4).contains(&scale), "{scale}");
        }
        for scale in learned(400, 0.005, alternating(1.5)) {
            assert!((1.3..1.6).contains(&scale), "{scale}");
        }
        assert_eq!(learned(400, 0.005, alternating(9.0)), [SCALE_MAX; 2]);
    }

    #[test]
    fn an_error_that_repeats_counts_by_how_it_adds_up() {
        let [_, alternates] = learned(400, 0.005, alternating(0.4));
        let [_, repeats] = learned(400, 0.005, |_| Pose2::new(0.0, 0.0, 0.4 * SIGMAS[1]));
        assert!(repeats > 2.0 * alternates, "{repeats} where it repeats, {alternates} where it does not");
    }

    #[test]
    fn slips_that_scans_took_out_of_odometry_are_learned_from() {
        let learned = |slip_m: f64| {
            let mut back = straight_path(200, 0.3);
            for id in 1..200 {
                back.nodes[id as usize].previous_from_this = Some(Pose2::IDENTITY);
                // One in 40 nodes, 12 m.
                back.nodes[id as usize].slip[0] = if id % 40 == 0 { slip_m } else { 0.0 };
                let moved = Pose2::new(0.3, 0.0, 0.0);
                for (kind, sigma) in [(EdgeKind::Odometry, 0.05), (EdgeKind::ScanMatch, 0.001)] {
                    let information = information_from_sigmas(sigma, sigma);
                    back.graph.add_edge([id - 1, id], moved, information, kind, [0.0; 2]);
                }
                back.learn_odometry_noise(id);
            }
            [back.odometry_noise.scales(), back.odometry_noise.of_wheels.scales()]
        };
        let ([edges, without], [same_edges, with]) = (learned(0.0), learned(0.4));
        assert!(with[0] > 2.0 * without[0] && with[1] == without[1], "{without:?} without, {with:?} with");
        assert!(same_edges == edges && edges == without, "edges have no slips: {edges:?}, {same_edges:?}");
    }

    #[test]
    fn scans_that_do_not_determine_the_motion_teach_nothing() {
        assert_eq!(learned(400, 0.2, alternating(0.1)), [1.0, 1.0]);
    }

    /// The scales that a back end learns on a path of exact odometry whose links span so many nodes each.
    fn learned_on_path(link_nodes: u32, link_sigma_m: f64, link_sigma_rad: f64) -> [f64; 2] {
        let mut back = straight_path(200, 0.3);
        for id in 1..200 {
            back.nodes[id as usize].previous_from_this = Some(Pose2::IDENTITY);
            let add = |back: &mut BackEnd, from: u32, kind: EdgeKind, information: Matrix3<f64>| {
                let moved = Pose2::new(0.3 * f64::from(id - from), 0.0, 0.0);
                back.graph.add_edge([from, id], moved, information, kind, [0.0; 2]);
            };
            add(&mut back, id - 1, EdgeKind::Odometry, information_from_sigmas(0.05, 0.04));
            if let Some(from) = id.checked_sub(link_nodes) {
                add(
                    &mut back,
                    from,
                    EdgeKind::ScanMatch,
                    information_from_sigmas(link_sigma_m, link_sigma_rad),
                );
            }
            back.learn_odometry_noise(id);
        }
        back.odometry_noise.scales()
    }

    #[test]
    fn odometry_that_is_better_than_two_scans_is_learned_over_several_nodes() {
        let configured = straight_path(1, 0.3).configured_odometry_sigmas(Pose2::new(0.3, 0.0, 0.0));
        // Too uncertain for one motion, and certain enough for four.
        let [sigma_m, sigma_rad] = configured.map(|sigma| 0.8 * sigma);
        assert_eq!(learned_on_path(1, sigma_m, sigma_rad), [1.0, 1.0]);
        for scale in learned_on_path(4, sigma_m, sigma_rad) {
            assert!((SCALE_MIN..0.4).contains(&scale), "{scale}");
        }
        // Each part of the path counts once.
        let (over_one, over_four) = (learned_on_path(1, 0.001, 0.001), learned_on_path(4, 0.001, 0.001));
        for (one, four) in over_one.into_iter().zip(over_four) {
            assert!((one - four).abs() < 0.02, "{one} and {four}");
        }
    }
}
