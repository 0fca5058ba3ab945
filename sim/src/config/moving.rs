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
