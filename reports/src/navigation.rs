//! What navigation does with each robot, and how far the exploration is, as `mr-slam status` shows it.

use crate::exploration::known_area;
use crate::view::finite;
use msg::{ExplorationReport, ExplorationStatus, NavigationReport, NavigationStatus, RobotId};
use serde::Serialize;

/// States of navigation and exploration.
#[derive(Clone, Debug, Serialize)]
pub struct NavigationView {
    /// Robots that have or had a goal, in the order of their numbers.
    pub robots: Vec<RobotNavigationView>,
    /// The exploration; `None` before the first.
    pub exploration: Option<ExplorationView>,
}

/// State of a robot's goal.
#[derive(Clone, Debug, Serialize)]
pub struct RobotNavigationView {
    /// The robot by its number, such as `robot1`.
    pub robot: String,
    /// `driving`, `blocked`, `reached` ...
    pub state: &'static str,
    /// Why it stands or has given up; empty if there is nothing to say.
    pub reason: String,
    /// Way that is left, metres of driving in open space; where it has arrived, its distance to the goal.
    pub remaining_m: Option<f64>,
    /// The robot that it waits for.
    pub waits_for: Option<String>,
}

/// State of the exploration.
#[derive(Clone, Debug, Serialize)]
pub struct ExplorationView {
    /// `exploring`, `completed` ...
    pub state: &'static str,
    /// Why it stands or is over; empty if there is nothing to say.
    pub reason: String,
    /// Time that it has taken, seconds.
    pub elapsed_s: Option<f64>,
    /// Area that the maps show, square metres.
    pub known_m2: Option<f64>,
    /// Number of places that are left.
    pub left_count: u32,
}

impl NavigationView {
    /// Describes the newest states.
    pub fn new<'a>(
        robots: impl IntoIterator<Item = (RobotId, &'a NavigationReport)>,
        exploration: &ExplorationReport,
    ) -> Self {
        let robots = robots.into_iter().filter(|(_, report)| report.status() != NavigationStatus::Idle);
        let of_robot = |(robot, report): (RobotId, &NavigationReport)| RobotNavigationView {
            robot: robot.to_string(),
            state: report.status().name(),
            reason: report.reason().to_owned(),
            remaining_m: finite(report.remaining_m),
            waits_for: RobotId::new(report.other_robot as usize).map(|other| other.to_string()),
        };
        let exploration = (exploration.status() != ExplorationStatus::Idle).then(|| ExplorationView {
            state: exploration.status().name(),
            reason: exploration.reason().to_owned(),
            elapsed_s: finite(exploration.elapsed_s),
            known_m2: finite(exploration.known_m2),
            left_count: exploration.leftovers_count,
        });
        Self { robots: robots.map(of_robot).collect(), exploration }
    }

    /// The states for people, a line for each; empty if nobody has or had a goal.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for robot in &self.robots {
            text += &format!("{}: {}", robot.robot, robot.state);
            if let Some(other) = &robot.waits_for {
                text += &format!(" for {other}");
            }
            if let Some(remaining_m) = robot.remaining_m {
                let what =
                    if robot.state == NavigationStatus::Reached.name() { "from the goal" } else { "to go" };
                text += &format!(", {remaining_m:.1} m {what}");
            }
            text += &reason(&robot.reason);
        }
        if let Some(exploration) = &self.exploration {
            text += &format!("exploration: {}", exploration.state);
            if let Some(elapsed_s) = exploration.elapsed_s {
                text += &format!(" after {elapsed_s:.0} s");
            }
            text += &known_area(exploration.known_m2);
            if exploration.left_count > 0 {
                text += &format!(", {} places left", exploration.left_count);
            }
            text += &reason(&exploration.reason);
        }
        text
    }
}

fn reason(reason: &str) -> String {
    if reason.is_empty() { "\n".into() } else { format!(": {reason}\n") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_lines_for_people() {
        let mut waiting = NavigationReport {
            status: NavigationStatus::Waiting as u32,
            other_robot: 2,
            remaining_m: 3.25,
            ..Default::default()
        };
        waiting.set_reason("a reason");
        let reached = NavigationReport {
            status: NavigationStatus::Reached as u32,
            remaining_m: 0.04,
            ..Default::default()
        };
        let idle = NavigationReport::default();
        let robots = RobotId::first(3).zip([&waiting, &reached, &idle]);
        let mut exploration = ExplorationReport {
            status: ExplorationStatus::Failed as u32,
            elapsed_s: 62.4,
            ..Default::default()
        };
        exploration.set_reason("for 60 s no robot could be given a goal");
        let view = NavigationView::new(robots, &exploration);
        assert_eq!(
            view.text(),
            "robot1: waiting for robot2, 3.2 m to go: a reason\nrobot2: reached, 0.0 m from the goal\n\
             exploration: failed after 62 s: for 60 s no robot could be given a goal\n"
        );
        let json = serde_json::to_value(&view).unwrap();
        assert!(json["exploration"]["known_m2"].is_null() && json["robots"][0]["waits_for"] == "robot2");
        assert_eq!(NavigationView::new([], &ExplorationReport::default()).text(), "");
    }
}
