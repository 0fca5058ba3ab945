//! Outputs of navigation for one robot: velocities, its state, and its plan.

use crate::channel;
use crate::ports::{ChannelError, Ports, WritePort};
use ::nav::navigation::RobotNavigation;
use ::nav::{NavigationState, Path};
use msg::{
    Monotonic, NavigationPlan, NavigationReport, NavigationStatus, PLAN_POINTS_MAX, PauseReason, RobotId,
    Stamp, VelocityCommand,
};

/// Period of the states while there is a goal, pursued or paused, nanoseconds: silence means that the process is gone.
/// A little less than the heartbeat's, at which a paused goal is reported: one that comes early by some milliseconds counts, too.
const REPORT_PERIOD_NS: u64 = 900_000_000;
/// Waypoints to a point of the published plan: one each 0.1 m on maps of 0.05 m.
const PLAN_STRIDE: usize = 2;

/// What a robot does that has no pose in its map.
const FINDING_PLACE: &str =
    "the robot does not know where it is: it turns, then drives by its LiDAR until SLAM finds its place";

/// Why a robot of an exploration has no goal.
const WAITING_FOR_TASK: &str =
    "the robot takes part in the exploration, and there is nothing for it to explore now";
/// What a robot does that cannot drive on.
const GETTING_FREE: &str = "the robot backs up or turns to get free";

/// State, number of the goal, next pose, and whether the robot waits for a task of the exploration.
type Reported = (NavigationState, u64, Option<usize>, bool);

/// What was decided for a robot.
pub(super) struct Decision<'a> {
    /// The navigator's decision; `None` before the first goal.
    pub(super) navigation: Option<RobotNavigation<'a>>,
    /// Whether the velocity is new.
    pub(super) is_stepped: bool,
    /// Whether a command for the robot has ever come: each is answered with a state.
    pub(super) has_command: bool,
    /// Number of the goal's command.
    pub(super) goal: u64,
    /// Why the newest goal was refused.
    pub(super) refusal: Option<&'static str>,
    /// Why the goal is paused, if it is.
    pub(super) pause_reason: PauseReason,
    /// Whether plans are in the merged map.
    pub(super) in_merged_map: bool,
    /// Whether the robot takes part in an exploration.
    pub(super) is_exploring: bool,
}

/// Channels of one robot that navigation writes.
pub(super) struct RobotOutputs<P: Ports> {
    velocity: P::Writer<VelocityCommand>,
    state: P::Writer<NavigationReport>,
    plan: P::Writer<NavigationPlan>,
    /// State, goal and pose of the last report, and when it was sent.
    reported: Option<(Reported, Monotonic)>,
    plan_number: u32,
}

impl<P: Ports> RobotOutputs<P> {
    pub(super) fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            velocity: ports.writer(&channel::navigation_velocity(robot))?,
            state: ports.writer(&channel::navigation_state(robot))?,
            plan: ports.writer(&channel::plan(robot))?,
            reported: None,
            plan_number: 0,
        })
    }

    /// Delivers the newest state and plan to late readers.
    pub(super) fn refresh(&self) {
        self.state.refresh();
        self.plan.refresh();
    }

    /// Publishes the velocity, and the state and the plan if they have changed.
    pub(super) fn publish(&mut self, stamp: Stamp, now: Monotonic, decision: &Decision) {
        let state = decision.navigation.map_or(NavigationState::Idle, |navigation| navigation.state);
        let next_pose = decision.navigation.and_then(|navigation| navigation.next_pose);
        let waits_for_task = state == NavigationState::Cancelled && decision.is_exploring;
        let reported = (state, decision.goal, next_pose, waits_for_task);
        let is_due = match self.reported {
            None => decision.goal != 0 || decision.has_command,
            Some((before, at)) => {
                let has_goal = state.is_active() || state == NavigationState::Paused;
                before != reported || (has_goal && now.since(at) >= REPORT_PERIOD_NS)
            }
        };
        // The state comes first: the bridge then knows that the navigator drives.
        if is_due {
            self.reported = Some((reported, now));
            self.state.send(&report(stamp, decision));
        }
        let Some(navigation) = decision.navigation else { return };
        if let Some(twist) = navigation.twist.filter(|_| decision.is_stepped) {
            self.velocity.send_with(|command| {
                command.header.stamp = stamp;
                (command.linear_m_s, command.angular_rad_s) = (twist.linear_m_s, twist.angular_rad_s);
            });
        }
        if navigation.plan_number != self.plan_number {
            self.plan_number = navigation.plan_number;
            let in_merged_map = decision.in_merged_map;
            self.plan.send_with(|plan| write_plan(plan, stamp, in_merged_map, navigation.plan));
        }
    }
}

fn report(stamp: Stamp, decision: &Decision) -> NavigationReport {
    let mut report = NavigationReport { number: decision.goal, remaining_m: f64::NAN, ..Default::default() };
    report.header.stamp = stamp;
    if let Some(refusal) = decision.refusal {
        report.status = NavigationStatus::Failed as u32;
        report.set_reason(refusal);
        return report;
    }
    let Some(navigation) = decision.navigation else { return report };
    report.remaining_m = navigation.remaining_m.unwrap_or(f64::NAN);
    report.next_pose = navigation.next_pose.unwrap_or(0) as u32;
    let status = match navigation.state {
        NavigationState::Idle => NavigationStatus::Idle,
        NavigationState::Planning => NavigationStatus::Planning,
        NavigationState::Driving => NavigationStatus::Driving,
        NavigationState::WaitingForRobot(other) => {
            report.other_robot = other.number() as u32;
            NavigationStatus::Waiting
        }
        NavigationState::Blocked(failure) => {
            report.set_reason(&failure.to_string());
            NavigationStatus::Blocked
        }
        NavigationState::Recovering => {
            report.set_reason(GETTING_FREE);
            NavigationStatus::Recovering
        }
        NavigationState::FindingPlace => {
            report.set_reason(FINDING_PLACE);
            NavigationStatus::Recovering
        }
        NavigationState::Paused => {
            report.set_reason(decision.pause_reason.text());
            NavigationStatus::Paused
        }
        NavigationState::Reached => NavigationStatus::Reached,
        NavigationState::Cancelled => {
            if decision.is_exploring {
                report.set_reason(WAITING_FOR_TASK);
            }
            NavigationStatus::Cancelled
        }
        NavigationState::Failed(failure) => {
            report.set_reason(&failure.to_string());
            NavigationStatus::Failed
        }
    };
    report.status = status as u32;
    report
}

fn write_plan(plan: &mut NavigationPlan, stamp: Stamp, in_merged_map: bool, path: &Path) {
    plan.header.stamp = stamp;
    plan.in_merged_map = u32::from(in_merged_map);
    let waypoints = &path.waypoints;
    let stride = waypoints.len().div_ceil(PLAN_POINTS_MAX - 1).max(PLAN_STRIDE);
    // The last point is the goal whatever the stride.
    let last = waypoints.len().checked_sub(1);
    let indices = (0..last.unwrap_or(0)).step_by(stride).chain(last);
    let mut len = 0;
    for (slot, index) in plan.points_m.iter_mut().zip(indices) {
        *slot = waypoints[index].position_m.map(|v| v as f32);
        len += 1;
    }
    plan.len = len;
}
