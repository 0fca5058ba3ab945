//! Configuration of the people, doors and boxes that move in a simulated room.

use super::{ConfigError, check};
use msg::OBJECTS_OF_KIND_MAX;
use serde::{Deserialize, Serialize};

/// People, doors and boxes that move in a simulated room. Without them the room stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MovingConfig {
    /// Number of people who walk in the room, 0 to 16. Fewer are there if it has no place for all.
    pub people: usize,
    /// Number of sliding doors that open and close, 0 to 16. Fewer are there if the room has fewer passages of 0.6 to
    /// 1.15 m in a wall.
    pub doors: usize,
    /// Number of boxes that are moved from time to time, 0 to 16. Fewer are there if the room has no place for all.
    pub boxes: usize,
}

impl MovingConfig {
    /// Returns whether anything moves.
    pub fn is_any(&self) -> bool {
        *self != Self::default()
    }

    /// Returns how many of those that are `wished` are in the room, for people.
    pub fn text_of(&self, wished: &Self) -> String {
        let Self { people, doors, boxes } = wished;
        format!(
            "{} of {people} people, {} of {doors} doors and {} of {boxes} boxes are in the room",
            self.people, self.doors, self.boxes
        )
    }

    /// Checks all values and returns the first invalid one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let counts =
            [("moving.people", self.people), ("moving.doors", self.doors), ("moving.boxes", self.boxes)];
        for (field, count) in counts {
            check(field, count as f64, count <= OBJECTS_OF_KIND_MAX, "0 to 16")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_in_words() {
        let found = MovingConfig { people: 3, doors: 0, boxes: 5 };
        let wished = MovingConfig { people: 3, doors: 1, boxes: 14 };
        let text = found.text_of(&wished);
        assert_eq!(text, "3 of 3 people, 0 of 1 doors and 5 of 14 boxes are in the room");
    }
}
