//! States of navigation and exploration as JSON.

use msg::{ExclusionZones, ExplorationLeftover, ExplorationReport, NavigationReport, RobotId};
use ros_messages::{FrameNames, RobotNames, names};
use serde_json::json;

/// Returns the state of a robot's navigation as JSON.
pub(super) fn navigation_json(report: &NavigationReport) -> String {
    let other = RobotId::new(report.other_robot as usize).map(|robot| robot.to_string());
    json!({
        "state": report.status().name(),
        "reason": report.reason(),
        "goal": report.number,
        "pose": report.next_pose,
        "remaining_m": report.remaining_m.is_finite().then_some(report.remaining_m),
        "waits_for": other,
    })
    .to_string()
}

/// Returns the state of the fleet's exploration as JSON.
pub(super) fn exploration_json(
    report: &ExplorationReport,
    robots: &RobotNames,
    frames: &FrameNames,
) -> String {
    let finite = |value: f64| value.is_finite().then_some(value);
    let left = |left: &ExplorationLeftover| {
        let frame = RobotId::new(left.map_robot as usize).map_or(names::MAP, |robot| frames.map(robot));
        json!({
            "frame": frame,
            "x_m": left.position_m[0],
            "y_m": left.position_m[1],
            "length_m": left.length_m,
            "area_m2": finite(left.area_m2),
            "reason": left.reason().map(|reason| reason.to_string()),
        })
    };
    json!({
        "state": report.status().name(),
        "reason": report.reason(),
        "elapsed_s": finite(report.elapsed_s),
        "known_m2": finite(report.known_m2),
        "least_s": finite(report.least_s),
        "most_s": finite(report.most_s),
        "robots": robots.robots().map(|robot| report.robot(robot.index()).name()).collect::<Vec<_>>(),
        "left": report.leftovers().iter().map(left).collect::<Vec<_>>(),
        "left_count": report.leftovers_count,
    })
    .to_string()
}

/// Returns the exclusion zones as JSON.
pub(super) fn zones_json(zones: &ExclusionZones) -> String {
    let zone = |zone: &msg::ExclusionZone| {
        let source = Some(zone.source()).filter(|label| !label.is_empty());
        json!({ "number": zone.number, "corners_m": zone.corners_m(), "furniture": source })
    };
    let all: Vec<_> = zones.zones().iter().map(zone).collect();
    json!({ "frame": names::MAP, "zones": all, "refusal": zones.refusal().map(|why| why.to_string()) })
        .to_string()
}
