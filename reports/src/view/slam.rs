//! State of one robot's SLAM as people and programs read it.

use msg::{ClosureInfo, Pose2, RobotId, SlamMode, SlamResponse};
use serde::Serialize;
use std::path::Path;

/// Response of a robot's SLAM, with names and units; JSON of `mr-slam slam`.
// More than 12 fields: they are the keys of the JSON.
#[derive(Clone, Debug, Serialize)]
pub struct SlamView<'a> {
    /// Folder of the run.
    pub run: &'a Path,
    /// Robot, such as `robot1`.
    pub robot: String,
    /// Message of SLAM, such as the file that it wrote; may be empty.
    pub text: String,
    /// `mapping`, `localization` or `lifelong`.
    pub mode: &'static str,
    /// Whether scans are ignored.
    pub paused: bool,
    /// Whether scans say where the robot is in the map.
    pub located: bool,
    /// Whether a person said where the robot is, and no scan has confirmed it yet.
    pub unconfirmed: bool,
    /// Pose of `base_footprint` in `robotK/map` at the newest node: x m, y m, yaw rad; `None`: not known.
    pub map_from_base: Option<[f64; 3]>,
    /// Number of nodes in the pose graph.
    pub nodes: u32,
    /// Number of scan-to-scan edges.
    pub links: u32,
    /// Number of loop closures in the pose graph.
    pub closures: u32,
    /// Number of loop closures that were removed.
    pub retracted: u32,
    /// Loop closures, if they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub list: Option<Vec<ClosureView>>,
}

/// One loop closure.
#[derive(Clone, Debug, Serialize)]
pub struct ClosureView {
    /// Number in the list.
    pub number: u32,
    /// Number of the older node.
    pub older: u32,
    /// Number of the newer node.
    pub newer: u32,
    /// Whether the pose graph uses it.
    pub is_active: bool,
    /// Measured pose of the newer node in the older: x m, y m, yaw rad.
    pub older_from_newer: [f64; 3],
    /// Pose of the older node in the map: x m, y m, yaw rad.
    pub map_from_older: [f64; 3],
    /// Pose of the newer node in the map: x m, y m, yaw rad.
    pub map_from_newer: [f64; 3],
    /// Matching response, 0 to 1.
    pub response: f32,
    /// Squared Mahalanobis distance between measurement and map.
    pub chi_squared: f32,
}

impl<'a> SlamView<'a> {
    /// Converts a response; `closures` are listed if they were asked for.
    pub fn new(
        run: &'a Path,
        robot: RobotId,
        response: &SlamResponse,
        closures: Option<&[ClosureInfo]>,
    ) -> Self {
        Self {
            run,
            robot: robot.to_string(),
            text: response.text.as_str().into(),
            mode: SlamMode::from_code(response.mode).map_or("unknown", SlamMode::name),
            paused: response.paused == 1,
            located: response.located == 1,
            unconfirmed: response.located == SlamResponse::UNCONFIRMED,
            map_from_base: (response.located != 0).then(|| numbers(response.map_from_base)),
            nodes: response.nodes,
            links: response.links,
            closures: response.closures,
            retracted: response.retracted,
            list: closures.map(|closures| closures.iter().map(ClosureView::new).collect()),
        }
    }

    /// Formats mode, graph, closures and the robot's pose for a terminal.
    pub fn table(&self) -> String {
        let Self { mode, nodes, links, closures, retracted, .. } = self;
        let pose = match self.map_from_base {
            Some([x, y, yaw]) => {
                format!("{x:.2} {y:.2} m, {yaw:.2} rad at the newest node{}", self.reservation())
            }
            None => "not located yet".into(),
        };
        let paused = if self.paused { ", paused" } else { "" };
        format!(
            "mode      {mode}{paused}\npose      {pose}\ngraph     {nodes} nodes, {links} links\n\
             closures  {closures} in the graph, {retracted} removed\n"
        )
    }

    /// Says that the pose is a person's alone, if it is.
    fn reservation(&self) -> &'static str {
        if self.unconfirmed { ", as a person said; no scan has confirmed it yet" } else { "" }
    }

    /// Formats the robot's pose as a sentence.
    pub fn pose_sentence(&self) -> String {
        let robot = &self.robot;
        match self.map_from_base {
            Some([x, y, yaw]) => {
                let reservation = self.reservation();
                format!("{robot} is at {x:.2} {y:.2} m, {yaw:.2} rad in its map{reservation}\n")
            }
            None => format!(
                "{robot} is not located yet; drive it two or three metres so that its scans can be matched\n"
            ),
        }
    }

    /// Formats the list of closures for a terminal.
    pub fn closure_table(&self) -> String {
        let closures = self.list.as_deref().unwrap_or_default();
        if closures.is_empty() {
            return "no closures\n".into();
        }
        let mut text = format!(
            "{:>6}  {:>13}  {:>8} {:>8}  {:>8}  {:>8}\n",
            "number", "nodes", "x m", "y m", "response", "sigmas"
        );
        for c in closures {
            let [x, y, _] = c.map_from_newer;
            let nodes = format!("{} - {}", c.older, c.newer);
            let sigmas = c.chi_squared.max(0.0).sqrt();
            let state = if c.is_active { "" } else { "  removed" };
            text += &format!(
                "{:>6}  {nodes:>13}  {x:>8.2} {y:>8.2}  {:>8.2}  {sigmas:>8.2}{state}\n",
                c.number, c.response
            );
        }
        text
    }
}

impl ClosureView {
    fn new(closure: &ClosureInfo) -> Self {
        Self {
            number: closure.number,
            older: closure.older,
            newer: closure.newer,
            is_active: closure.is_active == 1,
            older_from_newer: numbers(closure.older_from_newer),
            map_from_older: numbers(closure.map_from_older),
            map_from_newer: numbers(closure.map_from_newer),
            response: closure.response,
            chi_squared: closure.chi_squared,
        }
    }
}

fn numbers(pose: Pose2) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.yaw_rad]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_that_only_a_person_gave_is_shown_and_not_located() {
        let view = |located| {
            let response = SlamResponse { located, ..SlamResponse::default() };
            SlamView::new(Path::new("run"), RobotId::new(1).unwrap(), &response, None)
        };
        let [nobody, scans, person] = [0, 1, SlamResponse::UNCONFIRMED].map(view);
        let flags = |view: &SlamView<'_>| (view.located, view.unconfirmed, view.map_from_base.is_some());
        assert_eq!(flags(&nobody), (false, false, false));
        assert_eq!(flags(&scans), (true, false, true));
        assert_eq!(flags(&person), (false, true, true));
        assert!(person.table().contains("no scan has confirmed it yet"), "{}", person.table());
        assert!(person.pose_sentence().contains("as a person said"), "{}", person.pose_sentence());
        assert!(!scans.table().contains("confirmed"), "{}", scans.table());
    }
}
