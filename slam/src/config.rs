//! Every limit and every tuned number of SLAM, with units and reasons. One default for all robots.

mod check;

pub use check::ConfigError;

use msg::Pose2;
use serde::{Deserialize, Serialize};

/// How a robot maps. The default serves 90° and 360° LiDARs, dense and thinned logs alike.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlamConfig {
    /// Where the LiDAR sits on the robot and which of its beams are believed.
    pub lidar: LidarConfig,
    /// What odometry is trusted with.
    pub odometry: OdometryConfig,
    /// The scan path: matching against the local map.
    pub tracking: TrackingConfig,
    /// Scan to scan constraints in the pose graph.
    pub links: LinkConfig,
    /// The search for places seen before.
    pub closures: ClosureConfig,
    /// The pose graph and its solver.
    pub graph: GraphConfig,
    /// The drawn grid.
    pub map: MapConfig,
    /// The search for a robot in a whole map.
    pub relocalize: RelocalizeConfig,
    /// What is forgotten when the map is to last.
    pub lifelong: LifelongConfig,
}

/// See [`SlamConfig::lidar`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarConfig {
    /// Pose of `base_scan` in `base_footprint`: x m, y m, yaw rad.
    pub base_from_scan: [f64; 3],
    /// Returns beyond it are not used for matching, metres.
    pub range_use_max_m: f32,
    /// Points of a scan are thinned to this spacing along the surface, metres.
    pub spacing_m: f32,
    /// The most points kept of a scan; the spacing grows until they fit.
    pub points_max: usize,
}

/// See [`SlamConfig::odometry`]. Standard deviations of what odometry says between two scans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometryConfig {
    /// False: scans alone.
    pub used: bool,
    /// The newest so many messages are kept.
    pub buffer_len: usize,
    /// A pose is extrapolated at most this far beyond the newest message, seconds.
    pub extrapolation_max_s: f64,
    /// Metres, however short the way.
    pub sigma_m: f64,
    /// Metres a metre driven.
    pub sigma_m_per_m: f64,
    /// Radians, however small the turn.
    pub sigma_rad: f64,
    /// Radians a radian turned.
    pub sigma_rad_per_rad: f64,
    /// Radians a metre driven.
    pub sigma_rad_per_m: f64,
    /// A robot is not faster than this, m/s: how far to search where odometry is missing.
    pub speed_max_m_s: f64,
    /// A robot does not turn faster than this, rad/s.
    pub turn_max_rad_s: f64,
}

/// See [`SlamConfig::tracking`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// A scan becomes a node when the robot has moved so far since the last one, metres.
    pub node_distance_m: f64,
    /// Or turned so far, radians.
    pub node_turn_rad: f64,
    /// Nodes drawn into a local map before it is retired; the next one starts at half of it.
    pub local_map_nodes: usize,
    /// Half the side of a local map's square, metres.
    pub local_map_reach_m: f32,
    /// Cell of the correlation field, metres.
    pub cell_m: f32,
    /// Standard deviation of the field's blur, metres.
    pub blur_m: f32,
    /// Largest half side of the search window, metres (no odometry, thinned log).
    pub window_max_m: f64,
    /// Largest half angle of the search window, radians.
    pub window_max_rad: f64,
    /// Points of the scan used in the correlation.
    pub search_points_max: usize,
    /// How many of the newest nodes' scans refine the pose.
    pub references: usize,
    /// Below this share of matched points the scan does not fit: the robot is lost.
    pub overlap_min: f32,
    /// Fewer points than this say nothing.
    pub points_min: usize,
    /// A direction known worse than this is degenerate, metres (one standard deviation).
    pub degenerate_sigma_m: f64,
    /// After so many scans that did not fit, a new local map is begun where odometry says.
    pub lost_scans_max: u32,
}

/// See [`SlamConfig::links`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinkConfig {
    /// Links to so many nodes just before.
    pub sequential: usize,
    /// Links to so many other nodes near by.
    pub near: usize,
    /// Only where the middles of what they see are this close, metres.
    pub distance_max_m: f64,
    /// Only where the relative position is known at least this well (one standard deviation), metres.
    pub sigma_max_m: f64,
    /// And the relative heading, radians.
    pub sigma_max_rad: f64,
    /// Share of a scan's points that must find their surface in the other scan.
    pub overlap_min: f32,
    /// Share of compared points that must not contradict what the other scan saw through.
    pub agreement_min: f32,
    /// Search radius of a point's surface in the first iterations, metres.
    pub gate_wide_m: f32,
    /// In the last ones.
    pub gate_narrow_m: f32,
    /// Scale of the robust weight, metres.
    pub cauchy_m: f64,
    /// Standard deviation of a matched point's distance from its surface, metres.
    pub point_sigma_m: f64,
    /// Points without a direction count so much of what they seem to say: far hits on a corridor's walls
    /// would hold a robot along it, where they say nothing.
    pub places_share: f64,
    /// No link is better than this, metres: what the sensor's and the surfaces' biases leave.
    pub floor_m: f64,
    /// Nor better than this, radians.
    pub floor_rad: f64,
    /// What chains of links are trusted with, when uncertainty is added up along them: a link adds
    /// so many metres a metre between its nodes,
    pub drift_m_per_m: f64,
    /// and so many radians a metre. Links of a chain err alike, so this is more than the floor.
    pub drift_rad_per_m: f64,
}

/// See [`SlamConfig::closures`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClosureConfig {
    /// False: the map is never closed.
    pub enabled: bool,
    /// Candidates lie within this distance beyond the position's uncertainty, metres.
    pub radius_m: f64,
    /// Largest half side of the search window, metres.
    pub window_max_m: f64,
    /// Largest half angle, radians.
    pub window_max_rad: f64,
    /// Standard deviations the window spans.
    pub window_sigmas: f64,
    /// Travel between two searches, metres.
    pub travel_m: f64,
    /// Way around the candidate that forms the map searched in, metres,
    pub chain_m: f64,
    /// and its most nodes.
    pub chain_nodes: usize,
    /// Way around the node that is searched for with it, metres,
    pub query_m: f64,
    /// and its most nodes.
    pub query_nodes: usize,
    /// Points of the query.
    pub query_points_max: usize,
    /// Mean field value under the query's points, 0 to 1.
    pub response_min: f32,
    /// A second, different place must score below this share of the best.
    pub rival_max: f32,
    /// Share of compared points that must not contradict what the other scans saw through.
    pub agreement_min: f32,
    /// Share of the query that must find a surface.
    pub overlap_min: f32,
    /// Searches from different places that must agree before a closure is believed.
    pub witnesses: usize,
    /// They agree within this, metres.
    pub agree_m: f64,
    /// And this, radians.
    pub agree_rad: f64,
    /// Field evaluations a search may cost; a search that needs more is given up.
    pub evaluations_max: usize,
}

/// See [`SlamConfig::graph`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GraphConfig {
    /// The most nodes; beyond them the robot tracks, but its map grows no more.
    pub nodes_max: usize,
    /// The most scans whose pose is remembered.
    pub trajectory_max: usize,
    /// Gauss-Newton steps of one solution.
    pub iterations_max: usize,
    /// A solution is done when no node moves more than this, metres or radians.
    pub step_min: f64,
    /// Scale of the robust cost of links, in standard deviations.
    pub cauchy_sigmas: f64,
    /// A solution is due when this share of all nodes is new since the last one.
    pub new_share: f64,
    /// A closure is taken back when the solved graph contradicts it by so many standard deviations.
    pub retract_sigmas: f64,
    /// A revision takes effect on the scan path so many nodes after the node that caused it.
    pub revision_lag_nodes: u32,
}

/// See [`SlamConfig::map`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapConfig {
    /// Side of a cell, metres.
    pub resolution_m: f64,
    /// Natural log-odds a hit adds.
    pub hit: f64,
    /// Natural log-odds a beam passing through takes away.
    pub miss: f64,
    /// Returns farther than this are not drawn, metres.
    pub range_max_m: f32,
    /// A beam without return clears the floor up to here at most, metres.
    pub clear_without_return_m: f32,
    /// Drawn again when a node has moved more than this, metres.
    pub redraw_m: f64,
    /// How far the robot's body reaches around `base_footprint`, metres: what it covers on its way is free,
    /// whatever its peers took it for. 0: not known, and nothing is drawn of it.
    pub robot_radius_m: f64,
}

/// See [`SlamConfig::relocalize`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelocalizeConfig {
    /// Mean field value under the query's points, 0 to 1.
    pub response_min: f32,
    /// Places that score above this share of the best are looked at too.
    pub rival_share: f32,
    /// The most places looked at closely in one search.
    pub places_max: usize,
    /// Share of the query that must find a surface.
    pub overlap_min: f32,
    /// Share of compared points that must not contradict what the other scans saw through.
    pub agreement_min: f32,
    /// Searches that must agree before the robot is believed to be found, without a hint.
    pub witnesses: usize,
    /// Travel between two of them, metres.
    pub apart_m: f64,
    /// Travel between two searches, metres; a turn of a radian counts as much.
    pub travel_m: f64,
    /// They agree within this, metres.
    pub agree_m: f64,
    /// And this, radians.
    pub agree_rad: f64,
    /// A robot is looked for within this distance of places where a scan was taken, metres.
    pub near_node_m: f64,
    /// Evaluations a search may cost; a search that needs more is given up.
    pub evaluations_max: usize,
    /// A robot that was told where it is, and has not been found there after so many nodes, is
    /// believed to be there all the same, in a part that is not mapped yet.
    pub hint_nodes: usize,
    /// Localization: after this way without a scan that fits, the robot is looked for everywhere, metres.
    pub give_up_m: f64,
}

/// See [`SlamConfig::lifelong`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LifelongConfig {
    /// Scans kept of the same view: the newest.
    pub views: usize,
    /// Views are the same within this distance, metres,
    pub view_m: f64,
    /// and this turn, radians.
    pub view_rad: f64,
    /// A scan of which a later one sees through this share is contradicted.
    pub contradicted_share: f32,
    /// After so many contradictions it is forgotten, if a later scan has much the same view.
    pub contradictions: u8,
    /// Forgotten nodes are taken out of the graph, and the map drawn anew, so many at a time.
    pub batch: usize,
    /// The newest so many nodes are not touched.
    pub newest: usize,
    /// The most nodes, however large the map.
    pub nodes_max: usize,
}

impl Default for RelocalizeConfig {
    fn default() -> Self {
        Self {
            response_min: 0.55,
            rival_share: 0.85,
            places_max: 12,
            overlap_min: 0.65,
            agreement_min: 0.93,
            witnesses: 3,
            apart_m: 1.0,
            travel_m: 0.5,
            agree_m: 0.25,
            agree_rad: 0.08,
            near_node_m: 3.0,
            evaluations_max: 2_000_000,
            hint_nodes: 10,
            give_up_m: 5.0,
        }
    }
}

impl Default for LifelongConfig {
    fn default() -> Self {
        Self {
            views: 3,
            view_m: 0.5,
            view_rad: 0.5,
            contradicted_share: 0.1,
            contradictions: 3,
            batch: 16,
            newest: 24,
            nodes_max: 8000,
        }
    }
}

impl Default for LidarConfig {
    fn default() -> Self {
        Self { base_from_scan: [0.0; 3], range_use_max_m: 30.0, spacing_m: 0.05, points_max: 400 }
    }
}

impl Default for OdometryConfig {
    fn default() -> Self {
        Self {
            used: true,
            buffer_len: 256,
            extrapolation_max_s: 0.3,
            sigma_m: 0.02,
            sigma_m_per_m: 0.1,
            sigma_rad: 0.02,
            sigma_rad_per_rad: 0.2,
            sigma_rad_per_m: 0.06,
            speed_max_m_s: 1.0,
            turn_max_rad_s: 1.0,
        }
    }
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            node_distance_m: 0.3,
            node_turn_rad: 0.3,
            local_map_nodes: 20,
            local_map_reach_m: 30.0,
            cell_m: 0.1,
            blur_m: 0.1,
            window_max_m: 1.2,
            window_max_rad: 0.7,
            search_points_max: 150,
            references: 6,
            overlap_min: 0.3,
            points_min: 12,
            degenerate_sigma_m: 0.1,
            lost_scans_max: 3,
        }
    }
}

impl Default for LinkConfig {
    fn default() -> Self {
        Self {
            sequential: 4,
            near: 6,
            distance_max_m: 5.0,
            sigma_max_m: 0.12,
            sigma_max_rad: 0.06,
            overlap_min: 0.35,
            agreement_min: 0.85,
            gate_wide_m: 0.3,
            gate_narrow_m: 0.12,
            cauchy_m: 0.04,
            point_sigma_m: 0.03,
            places_share: 0.02,
            floor_m: 0.01,
            floor_rad: 0.003,
            drift_m_per_m: 0.01,
            drift_rad_per_m: 0.003,
        }
    }
}

impl Default for ClosureConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            radius_m: 4.0,
            window_max_m: 6.0,
            window_max_rad: 0.5,
            window_sigmas: 3.0,
            travel_m: 0.8,
            chain_m: 14.0,
            chain_nodes: 48,
            query_m: 5.0,
            query_nodes: 16,
            query_points_max: 350,
            response_min: 0.5,
            rival_max: 0.9,
            agreement_min: 0.9,
            overlap_min: 0.5,
            witnesses: 2,
            agree_m: 0.25,
            agree_rad: 0.08,
            evaluations_max: 60_000,
        }
    }
}

impl Default for GraphConfig {
    fn default() -> Self {
        Self {
            nodes_max: 20_000,
            trajectory_max: 2_000_000,
            iterations_max: 10,
            step_min: 1e-4,
            cauchy_sigmas: 2.0,
            new_share: 0.1,
            retract_sigmas: 6.0,
            revision_lag_nodes: 4,
        }
    }
}

impl Default for MapConfig {
    fn default() -> Self {
        Self {
            resolution_m: 0.05,
            hit: 0.85,
            miss: 0.4,
            range_max_m: 25.0,
            clear_without_return_m: 4.0,
            redraw_m: 0.025,
            robot_radius_m: 0.0,
        }
    }
}

impl SlamConfig {
    /// Pose of `base_scan` in `base_footprint`.
    pub fn base_from_scan(&self) -> Pose2 {
        let [x, y, yaw] = self.lidar.base_from_scan;
        Pose2::new(x, y, yaw)
    }
}
