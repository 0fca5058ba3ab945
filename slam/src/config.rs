//! Configuration of SLAM: each key with its unit, its range, and why the default has its value.

mod check;
mod defaults;

pub use check::ConfigError;

use msg::Pose2;
use serde::{Deserialize, Serialize};

/// How a robot maps. The default serves 90° and 360° LiDARs, dense and thinned logs alike.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlamConfig {
    /// Where the LiDAR sits on the robot and which of its beams are used.
    pub lidar: LidarConfig,
    /// What odometry is trusted with.
    pub odometry: OdometryConfig,
    /// The scan path: matching against the local map.
    pub tracking: TrackingConfig,
    /// The point-to-line alignment of scans.
    pub alignment: AlignmentConfig,
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

/// The LiDAR: where it sits on the robot and which of its returns are used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarConfig {
    /// Pose of `base_scan` in `base_footprint`: x m, y m, yaw rad; each -10 to 10. Zero for logs,
    /// whose poses are the LiDAR's. A robot that is not simulated and sends its LiDAR's transforms
    /// is mapped by those.
    pub base_from_scan: [f64; 3],
    /// Returns beyond it are not used for matching, metres; 0.1 to 200. At 30 m the beams of a 1°
    /// LiDAR lie 0.5 m apart, too far for a surface direction.
    pub range_use_max_m: f32,
    /// Spacing that a scan's points are thinned to along the surface, metres; 0.005 to 1. It is the
    /// map's cell: denser points cost time and say the same.
    pub spacing_m: f32,
    /// The most points kept of a scan; 16 to 4096; the spacing grows until they fit. 400 bound an
    /// alignment to well below a millisecond.
    pub points_max: usize,
}

/// Odometry: whether it is used, and the standard deviations of what it says between two scans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometryConfig {
    /// Whether odometry is used; false: scans alone, which suffices in a room at 10 Hz.
    pub used: bool,
    /// Odometry messages kept; 2 to 65536. 256 are 5 s at 50 Hz, more than a scan is late.
    pub buffer_len: usize,
    /// How far a pose is extrapolated beyond the newest message, seconds; 0 or more. 0.3 s bridge a
    /// few lost messages.
    pub extrapolation_max_s: f64,
    /// Standard deviation of the position between two scans, however short the path, metres; 0.0001
    /// to 10.
    pub sigma_m: f64,
    /// Standard deviation added for each metre driven, metres; 0 or more. 5 % cover a TurtleBot3,
    /// 10 % an unknown robot, also a skid-steered one.
    pub sigma_m_per_m: f64,
    /// Standard deviation of the heading between two scans, however small the turn, radians; 0.0001
    /// to 3.
    pub sigma_rad: f64,
    /// Standard deviation added for each radian turned, radians; 0 or more. Turns are where wheels
    /// slip most: 20 % without a gyroscope, 2 % with one.
    pub sigma_rad_per_rad: f64,
    /// Standard deviation of the heading added for each metre driven, radians; 0 or more.
    pub sigma_rad_per_m: f64,
    /// Largest speed of a robot, m/s; above 0. It bounds the search window where odometry is
    /// missing.
    pub speed_max_m_s: f64,
    /// Largest turn rate of a robot, rad/s; above 0. It bounds the search window where odometry is
    /// missing.
    pub turn_max_rad_s: f64,
}

/// The front end: matching scans against the local map.
// More than 12 fields: one field for each key of one table of the fleet file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// A scan becomes a node when the robot has moved this far since the last node, metres; 0.01 to
    /// 5. At 0.3 m neighbouring scans still overlap at 90°.
    pub node_distance_m: f64,
    /// A scan becomes a node when the robot has turned this far since the last node, radians; 0.01
    /// to 3.2. It is a fifth of a 90° view.
    pub node_turn_rad: f64,
    /// Nodes drawn into a local map before it is retired; 2 to 200; the next one starts at half of
    /// it. 20 nodes are 6 m, over which drift stays below a cell.
    pub local_map_nodes: usize,
    /// Half the side of a local map's square, metres; 2 to 60. It is the usable range of the LiDAR.
    pub local_map_reach_m: f32,
    /// Side of a cell of the likelihood field, metres; 0.02 to 0.5. 5 cm cells were as accurate and
    /// took twice the time.
    pub cell_m: f32,
    /// Standard deviation of the field's blur, metres; 0.01 to 1. One cell, so that the alignment
    /// starts within its gate.
    pub blur_m: f32,
    /// Largest half side of the search window, metres; 0.05 to 10. Thinned logs have steps of up to
    /// 1 m.
    pub window_max_m: f64,
    /// Largest half angle of the search window, radians; 0.01 to 3.2. Thinned logs have turns of up
    /// to 0.5 rad.
    pub window_max_rad: f64,
    /// Points of the scan used in the search; 1 to 4096. 150 find the same peak as all of them.
    pub search_points_max: usize,
    /// Newest nodes whose scans the pose is aligned with; 1 to 64. 6 nodes span 2 m: enough views,
    /// little drift.
    pub references: usize,
    /// Least share of matched points, 0 to 1; below it the scan does not fit and the robot is lost.
    pub overlap_min: f32,
    /// Least number of surface points; 1 to 4096; a scan with fewer is not matched. A dozen points
    /// determine a pose only barely.
    pub points_min: usize,
    /// A pose whose position is less certain than this in some direction is degenerate, metres (one
    /// standard deviation); above 0. Two cells of the map.
    pub degenerate_sigma_m: f64,
    /// Scans in a row that do not fit before a new local map begins where odometry says; 1 or more.
    /// One alone may be somebody passing by.
    pub lost_scans_max: u32,
}

/// Point-to-line alignment of scans (`align.rs`), wherever scans are aligned: tracking, links, closures, relocalization.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignmentConfig {
    /// Search radius of a point's surface in the first iterations, metres; 0.01 to 0.5. It is the
    /// largest error of a guess.
    pub gate_wide_m: f32,
    /// Search radius in the last iterations, metres; 0.01 to 0.5. 4 standard deviations of a point.
    pub gate_narrow_m: f32,
    /// Scale of the alignment's Cauchy weights, metres; above 0. A little more than a point's
    /// standard deviation.
    pub cauchy_m: f64,
    /// Standard deviation of a matched point's distance from its surface, metres; 0.0001 to 1.
    /// LiDAR noise and thinning together.
    pub point_sigma_m: f64,
}

/// Scan-to-scan links in the pose graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinkConfig {
    /// Nodes just before a node that it is linked with; 1 to 64. 4 make the chain stiff against one
    /// bad alignment.
    pub sequential: usize,
    /// Other nodes near by that a node is linked with; 0 to 64. More than 6 cost time and add
    /// little.
    pub near: usize,
    /// Largest distance between the middles of what two linked scans see, metres; above 0. Beyond 5
    /// m they hardly overlap.
    pub distance_max_m: f64,
    /// Largest standard deviation of the relative position for a link without a search, metres;
    /// above 0. It is the alignment's narrow gate.
    pub sigma_max_m: f64,
    /// Largest standard deviation of the relative heading for a link without a search, radians;
    /// above 0.
    pub sigma_max_rad: f64,
    /// Least share of a scan's points that find their surface in the other scan, 0 to 1.
    pub overlap_min: f32,
    /// Least share of the compared points that do not contradict what the other scan saw through, 0
    /// to 1.
    pub agreement_min: f32,
    /// Share of their information that points without a surface direction count in links, 0 to 1.
    /// They would hold a robot along a corridor, where they say nothing; 0.1 and 0.3 were worse at
    /// 90°.
    pub point_landmark_weight: f64,
    /// Least standard deviation of a link's position, metres; above 0: what the biases of sensor
    /// and surfaces leave.
    pub sigma_min_m: f64,
    /// Least standard deviation of a link's heading, radians; above 0.
    pub sigma_min_rad: f64,
    /// Standard deviation that a link adds for each metre between its nodes when uncertainty is
    /// propagated, metres; 0 or more. Links of a chain err alike, so this is more than `sigma_min_m`;
    /// without it a loop in aces stayed open.
    pub drift_m_per_m: f64,
    /// The same of the heading, radians for each metre; 0 or more.
    pub drift_rad_per_m: f64,
}

/// Loop closures: where to search, and what a closure must pass.
// More than 12 fields: one field for each key of one table of the fleet file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClosureConfig {
    /// Whether loops are closed.
    pub enabled: bool,
    /// Candidates lie within this distance beyond the position's uncertainty, metres; 0 or more.
    /// Scans farther apart rarely overlap.
    pub radius_m: f64,
    /// Largest half side of the search window, metres; 0.1 to 50. It costs its square: 6 m take 30
    /// to 100 ms.
    pub window_max_m: f64,
    /// Largest half angle of the search window, radians; above 0.
    pub window_max_rad: f64,
    /// Half size of the window in standard deviations of what is known; above 0.
    pub window_sigmas: f64,
    /// Path between two searches, metres; 0 or more. Two searches that agree must come from
    /// different places.
    pub travel_m: f64,
    /// Length of the path around the candidate that the searched map is drawn from, metres; above
    /// 0. Twice the window and a view.
    pub chain_m: f64,
    /// The most nodes of that path; 1 to 200.
    pub chain_nodes: usize,
    /// Length of the path whose scans are searched for together, metres; above 0. One scan alone
    /// looks alike in many corridors.
    pub query_m: f64,
    /// The most nodes of that path; 1 to 100.
    pub query_nodes: usize,
    /// Points of the query; 1 or more. The cost of a search is proportional to it.
    pub query_points_max: usize,
    /// Least mean field value under the query's points, 0 to 1.
    pub response_min: f32,
    /// A second, different pose must score below this share of the best one, 0 to 1; else the place is ambiguous.
    ///
    /// 0.84 leaves fewer wrong closures on generated logs, but loops of intel at 90° stay open.
    pub ambiguity_ratio_max: f32,
    /// Least share of compared points that do not contradict what the other scans saw through, 0 to
    /// 1.
    pub agreement_min: f32,
    /// Least share of the query that finds a surface, 0 to 1.
    pub overlap_min: f32,
    /// Searches from different places that must agree before a closure is accepted; 1 or more. One
    /// alone may be a corridor that looks alike.
    pub confirmations_min: usize,
    /// Two searches agree within this distance, metres; above 0. Drift between them and the field's
    /// cells.
    pub agree_m: f64,
    /// Two searches agree within this angle, radians; above 0.
    pub agree_rad: f64,
    /// Evaluations that a search may cost; 1 or more. A search that needs more is given up: 60 000
    /// take about 0.1 s.
    pub evaluations_max: usize,
}

/// The pose graph, its limits and its solver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GraphConfig {
    /// The most nodes; 2 to 1 000 000; beyond them the robot tracks, but its map grows no more. 20
    /// 000 are 6 km.
    pub nodes_max: usize,
    /// The most scans whose pose is remembered; 0 to 10 000 000. 2 000 000 are 55 hours at 10 Hz.
    pub trajectory_max: usize,
    /// Iterations of one solution; 1 or more. Four of them graduate the kernels after a closure;
    /// the rest converge.
    pub iterations_max: usize,
    /// A solution has converged when no pose moves more than this, metres or radians; above 0. Far
    /// below a cell.
    pub step_min: f64,
    /// Scale of the robust kernel of all edges, standard deviations; 0.1 to 1 000 000. SLAM's own
    /// links may be wrong as well as closures, so all edges are robust.
    pub cauchy_sigmas: f64,
    /// Share of all nodes that must have new links to older parts before a solution without a
    /// closure, 0 to 1.
    pub new_share: f64,
    /// Standard deviation of errors of the heading that repeat along a way, radians per metre; 0 or more. They add up as they
    /// are, not as variances, and bend the whole way to one side: a loop of 150 m may be 4 m off, as in a large hall whose far walls
    /// bend all links alike.
    pub bias_rad_per_m: f64,
    /// Standard deviations by which the solved graph contradicts a closure that is then removed;
    /// above 0. 10 instead of 6 gave the same error.
    pub retract_sigmas: f64,
    /// Nodes after its cause at which a frame update takes effect in the front end; 1 to 64. Enough
    /// that a back end that keeps up has answered, so that runs repeat.
    pub frame_update_lag_nodes: u32,
}

/// The occupancy grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapConfig {
    /// Side of a cell, metres; 0.01 to 1. ROS 2's usual 5 cm.
    pub resolution_m: f64,
    /// Natural log-odds that a hit adds; 0.05 to 6. A probability of 0.7.
    pub hit_log_odds: f64,
    /// Natural log-odds that a beam passing through takes away; 0.05 to 6. A probability of 0.4:
    /// two misses outweigh a hit.
    pub miss_log_odds: f64,
    /// Returns farther than this are not drawn, metres; 0.1 to 200. Heading errors smear them over
    /// more than a cell.
    pub range_max_m: f32,
    /// A beam without return clears the floor up to here at most, metres; 0 or more. Dark surfaces
    /// return nothing either.
    pub clear_without_return_m: f32,
    /// Nodes that moved more than this are drawn again, metres; 0 or more. Half a cell: less does
    /// not show.
    pub redraw_m: f64,
    /// Radius of the robot's body around `base_footprint`, metres; 0 to 2. What it covers on its
    /// path is free, whatever its peers took it for; 0: not known, nothing is drawn of it.
    pub robot_radius_m: f64,
}

/// The search for a robot in a whole map.
// More than 12 fields: one field for each key of one table of the fleet file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelocalizeConfig {
    /// Least mean field value under the query's points, 0 to 1. Higher than a closure's: the whole
    /// map has more places that look alike.
    pub response_min: f32,
    /// Poses that score above this share of the best one are verified too, 0 to 1.
    pub candidate_ratio_min: f32,
    /// The most poses verified in one search; 1 to 100.
    pub places_max: usize,
    /// Least share of the query that finds a surface, 0 to 1.
    pub overlap_min: f32,
    /// Least share of compared points that do not contradict what the other scans saw through, 0 to
    /// 1.
    pub agreement_min: f32,
    /// Searches that must agree before the robot counts as located, without an estimate; 1 or more.
    pub confirmations_min: usize,
    /// Path between two searches that count as independent, metres; 0 or more.
    pub confirmation_distance_m: f64,
    /// Path between two searches, metres; 0 or more; a turn of a radian counts as much.
    pub travel_m: f64,
    /// Searches agree within this distance, metres; above 0.
    pub agree_m: f64,
    /// Searches agree within this angle, radians; above 0.
    pub agree_rad: f64,
    /// The robot is searched for within this distance of nodes, metres; 0.1 to 1000. Robots drive
    /// where robots drove.
    pub near_node_m: f64,
    /// Evaluations that a search may cost; 1 to 10^9. A search that needs more is given up: 2 000
    /// 000 take about 0.9 s.
    pub evaluations_max: usize,
    /// Nodes after which a robot that was given an estimate and was not found there is taken to
    /// be there, in a part that is not mapped yet; 1 or more.
    pub estimate_nodes_max: usize,
    /// Localization: path without a scan that fits after which the whole map is searched, metres;
    /// above 0.
    pub give_up_m: f64,
}

/// What a map that lasts removes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LifelongConfig {
    /// Newest scans kept of the same view; 1 to 100. Three outvote one that saw somebody pass.
    pub views: usize,
    /// Views are the same within this distance, metres; 0 or more.
    pub view_m: f64,
    /// Views are the same within this turn, radians; 0 or more.
    pub view_rad: f64,
    /// Share of a scan that a later one must see through to contradict it, 0 to 1.
    pub contradicted_share: f32,
    /// Contradictions after which a scan is removed, if a later one has much the same view; 1 or
    /// more.
    pub contradictions: u8,
    /// Nodes removed from the graph at a time; 1 to 1000; the map is then drawn anew, which costs
    /// more than the nodes.
    pub batch: usize,
    /// The newest nodes, which are never removed; 0 or more. The front end refers to them.
    pub newest: usize,
    /// The most nodes, however large the map; 100 to 1 000 000.
    pub nodes_max: usize,
}

impl SlamConfig {
    /// Pose of `base_scan` in `base_footprint`.
    pub fn base_from_scan(&self) -> Pose2 {
        let [x, y, yaw] = self.lidar.base_from_scan;
        Pose2::new(x, y, yaw)
    }
}
