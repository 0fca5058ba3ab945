//! The fleet's robots as people name them.

use crate::FleetConfig;
use msg::RobotId;

/// Finds a robot by its number, as `robot2` or `2`, or by its name.
///
/// No robot has another's number as its name: the configuration refuses it.
pub fn find(config: &FleetConfig, text: &str) -> Option<RobotId> {
    let mut all = RobotId::first(config.fleet.robots);
    let named = all.clone().find(|robot| config.robot_name(*robot) == text);
    named.or_else(|| {
        let number = text.strip_prefix("robot").unwrap_or(text).parse().ok();
        all.find(|robot| number == Some(robot.number()))
    })
}

/// Lists the robots, with the names that they have of their own.
pub fn list(config: &FleetConfig) -> String {
    let count = config.fleet.robots;
    if config.fleet.names.is_empty() {
        return if count == 1 { "robot1 alone".into() } else { format!("robot1 to robot{count}") };
    }
    let own = |robot: RobotId| match config.robot_name(robot) {
        name if name == robot.to_string() => name,
        name => format!("{name} ({robot})"),
    };
    RobotId::first(count).map(own).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fleet(count: usize, names: &[&str]) -> FleetConfig {
        let mut config = FleetConfig::default();
        config.fleet.robots = count;
        config.fleet.names = names.iter().map(|name| String::from(*name)).collect();
        config
    }

    fn found(config: &FleetConfig, text: &str) -> Option<usize> {
        find(config, text).map(RobotId::number)
    }

    #[test]
    fn a_robot_is_found_by_number_and_by_name() {
        let unnamed = fleet(2, &[]);
        for (text, number) in
            [("1", Some(1)), ("robot2", Some(2)), ("robot3", None), ("0", None), ("alice", None), ("", None)]
        {
            assert_eq!(found(&unnamed, text), number, "{text}");
        }
        let named = fleet(3, &["alice", "", "bob"]);
        for (text, number) in [
            ("alice", Some(1)),
            ("robot1", Some(1)),
            ("robot2", Some(2)),
            ("bob", Some(3)),
            ("3", Some(3)),
            ("Bob", None),
        ] {
            assert_eq!(found(&named, text), number, "{text}");
        }
        assert_eq!(list(&named), "alice (robot1), robot2, bob (robot3)");
        assert_eq!(
            (list(&unnamed), list(&fleet(1, &[]))),
            ("robot1 to robot2".into(), "robot1 alone".into())
        );
    }
}
