//! Parameters of navigation to goals.

use crate::config::{FollowerConfig, RobotBody};

/// What plans do with space that nobody has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownSpace {
    /// Plans keep out of it.
    #[default]
    Avoid,
    /// Plans cross it as if it were free; the scan limits the speed there too.
    Cross,
}

/// Parameters of a navigator; the same for all robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NavigatorConfig {
    /// Size of the robots.
    pub body: RobotBody,
    /// Driving along a path.
    pub follower: FollowerConfig,
    /// What plans do with space that nobody has seen.
    pub unknown_space: UnknownSpace,
    /// Time between two plans of a robot, seconds, above 0. About the period of the maps.
    pub replan_period_s: f64,
    /// Time without progress after which a robot backs up or turns, seconds, above 0.
    pub recover_after_s: f64,
    /// Time without progress after which a goal is given up, seconds, above `recover_after_s`.
    pub give_up_after_s: f64,
    /// Distance kept between the centres of two robots in plans, metres, above twice the radius.
    pub separation_m: f64,
}

impl NavigatorConfig {
    /// The default for robots that turn within this radius, metres; smaller ones than a Burger are taken for one.
    pub fn of_robots(radius_m: f64) -> Self {
        let default = Self::default();
        let larger_m = (radius_m - default.body.radius_m).max(0.0);
        Self {
            body: RobotBody { radius_m: default.body.radius_m + larger_m, ..default.body },
            separation_m: default.separation_m + 2.0 * larger_m,
            ..default
        }
    }
}

impl Default for NavigatorConfig {
    fn default() -> Self {
        Self {
            body: RobotBody::default(),
            follower: FollowerConfig::default(),
            unknown_space: UnknownSpace::Avoid,
            replan_period_s: 1.0,
            recover_after_s: 6.0,
            give_up_after_s: 25.0,
            separation_m: 0.32,
        }
    }
}
