//! The default configuration: one for all robots, 90° and 360° LiDARs, dense and thinned logs alike.

use super::{
    AlignmentConfig, ClosureConfig, GraphConfig, LidarConfig, LifelongConfig, LinkConfig, MapConfig,
    OdometryConfig, RelocalizeConfig, TrackingConfig,
};

impl Default for RelocalizeConfig {
    fn default() -> Self {
        Self {
            response_min: 0.55,
            candidate_ratio_min: 0.85,
            places_max: 12,
            overlap_min: 0.65,
            agreement_min: 0.93,
            confirmations_min: 3,
            confirmation_distance_m: 1.0,
            travel_m: 0.5,
            agree_m: 0.25,
            agree_rad: 0.08,
            near_node_m: 3.0,
            evaluations_max: 2_000_000,
            estimate_nodes_max: 10,
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

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self { gate_wide_m: 0.3, gate_narrow_m: 0.12, cauchy_m: 0.04, point_sigma_m: 0.03 }
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
            point_landmark_weight: 0.02,
            sigma_min_m: 0.01,
            sigma_min_rad: 0.003,
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
            ambiguity_ratio_max: 0.885,
            agreement_min: 0.9,
            overlap_min: 0.5,
            confirmations_min: 2,
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
            bias_rad_per_m: 0.001,
            retract_sigmas: 6.0,
            frame_update_lag_nodes: 4,
        }
    }
}

impl Default for MapConfig {
    fn default() -> Self {
        Self {
            resolution_m: 0.05,
            hit_log_odds: 0.85,
            miss_log_odds: 0.4,
            range_max_m: 25.0,
            clear_without_return_m: 4.0,
            redraw_m: 0.025,
            robot_radius_m: 0.0,
        }
    }
}
