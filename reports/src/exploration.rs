//! What an exploration came to.

use crate::view::finite;
use msg::{ExplorationReport, RobotId};
use serde::Serialize;

/// An exploration until now, or as it ended, as JSON.
#[derive(Clone, Debug, Serialize)]
pub struct ExplorationSummary {
    /// `exploring`, `completed` ...
    pub state: &'static str,
    /// Why it stands or is over; empty if there is nothing to say.
    pub reason: String,
    /// Time that the exploration has taken, seconds; `None` before the first.
    elapsed_s: Option<f64>,
    known_m2: Option<f64>,
    least_s: Option<f64>,
    most_s: Option<f64>,
    robots: Vec<&'static str>,
    left: Vec<LeftoverSummary>,
    left_count: u32,
}

/// A leftover as JSON.
#[derive(Clone, Debug, Serialize)]
struct LeftoverSummary {
    /// `map`, or the robot in whose own map the place is.
    map: String,
    x_m: f64,
    y_m: f64,
    length_m: f64,
    area_m2: Option<f64>,
    reason: String,
}

/// Says for people how much area is known, if that is known.
pub fn known_area(known_m2: Option<f64>) -> String {
    known_m2.map_or_else(String::new, |known_m2| format!(", {known_m2:.1} m2 known"))
}

impl ExplorationSummary {
    /// Describes an exploration.
    pub fn new(report: &ExplorationReport, robots: usize) -> Self {
        let left = report.leftovers().iter().map(|left| LeftoverSummary {
            map: RobotId::new(left.map_robot as usize).map_or("map".into(), |robot| robot.to_string()),
            x_m: left.position_m[0],
            y_m: left.position_m[1],
            length_m: left.length_m,
            area_m2: finite(left.area_m2),
            reason: left.reason().map_or_else(String::new, |reason| reason.to_string()),
        });
        Self {
            state: report.status().name(),
            reason: report.reason().to_owned(),
            elapsed_s: finite(report.elapsed_s),
            known_m2: finite(report.known_m2),
            least_s: finite(report.least_s),
            most_s: finite(report.most_s),
            robots: (0..robots).map(|index| report.robot(index).name()).collect(),
            left: left.collect(),
            left_count: report.leftovers_count,
        }
    }

    /// The answer for people: what was reached, and a line for each place that is left.
    pub fn text(&self) -> String {
        let known = known_area(self.known_m2);
        let after = self.elapsed_s.map_or_else(String::new, |seconds| format!(" after {seconds:.0} s"));
        let mut text = format!("{}{after}{known}", self.state);
        if !self.reason.is_empty() {
            text += &format!(": {}", self.reason);
        }
        text.push('\n');
        for left in &self.left {
            let area = left.area_m2.map_or_else(|| "open".into(), |area_m2| format!("{area_m2:.2} m2"));
            let (map, x_m, y_m, length_m) = (&left.map, left.x_m, left.y_m, left.length_m);
            text += &format!("left at ({x_m:.2}, {y_m:.2}) in {map}: {area}, {length_m:.2} m wide: ");
            text += &left.reason;
            text.push('\n');
        }
        let shown = self.left.len() as u32;
        if self.left_count > shown {
            text += &format!("and {} smaller places\n", self.left_count - shown);
        }
        text
    }
}
