//! Search of a lost robot for its place: it turns, then drives by its LiDAR alone, so that SLAM sees more. One that does not see all
//! around turns again and again.

use super::RobotNavigator;
use crate::command::Twist;
use crate::navigation::input::NavigatedRobot;
use crate::navigation::state::{NavigationFailure, NavigationState};
use crate::random::RandomNumbers;
use crate::wander::Wander;
use core::f64::consts::TAU;
use msg::Stamp;

/// Longest search, seconds: at the usual speed a robot gets through a building of 15 m.
const SEARCH_MAX_S: f64 = 120.0;

/// Time of driving after which a robot that does not see all around turns again, seconds: two metres. Of 32 robots of 90° that began in
/// their saved maps 22 were found within 125 s, and 15 without turning again.
const DRIVE_S: f64 = 15.0;

/// A search that goes on.
#[derive(Clone, Debug)]
pub(super) struct PlaceSearch {
    since: Stamp,
    wander: Wander,
    random: RandomNumbers,
}

impl RobotNavigator {
    /// Has the robot look for its place; a goal that it had is cancelled.
    pub(in super::super) fn find_place(&mut self, now: Stamp) {
        self.end(NavigationState::Cancelled);
        // Each search takes another way.
        let random = RandomNumbers::new(now.0 as u64 ^ self.robot.number() as u64);
        self.place_search = Some(PlaceSearch { since: now, wander: Wander::default(), random });
        self.state = NavigationState::FindingPlace;
    }

    /// Ends the search in this state, if there is one; the next step stops the robot.
    pub(in super::super) fn end_place_search(&mut self, state: NavigationState) {
        if self.place_search.take().is_some() {
            self.is_stop_due = true;
            self.state = state;
        }
    }

    /// Velocity of the search; `None` if there is none, or it ends now.
    pub(super) fn search_place(&mut self, now: Stamp, robot: &NavigatedRobot) -> Option<Twist> {
        let since = self.place_search.as_ref()?.since;
        if robot.poses().is_some() {
            self.end_place_search(NavigationState::Idle);
            return None;
        }
        if now - since > SEARCH_MAX_S {
            self.end_place_search(NavigationState::Failed(NavigationFailure::NoPose));
            return None;
        }
        let Some(scan) = robot.fresh_scan(now) else { return Some(Twist::STOP) };
        let (collision, config) = (self.collision, self.config.follower);
        let search = self.place_search.as_mut()?;
        let (turn_s, searched_s) = (TAU / config.turn_rad_s, now - since);
        let turns_again = !scan.sees_all_around() && searched_s % (turn_s + DRIVE_S) < turn_s;
        let wanted = if searched_s < turn_s || turns_again {
            Twist { linear_m_s: 0.0, angular_rad_s: config.turn_rad_s }
        } else {
            search.wander.drive(&scan, &collision, &config, &mut search.random)
        };
        Some(self.limit(now, wanted, (&scan, robot.odom_from_base), &[]))
    }
}
