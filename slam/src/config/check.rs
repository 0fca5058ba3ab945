//! Whether a configuration can be worked with.

use super::SlamConfig;

/// A number of the configuration that cannot be worked with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("slam.{field} is {found}, expected {expected}")]
pub struct ConfigError {
    /// The field's path below `slam`.
    pub field: &'static str,
    /// What it holds.
    pub found: f64,
    /// What it may hold.
    pub expected: &'static str,
}

impl SlamConfig {
    /// Checks that every number can be worked with.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let between = |field, found: f64, low: f64, high: f64, expected| {
            let sound = found >= low && found <= high;
            if sound { Ok(()) } else { Err(ConfigError { field, found, expected }) }
        };
        for value in self.lidar.base_from_scan {
            between("lidar.base_from_scan", value, -10.0, 10.0, "three numbers within 10 m (rad)")?;
        }
        let (lidar, tracking, map) = (&self.lidar, &self.tracking, &self.map);
        between("lidar.range_use_max_m", lidar.range_use_max_m.into(), 0.1, 200.0, "0.1 to 200 m")?;
        between("lidar.spacing_m", lidar.spacing_m.into(), 0.005, 1.0, "0.005 to 1 m")?;
        between("lidar.points_max", lidar.points_max as f64, 16.0, 4096.0, "16 to 4096")?;
        between("odometry.buffer_len", self.odometry.buffer_len as f64, 2.0, 65536.0, "2 to 65536")?;
        between("odometry.sigma_m", self.odometry.sigma_m, 1e-4, 10.0, "0.0001 to 10 m")?;
        between("odometry.sigma_rad", self.odometry.sigma_rad, 1e-4, 3.0, "0.0001 to 3 rad")?;
        between("tracking.node_distance_m", tracking.node_distance_m, 0.01, 5.0, "0.01 to 5 m")?;
        between("tracking.node_turn_rad", tracking.node_turn_rad, 0.01, 3.2, "0.01 to 3.2 rad")?;
        between("tracking.local_map_nodes", tracking.local_map_nodes as f64, 2.0, 200.0, "2 to 200")?;
        between("tracking.local_map_reach_m", tracking.local_map_reach_m.into(), 2.0, 60.0, "2 to 60 m")?;
        between("tracking.cell_m", tracking.cell_m.into(), 0.02, 0.5, "0.02 to 0.5 m")?;
        between("tracking.blur_m", tracking.blur_m.into(), 0.01, 1.0, "0.01 to 1 m")?;
        between("tracking.window_max_m", tracking.window_max_m, 0.05, 10.0, "0.05 to 10 m")?;
        between("tracking.window_max_rad", tracking.window_max_rad, 0.01, 3.2, "0.01 to 3.2 rad")?;
        let search_points_max = tracking.search_points_max as f64;
        between("tracking.search_points_max", search_points_max, 1.0, 4096.0, "1 to 4096")?;
        between("tracking.references", tracking.references as f64, 1.0, 64.0, "1 to 64")?;
        between("links.sequential", self.links.sequential as f64, 1.0, 64.0, "1 to 64")?;
        between("links.near", self.links.near as f64, 0.0, 64.0, "0 to 64")?;
        between("links.gate_wide_m", self.links.gate_wide_m.into(), 0.01, 0.5, "0.01 to 0.5 m")?;
        between("links.gate_narrow_m", self.links.gate_narrow_m.into(), 0.01, 0.5, "0.01 to 0.5 m")?;
        between("links.places_share", self.links.places_share, 0.0, 1.0, "0 to 1")?;
        between("links.point_sigma_m", self.links.point_sigma_m, 1e-4, 1.0, "0.0001 to 1 m")?;
        between("closures.window_max_m", self.closures.window_max_m, 0.1, 50.0, "0.1 to 50 m")?;
        between("closures.query_nodes", self.closures.query_nodes as f64, 1.0, 100.0, "1 to 100")?;
        between("closures.chain_nodes", self.closures.chain_nodes as f64, 1.0, 200.0, "1 to 200")?;
        between("graph.nodes_max", self.graph.nodes_max as f64, 2.0, 1e6, "2 to 1 000 000")?;
        let trajectory_max = self.graph.trajectory_max as f64;
        between("graph.trajectory_max", trajectory_max, 0.0, 1e7, "0 to 10 000 000")?;
        between("graph.cauchy_sigmas", self.graph.cauchy_sigmas, 0.1, 1e6, "0.1 to 1 000 000")?;
        between("map.resolution_m", map.resolution_m, 0.01, 1.0, "0.01 to 1 m")?;
        between("map.hit", map.hit, 0.05, 6.0, "0.05 to 6 (natural log-odds)")?;
        between("map.miss", map.miss, 0.05, 6.0, "0.05 to 6 (natural log-odds)")?;
        between("map.robot_radius_m", map.robot_radius_m, 0.0, 2.0, "0 to 2 m")?;
        let (r, l) = (&self.relocalize, &self.lifelong);
        between("relocalize.places_max", r.places_max as f64, 1.0, 100.0, "1 to 100")?;
        between("relocalize.near_node_m", r.near_node_m, 0.1, 1e3, "0.1 to 1000 m")?;
        between("relocalize.evaluations_max", r.evaluations_max as f64, 1.0, 1e9, "1 to 10^9")?;
        between("lifelong.views", l.views as f64, 1.0, 100.0, "1 to 100")?;
        between("lifelong.batch", l.batch as f64, 1.0, 1000.0, "1 to 1000")?;
        between("lifelong.nodes_max", l.nodes_max as f64, 100.0, 1e6, "100 to 1 000 000")?;
        between("map.range_max_m", map.range_max_m.into(), 0.1, 200.0, "0.1 to 200 m")
    }
}
