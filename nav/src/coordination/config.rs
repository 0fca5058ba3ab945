//! Parameters of coordinated exploration.

use crate::config::RobotBody;
use core::f64::consts::FRAC_PI_2;

/// An area for which no robot goes to a viewpoint, however little is known, square metres: less than 20 cells.
const GAIN_LAST_LEAST_M2: f64 = 0.04;

/// Parameters of the coordinator. The robots' scans replace angle and range. The defaults suit TurtleBot3 Burgers with the paper's LiDAR of 90 degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoordinationConfig {
    /// Size of the robots: goals lie where all of them fit.
    pub body: RobotBody,
    /// Angle that the sensor sees, radians, above 0.
    pub view_angle_rad: f64,
    /// Range to which unknown space is expected to be seen, metres, above 0: a little less than the sensor's.
    pub view_range_m: f64,
    /// Depth of unknown space at which it is open with a chance of 1/e, metres, above 0. About half a small room.
    pub unknown_depth_m: f64,
    /// Share of a viewpoint's area that the look around has to cover, 0 to 1. The rest costs more turning than it is
    /// worth.
    pub sweep_share: f64,
    /// Smallest area for which a robot goes to a viewpoint while larger ones are left, square metres.
    pub gain_min_m2: f64,
    /// Smallest area for which it goes there at all, as a share of the known area, 0 to 1; between 0.04 m² and `gain_min_m2`. Pockets of
    /// 0.04 m² are 0.01 % of a hall's floor, and took fleets of three as long as all the rest.
    pub gain_last_share: f64,
    /// Most viewpoints of a plan; bounds its time. Where unknown floor separates robots, each part of the floor has its share of them, and of what the parts before it leave over.
    pub viewpoints_max: usize,
    /// Area that each viewpoint counts in addition to its own, square metres: small pockets are seen while near.
    pub pocket_m2: f64,
    /// Worth of ending early, square metres: weight of the last arrival against the sum of all.
    pub makespan_weight_m2: f64,
    /// Time that a change of goal has to save, seconds. Less lets robots waver: with 5 s fleets of three need 15 % longer for 95 % of the
    /// warehouses 1 to 8, with 40 s as long.
    pub switch_cost_s: f64,
    /// Time between two plans, seconds, above 0.
    pub replan_period_s: f64,
}

impl CoordinationConfig {
    /// Smallest area for which a robot goes to a viewpoint when so much is known, square metres.
    pub(super) fn gain_last_m2(&self, known_m2: f64) -> f64 {
        (self.gain_last_share * known_m2).min(self.gain_min_m2).max(GAIN_LAST_LEAST_M2)
    }
}

impl Default for CoordinationConfig {
    fn default() -> Self {
        Self {
            body: RobotBody::default(),
            view_angle_rad: FRAC_PI_2,
            view_range_m: 3.3,
            unknown_depth_m: 1.5,
            sweep_share: 0.85,
            gain_min_m2: 0.25,
            gain_last_share: 0.001,
            viewpoints_max: 32,
            pocket_m2: 1.5,
            makespan_weight_m2: 10.0,
            switch_cost_s: 15.0,
            replan_period_s: 1.0,
        }
    }
}
