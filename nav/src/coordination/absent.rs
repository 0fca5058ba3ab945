//! Text about the robots that had no part in an exploration, with the reason of each.

use msg::{ExplorerState, REASON_BYTES_MAX, RobotId};

/// Why a completed exploration is over, and who had no part in it.
pub fn completion(robots: &[(RobotId, ExplorerState)]) -> String {
    if absent(robots).next().is_none() {
        return "nothing reachable is unknown".into();
    }
    with_robots("nothing that the other robots reach is unknown; without ", robots)
}

/// Why no robot could be given a goal for so long that the exploration has failed.
pub fn no_robot(robots: &[(RobotId, ExplorerState)]) -> String {
    if absent(robots).next().is_none() {
        return "for 60 s no robot could be given a goal".into();
    }
    with_robots("for 60 s no robot could be given a goal: ", robots)
}

/// For which robots an exploration waits, and what each of them lacks.
pub fn waiting(robots: &[(RobotId, ExplorerState)]) -> String {
    if absent(robots).next().is_none() {
        return "no robot can explore: no robot has a map".into();
    }
    with_robots("no robot can explore: ", robots)
}

/// Robots without a part, each with the reason.
fn absent(robots: &[(RobotId, ExplorerState)]) -> impl Iterator<Item = (RobotId, &'static str)> {
    robots.iter().filter_map(|(robot, state)| Some((*robot, state.absence()?)))
}

/// Adds the robots by name and reason, or, where a report has no room for all, their number for each reason.
fn with_robots(start: &str, robots: &[(RobotId, ExplorerState)]) -> String {
    let mut groups: Vec<(&str, Vec<String>)> = Vec::new();
    for (robot, reason) in absent(robots) {
        match groups.iter_mut().find(|(of, _)| *of == reason) {
            Some((_, names)) => names.push(robot.to_string()),
            None => groups.push((reason, vec![robot.to_string()])),
        }
    }
    let named: Vec<String> =
        groups.iter().map(|(reason, names)| format!("{} ({reason})", names.join(", "))).collect();
    let text = format!("{start}{}", named.join(", "));
    if text.len() <= REASON_BYTES_MAX {
        return text;
    }
    let counted: Vec<String> =
        groups.iter().map(|(reason, names)| format!("{} {reason}", names.len())).collect();
    format!("without a part: {}", counted.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::ROBOTS_MAX;

    const ABSENT: [ExplorerState; 5] = [
        ExplorerState::Manual,
        ExplorerState::Lost,
        ExplorerState::Silent,
        ExplorerState::Excluded,
        ExplorerState::Enclosed,
    ];

    #[test]
    fn who_had_no_part_is_named_with_the_reason() {
        let states = [ExplorerState::Exploring, ExplorerState::Excluded, ExplorerState::Lost];
        let robots: Vec<_> = RobotId::first(3).zip(states).collect();
        assert_eq!(
            completion(&robots),
            "nothing that the other robots reach is unknown; without robot2 (in an exclusion zone), robot3 (lost)"
        );
        assert_eq!(completion(&robots[..1]), "nothing reachable is unknown");
        let text = no_robot(&robots[1..]);
        assert!(text.ends_with("a goal: robot2 (in an exclusion zone), robot3 (lost)"), "{text}");
        let silent: Vec<_> = RobotId::first(2).map(|robot| (robot, ExplorerState::Silent)).collect();
        assert_eq!(waiting(&silent), "no robot can explore: robot1, robot2 (no scans or poses)");
        assert_eq!(waiting(&robots[..1]), "no robot can explore: no robot has a map");
    }

    #[test]
    fn the_text_of_any_fleet_has_room_in_a_report_and_each_reason() {
        for count in 1..=ROBOTS_MAX {
            for shift in 0..ABSENT.len() {
                let state = |robot: RobotId| ABSENT[(robot.index() + shift) % ABSENT.len()];
                let robots: Vec<_> = RobotId::first(count).map(|robot| (robot, state(robot))).collect();
                for text in [completion(&robots), no_robot(&robots), waiting(&robots)] {
                    assert!(text.len() <= REASON_BYTES_MAX, "{} bytes: {text}", text.len());
                    for (_, state) in &robots {
                        assert!(text.contains(state.absence().unwrap()), "{state:?}: {text}");
                    }
                }
            }
        }
    }
}
