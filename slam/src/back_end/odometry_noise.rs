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

/// Share of the configured errors of odometry that repeat from node to node.
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

    fn add(&mut self, chi_squared: f64) {
        if self.weight >= self.memory {
            let kept = 1.0 - 1.0 / self.memory;
            (self.sum, self.weight) = (self.sum * kept, self.weight * kept);
        }
        self.sum += chi_squared.min(CHI_SQUARED_MAX);
        self.weight += 1.0;
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

    fn observe(&mut self, error: [f64; N], variance: f64) {
        let squared = |v: &[f64; N]| v.iter().map(|e| e * e).sum::<f64>() / N as f64;
        self.single.add(squared(&error) / variance);
        self.sum.iter_mut().zip(error).for_each(|(sum, error)| *sum += error);
        self.variance += variance;
        self.count += 1;
        if self.count == BLOCK_NODES {
            self.blocks.add(squared(&self.sum) / self.variance);
            (self.sum, self.variance, self.count) = ([0.0; N], 0.0, 0);
        }
    }

    fn scale(&self) -> f64 {
        self.single.mean().max(self.blocks.mean()).sqrt().clamp(SCALE_MIN, SCALE_MAX)
    }
}

/// How much better or worse this robot's odometry is than the configuration says.
#[derive(Clone, Copy, Debug)]
pub(super) struct OdometryNoise {
    distance: NoiseScale<2>,
    heading: NoiseScale<1>,
}

impl OdometryNoise {
    pub fn new() -> Self {
        Self { distance: NoiseScale::new(), heading: NoiseScale::new() }
    }

    /// Factors of the configured standard deviations: of distances and of headings.
    pub fn scales(&self) -> [f64; 2] {
        [self.distance.scale(), self.heading.scale()]
    }

    /// Compares a motion by odometry with the same one by the scans; `sigmas` are odometry's by the configuration, metres and
    /// radians.
    fn observe(&mut self, odometry: Pose2, link: &Edge, sigmas: [f64; 2]) {
        let information = link.information + Matrix3::identity() * REGULARISATION;
        let Some(covariance) = information.try_inverse() else { return };
        let error = link.a_from_b.between(odometry);
        let [limit_m, limit_rad] = sigmas.map(|sigma| (DETERMINED_SHARE * sigma).powi(2));
        let position = covariance.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().max();
        if position < limit_m && odometry.x_m.hypot(odometry.y_m) > DRIVEN_M {
            self.distance.observe([error.x_m, error.y_m], sigmas[0].powi(2));
        }
        if covariance[(2, 2)] < limit_rad {
            self.heading.observe([error.yaw_rad], sigmas[1].powi(2));
        }
    }
}

impl BackEnd {
    /// Learns from the motion to a node how good odometry is, if a link determines it as well.
    pub(super) fn learn_odometry_noise(&mut self, id: u32) {
        let to_here =
            |kind: EdgeKind| move |edge: &&Edge| edge.kind == kind && edge.b == id && edge.a + 1 == id;
        let odometry = self.graph.edges_of(id).find(to_here(EdgeKind::Odometry)).copied();
        let link = self.graph.edges_of(id).find(to_here(EdgeKind::ScanMatch)).copied();
        let Some((odometry, link)) = odometry.zip(link) else { return };
        if self.nodes[id as usize].previous_from_this.is_some() {
            let sigmas = self.configured_odometry_sigmas(odometry.a_from_b);
            self.odometry_noise.observe(odometry.a_from_b, &link, sigmas);
        }
    }

    /// Errors of odometry that repeat from node to node, as a wrong wheel radius makes them, metres and radians per metre.
    pub(super) fn systematic_odometry_errors(&self) -> [f64; 2] {
        let [scale_m, scale_rad] = self.odometry_noise.scales();
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
                kind: EdgeKind::ScanMatch,
                is_active: true,
                variance: [0.0; 2],
                response: 0.0,
            };
            noise.observe(a_from_b * error(node), &link, SIGMAS);
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
    fn scans_that_do_not_determine_the_motion_teach_nothing() {
        assert_eq!(learned(400, 0.2, alternating(0.1)), [1.0, 1.0]);
    }
}
