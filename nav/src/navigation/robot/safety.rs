//! Ways of a robot to get free, and limits of its speed by what is near it.

use super::super::input::RobotPoses;
use super::super::progress::Recovery;
use super::super::state::{NavigationFailure, NavigationState};
use super::{OtherRobot, RobotNavigator};
use crate::backing_up::{BACK_UP, back_up_distance_m};
use crate::command::Twist;
use crate::geometry::distance_m;
use crate::observation::ScanView;
use msg::{Pose2, Stamp};

/// Speed below which a robot that wants to drive stands, m/s.
const STANDING_M_S: f64 = 0.005;

/// Share of a way back that must be gained as distance to a robot that is too near already.
const MOVING_APART_SHARE: f64 = 0.25;
/// A scan's point this near to the body of a robot is one of it, metres: errors of both robots' poses.
const ROBOT_POINT_MAX_M: f64 = 0.08;

/// Robots differ in how long they stand before they try to get free: in so many steps of this share.
const PATIENCES: usize = 4;
const PATIENCE_STEP: f64 = 0.25;

impl RobotNavigator {
    /// Velocity of getting free, while the robot does that or has to begin with it.
    pub(super) fn recover(
        &mut self,
        now: Stamp,
        poses: RobotPoses,
        scan: &ScanView,
        others: &[OtherRobot],
    ) -> Option<Twist> {
        if self.recovery.is_some_and(|recovery| recovery.is_done(now, poses.odom_from_base)) {
            (self.recovery, self.searched) = (None, None);
        }
        // A wait that is planned ends by the plan; robots that stand before each other have to move apart.
        let is_waiting = self.followed.as_ref().is_some_and(|path| path.waits_for.is_some());
        // Backing up does not help a robot whose goal is out of reach. Turning does, if it has not seen what is behind it.
        let is_out_of_reach = matches!(self.searched, Some((_, Err(NavigationFailure::GoalUnreachable))));
        let can_look = is_out_of_reach && !scan.sees_all_around();
        let can_help = matches!(self.searched, Some((_, Ok(()) | Err(NavigationFailure::StartBlocked))));
        if self.recovery.is_none() && !is_waiting && (can_help || can_look) {
            let config = self.config;
            // Of two robots that stand before each other, one moves first.
            let patience = 1.0 + PATIENCE_STEP * (self.robot.number() % PATIENCES) as f64;
            if self.goal.as_mut().is_some_and(|active| active.progress.take_recovery(now, &config, patience))
            {
                self.recovery = Some(match can_look {
                    true => Recovery::turn(now, self.turning_side()),
                    false => self.new_recovery(now, poses, others),
                });
                self.obstacles.clear();
            }
        }
        let twist = match self.recovery? {
            Recovery::BackUp(_) => BACK_UP,
            Recovery::Turn { side, .. } => {
                Twist { linear_m_s: 0.0, angular_rad_s: side * self.config.follower.turn_rad_s }
            }
        };
        self.state = NavigationState::Recovering;
        Some(twist)
    }

    fn new_recovery(&self, now: Stamp, poses: RobotPoses, others: &[OtherRobot]) -> Recovery {
        // Robots that are too near each other already may move apart.
        let is_clear_of = |other: &OtherRobot, back_m: f64| {
            let [x, y] = other.in_base_m;
            let (before_m, after_m) = (x.hypot(y), (x + back_m).hypot(y));
            after_m > self.config.separation_m || after_m > before_m + MOVING_APART_SHARE * back_m
        };
        let is_clear_of_all = |back_m| others.iter().all(|other| is_clear_of(other, back_m));
        let (map, body) = (self.goal_map.map(), self.config.body);
        match back_up_distance_m(map, body, poses.map_from_base, is_clear_of_all) {
            Some(back_m) => Recovery::back_up(now, poses.odom_from_base, back_m),
            None => Recovery::turn(now, self.turning_side()),
        }
    }

    /// Direction in which the robot turns to look around: always the same, so that several turns see everything.
    fn turning_side(&self) -> f64 {
        if self.robot.number().is_multiple_of(2) { 1.0 } else { -1.0 }
    }

    /// Slows the robot for what the scan shows ahead, or has shown a moment ago where it does not look now, and for robots near it;
    /// says what it stands for.
    pub(super) fn limit(
        &mut self,
        now: Stamp,
        wanted: Twist,
        (scan, odom_from_base): (&ScanView, Option<Pose2>),
        others: &[OtherRobot],
    ) -> Twist {
        if wanted.linear_m_s < 0.0 {
            return self.collision.limit_speed_back(wanted, scan);
        }
        let nearest_m = self.collision.nearest_ahead_m(scan);
        let free_m = nearest_m.map_or(f64::INFINITY, |[x, _]| x - self.config.body.radius_m);
        let unseen_m = odom_from_base.map_or(f64::INFINITY, |odom_from_base| {
            let unseen = self.obstacles.unseen_in_base_m(now, odom_from_base, scan);
            unseen.map(|at_m| self.collision.free_distance_to_point_m(at_m)).fold(f64::INFINITY, f64::min)
        });
        let mut limited = self.collision.limit_speed(wanted, free_m.min(unseen_m));
        // What the scan shows ahead may be a robot.
        let reach_m = self.config.body.radius_m + ROBOT_POINT_MAX_M;
        let is_seen =
            |other: &&OtherRobot| nearest_m.is_some_and(|at_m| distance_m(at_m, other.in_base_m) < reach_m);
        let mut limited_by = others.iter().find(is_seen).filter(|_| limited.linear_m_s < wanted.linear_m_s);
        for other in others {
            let by_other = self.collision.limit_speed_to_robot(limited, other.in_base_m);
            if by_other.linear_m_s < limited.linear_m_s {
                (limited, limited_by) = (by_other, Some(other));
            }
        }
        let wants_to_drive = wanted.linear_m_s > STANDING_M_S;
        if wants_to_drive && limited.linear_m_s < STANDING_M_S && self.state == NavigationState::Driving {
            self.waited_for = limited_by.filter(|other| other.is_active).map(|other| other.robot);
            self.standstill.record_stop(now, self.waited_for);
            self.state = match limited_by {
                Some(other) if other.is_active => NavigationState::WaitingForRobot(other.robot),
                Some(other) => NavigationState::Blocked(NavigationFailure::Robot(other.robot)),
                None => NavigationState::Blocked(NavigationFailure::Obstacle),
            };
        }
        if limited.linear_m_s.abs() > STANDING_M_S {
            self.standstill.forget_stop();
        }
        limited
    }
}
