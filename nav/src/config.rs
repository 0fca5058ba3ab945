//! Parameters of navigation, with unit, range and the reason for each default.

use thiserror::Error;

/// All parameters of one robot's navigation. The defaults suit a TurtleBot3 Burger.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NavConfig {
    /// Size of the robot.
    pub body: RobotBody,
    /// Driving along a path.
    pub follower: FollowerConfig,
    /// Choice of goals.
    pub exploration: ExplorationConfig,
}

/// Size of a robot, taken as a disc around its axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotBody {
    /// Radius of the disc that the robot is taken for, metres, above 0. A Burger's is 0.105 m, as in its own navigation. Its rear corners
    /// are 0.124 m from the axis: the margin covers them.
    pub radius_m: f64,
    /// Space kept free around the body on planned paths, metres, from 0. 0.06 m covers the error of the pose.
    pub margin_m: f64,
}

impl RobotBody {
    /// Least clearance, metres, of a map's cell in which the body with its margin fits; cells have sides of `cell_size_m`.
    pub fn clearance_min_m(&self, cell_size_m: f64) -> f64 {
        self.radius_m + self.margin_m + cell_size_m / 2.0
    }
}

impl Default for RobotBody {
    fn default() -> Self {
        Self { radius_m: 0.105, margin_m: 0.06 }
    }
}

/// Parameters of the path follower and the collision limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerConfig {
    /// Speed along a straight path, m/s, above 0. 0.15 m/s is the fleet's default limit.
    pub cruise_m_s: f64,
    /// Largest turning speed, rad/s, above 0. At 0.9 rad/s scans of 10 Hz still overlap well.
    pub turn_rad_s: f64,
    /// Shortest distance to the point steered for, metres, above 0. Shorter ones make the heading swing.
    pub lookahead_min_m: f64,
    /// Longest distance to the point steered for, metres, at least the shortest. Longer ones cut corners.
    pub lookahead_max_m: f64,
    /// Distance at which the end of the path is reached, metres, above 0. Two cells of the map.
    pub goal_tolerance_m: f64,
    /// Heading error from which the robot turns on the spot, radians, above `turn_until_rad`. From 0.8 rad on a
    /// curve would leave the path by more than the margin.
    pub turn_from_rad: f64,
    /// Heading error at which it drives on again, radians, above 0.
    pub turn_until_rad: f64,
    /// Turning speed per heading error, 1/s, above 0. 2 turns the robot in half a second without overshoot at 20 Hz.
    pub heading_gain_1_s: f64,
    /// Free distance at which the robot stops, metres, from 0. Covers one scan period at cruise speed and braking.
    pub stop_distance_m: f64,
    /// Speed allowed per metre of further free distance, 1/s, above 0. 0.6 allows 0.15 m/s from 0.32 m on.
    pub speed_per_distance_1_s: f64,
    /// Space to each side of the body in which an obstacle ahead counts, metres, from 0.
    pub side_margin_m: f64,
}

impl Default for FollowerConfig {
    fn default() -> Self {
        Self {
            cruise_m_s: 0.15,
            turn_rad_s: 0.9,
            lookahead_min_m: 0.12,
            lookahead_max_m: 0.35,
            goal_tolerance_m: 0.1,
            turn_from_rad: 0.8,
            turn_until_rad: 0.25,
            heading_gain_1_s: 2.0,
            stop_distance_m: 0.07,
            speed_per_distance_1_s: 0.6,
            side_margin_m: 0.015,
        }
    }
}

/// Parameters of the choice between frontiers. Utilities and costs are in seconds of driving.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExplorationConfig {
    /// Distance from which a frontier is looked at, at the first and at the second attempt, metres, falling. After
    /// that it is left alone: some surfaces never return a beam.
    pub viewing_distances_m: [f64; 2],
    /// Mean speed expected on a path, m/s, above 0. A little below cruise speed.
    pub expected_speed_m_s: f64,
    /// Mean turning speed expected, rad/s, above 0. A little below the turning speed.
    pub expected_turn_rad_s: f64,
    /// Utility of a metre of frontier, s/m, from 0. The detour that its new space is worth.
    pub utility_s_per_m: f64,
    /// Length of frontier beyond which the utility grows no more, metres, from 0. What one look shows.
    pub utility_length_max_m: f64,
    /// Bonus of the current goal, seconds, from 0. Less lets the robot waver between two goals.
    pub current_goal_bonus_s: f64,
    /// Distance at which two goals are the same, metres, above 0. Frontiers move as the map grows.
    pub same_goal_m: f64,
    /// Distance to another robot's goal within which a frontier is left to that robot, metres, from 0.
    pub assigned_radius_m: f64,
    /// Cost of a frontier left to another robot, seconds, from 0. It is still taken if all else is farther.
    pub assigned_cost_s: f64,
    /// Time between two plans, seconds, above 0. About the period of the maps.
    pub replan_period_s: f64,
}

impl Default for ExplorationConfig {
    fn default() -> Self {
        Self {
            viewing_distances_m: [1.8, 0.6],
            expected_speed_m_s: 0.14,
            expected_turn_rad_s: 0.8,
            utility_s_per_m: 5.0,
            utility_length_max_m: 1.2,
            current_goal_bonus_s: 4.0,
            same_goal_m: 0.4,
            assigned_radius_m: 1.2,
            assigned_cost_s: 12.0,
            replan_period_s: 1.0,
        }
    }
}

/// A parameter is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("nav parameter {name} is {value}, expected {expected}")]
pub struct NavConfigError {
    /// Name of the parameter.
    pub name: &'static str,
    /// Value of the parameter, which lies outside the range.
    pub value: f64,
    /// The range that it has to lie in.
    pub expected: &'static str,
}

impl NavConfig {
    /// Checks that every parameter is in its range.
    pub fn validate(&self) -> Result<(), NavConfigError> {
        let (body, f, e) = (&self.body, &self.follower, &self.exploration);
        let above_zero = [
            ("body.radius_m", body.radius_m),
            ("follower.cruise_m_s", f.cruise_m_s),
            ("follower.turn_rad_s", f.turn_rad_s),
            ("follower.lookahead_min_m", f.lookahead_min_m),
            ("follower.goal_tolerance_m", f.goal_tolerance_m),
            ("follower.turn_until_rad", f.turn_until_rad),
            ("follower.heading_gain_1_s", f.heading_gain_1_s),
            ("follower.speed_per_distance_1_s", f.speed_per_distance_1_s),
            ("exploration.viewing_distances_m[1]", e.viewing_distances_m[1]),
            ("exploration.expected_speed_m_s", e.expected_speed_m_s),
            ("exploration.expected_turn_rad_s", e.expected_turn_rad_s),
            ("exploration.same_goal_m", e.same_goal_m),
            ("exploration.replan_period_s", e.replan_period_s),
        ];
        let from_zero = [
            ("body.margin_m", body.margin_m),
            ("follower.stop_distance_m", f.stop_distance_m),
            ("follower.side_margin_m", f.side_margin_m),
            ("exploration.utility_s_per_m", e.utility_s_per_m),
            ("exploration.utility_length_max_m", e.utility_length_max_m),
            ("exploration.current_goal_bonus_s", e.current_goal_bonus_s),
            ("exploration.assigned_radius_m", e.assigned_radius_m),
            ("exploration.assigned_cost_s", e.assigned_cost_s),
        ];
        let ordered = [
            ("follower.lookahead_max_m", f.lookahead_max_m, f.lookahead_min_m),
            ("follower.turn_from_rad", f.turn_from_rad, f.turn_until_rad),
            ("exploration.viewing_distances_m[0]", e.viewing_distances_m[0], e.viewing_distances_m[1]),
        ];
        let check = |name, value: f64, is_valid: bool, expected| {
            let is_valid = is_valid && value.is_finite();
            if is_valid { Ok(()) } else { Err(NavConfigError { name, value, expected }) }
        };
        above_zero.into_iter().try_for_each(|(name, v)| check(name, v, v > 0.0, "a number above 0"))?;
        from_zero.into_iter().try_for_each(|(name, v)| check(name, v, v >= 0.0, "a number from 0"))?;
        ordered.into_iter().try_for_each(|(name, v, least)| {
            check(name, v, v >= least, "at least its smaller counterpart (min, until or second attempt)")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_errors_name_the_parameter() {
        assert_eq!(NavConfig::default().validate(), Ok(()));
        let mut config = NavConfig::default();
        config.follower.cruise_m_s = 0.0;
        let error = config.validate().unwrap_err();
        assert_eq!(error.to_string(), "nav parameter follower.cruise_m_s is 0, expected a number above 0");
        let mut config = NavConfig::default();
        config.body.margin_m = f64::NAN;
        assert_eq!(config.validate().unwrap_err().name, "body.margin_m");
        let mut config = NavConfig::default();
        config.follower.lookahead_max_m = 0.1;
        assert_eq!(config.validate().unwrap_err().name, "follower.lookahead_max_m");
    }
}
