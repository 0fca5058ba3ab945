//! Robots that send to a base which does not have their names.

use msg::Monotonic;
use std::time::Duration;

/// Names that are remembered at once.
pub const UNKNOWN_NAMES_MAX: usize = 16;
/// Longest name that is remembered, characters.
const NAME_CHARS_MAX: usize = 64;
/// Time after its last message for which a robot counts as present.
const PRESENT: Duration = Duration::from_secs(10);

/// Names that no robot of the fleet has, with the time at which each was heard last. Bounded.
#[derive(Clone, Debug, Default)]
pub struct UnknownRobots {
    names: Vec<(String, Monotonic)>,
}

impl UnknownRobots {
    /// Adds what a robot of this name has sent. Returns the name, without control characters, if it is new and there is room for it.
    pub fn hear(&mut self, name: &str, now: Monotonic) -> Option<&str> {
        self.names.retain(|(_, heard)| now.since(*heard) < PRESENT.as_nanos() as u64);
        let name: String = name.chars().filter(|letter| !letter.is_control()).take(NAME_CHARS_MAX).collect();
        if let Some((_, heard)) = self.names.iter_mut().find(|(known, _)| *known == name) {
            *heard = now;
            return None;
        }
        if self.names.len() == UNKNOWN_NAMES_MAX {
            return None;
        }
        self.names.push((name, now));
        self.names.last().map(|(name, _)| name.as_str())
    }

    /// Names of the robots that were heard in the last 10 s.
    pub fn present(&self, now: Monotonic) -> Vec<String> {
        let is_present = |heard: &Monotonic| now.since(*heard) < PRESENT.as_nanos() as u64;
        self.names.iter().filter(|(_, heard)| is_present(heard)).map(|(name, _)| name.clone()).collect()
    }
}

/// Says for people that a robot of an unknown name is here, and what to do. `names`: those of the fleet.
pub fn unknown_robot_text(name: &str, names: &[String]) -> String {
    let names = names.join(",");
    format!(
        "a machine named {name} is here that this fleet does not have; its names are {names}: start the base with --names \
         {names},{name}, or the robot with one of these as --name"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64) -> Monotonic {
        Monotonic(seconds * 1_000_000_000)
    }

    #[test]
    fn a_name_is_new_once_and_forgotten_when_it_is_silent() {
        let mut robots = UnknownRobots::default();
        assert_eq!(robots.hear("carl\n", at(1)), Some("carl"));
        assert_eq!(robots.hear("carl", at(9)), None);
        assert_eq!(robots.present(at(18)), ["carl"]);
        assert!(robots.present(at(19)).is_empty());
        assert_eq!(robots.hear("carl", at(30)), Some("carl"), "it is back");
        let text = unknown_robot_text("carl", &["alice".into(), "bob".into()]);
        assert!(text.contains("--names alice,bob,carl"), "{text}");
    }

    #[test]
    fn names_are_bounded_in_number_and_length() {
        let mut robots = UnknownRobots::default();
        for number in 0..100 {
            robots.hear(&format!("{number:0200}"), at(1));
            robots.hear(&format!("robot{number}"), at(1));
        }
        let names = robots.present(at(1));
        assert_eq!(names.len(), UNKNOWN_NAMES_MAX);
        assert!(names.iter().all(|name| name.len() <= NAME_CHARS_MAX));
    }
}
