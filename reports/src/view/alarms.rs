//! What is wrong with a fleet, in sentences for people.

use super::{FleetView, RobotView};

/// A simulated fleet has its first scans within this time of its start, seconds.
pub(super) const FIRST_SCAN_S: f64 = 5.0;

impl FleetView {
    /// Says that the bridge does not answer, and what is not known for that reason.
    fn silence_line(&self) -> Option<String> {
        let why = self.bridge_silence.as_ref()?;
        let known = if self.bridge.is_some() { "; what is shown of them is from before" } else { "" };
        Some(format!("{why}: emergency stop, drivers and clients are not known{known}"))
    }

    /// Lists what is wrong, for people.
    pub fn alarms(&self) -> Vec<String> {
        let mut alarms: Vec<String> = self.silence_line().into_iter().collect();
        if self.bridge.as_ref().is_some_and(|bridge| bridge.stopped) {
            alarms.push("EMERGENCY STOP is set: robots stand until key r or mr-slam release".into());
        }
        for robot in &self.robots {
            if robot.is_lost() {
                alarms.push(format!("{} is lost: it looks for its place in the map", robot.robot));
            }
            if robot.is_unreliable() {
                alarms.push(format!(
                    "{}'s map may be wrong: scans or odometry contradict it, the log says how",
                    robot.robot
                ));
            }
            if robot.has_stale_scans() {
                alarms.push(format!("{}: no scan for a second or more", robot.robot));
            }
            if robot.scans == 0 && self.time_s >= FIRST_SCAN_S {
                let slam = format!("slam of {}", robot.robot);
                let has_slam = !self.processes.iter().any(|p| p.process == slam && p.state != "up");
                let why = if has_slam {
                    "what sends its scans does not run, or is not reached"
                } else {
                    "its SLAM does not run"
                };
                alarms.push(format!("{}: no scan has come yet: {why}", robot.robot));
            }
            alarms.extend(old_map(robot));
            alarms.extend(robot.battery_alarm());
        }
        for edge in self.merge_edges.iter().filter(|edge| edge.contradicted) {
            alarms.push(format!(
                "the maps of {} and {} contradict each other in {} of {} places: one of them is deformed, or lies wrong",
                edge.a, edge.b, edge.contradicted_submaps, edge.compared_submaps
            ));
        }
        if self.edges_unsaved {
            alarms.push("merging cannot save its state: what is pinned or undone is lost when it is started again; the log says why".into());
        }
        for robot in &self.contradicted_starts {
            alarms.push(format!("{robot}'s given start contradicts the maps: its place comes from the maps"));
        }
        for process in self.processes.iter().filter(|process| process.state != "up") {
            let what = match process.state {
                "ended" => "has ended",
                "not reporting" => "has not reported: it does not run, or ends at once; the log says why",
                "failing" => "dies again and again, and is started every 30 s; the log says of what",
                _ => "does not answer",
            };
            alarms.push(format!("{} {what}", process.process));
        }
        alarms
    }
}

/// Says that a robot's part of the merged map is old, if it is.
fn old_map(robot: &RobotView) -> Option<String> {
    let age_s = robot.old_map_age_s()?;
    Some(format!("{}'s part of the merged map is {age_s:.0} s old: nothing comes from its SLAM", robot.robot))
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{FleetStats, Role};

    #[test]
    fn a_process_that_never_reported_and_one_that_dies_again_and_again_are_alarms() {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        (stats.robot_count, stats.header.stamp) = (1, msg::Stamp::from_seconds(60.0));
        let roles = [(Role::Slam, 1), (Role::Record, 0), (Role::Merge, 0)];
        for (process, (role, robot)) in stats.processes.iter_mut().zip(roles) {
            (process.health.role, process.health.robot, process.age_s) = (role as u32, robot, 12.6);
        }
        (stats.processes[2].health.pid, stats.processes[2].age_s) = (100, 2.6);
        let fleet = || FleetView::new(&stats).with_ended_processes(|_| true);
        let states: Vec<&str> = fleet().processes.iter().map(|process| process.state).collect();
        assert_eq!(states, ["not reporting", "not reporting", "silent"]);
        let alarms = fleet().alarms().join("\n");
        assert!(
            alarms.contains("slam of robot1 has not reported") && alarms.contains("record has not"),
            "{alarms}"
        );
        assert!(alarms.contains("no scan has come yet: its SLAM does not run"), "{alarms}");
        let failing = fleet().with_failing_processes(|name| name == "merge");
        assert!(failing.alarms().iter().any(|alarm| alarm.starts_with("merge dies again and again")));
        // It is just being started.
        stats.processes[1].age_s = 11.0;
        assert_eq!(FleetView::new(&stats).processes.len(), 2);
    }
}
