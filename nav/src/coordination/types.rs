//! What a coordinator is told, and what it answers.

use super::Leftover;
use crate::observation::MapView;
use msg::{Pose2, RobotId, Stamp};

/// Whether the coordinator may give a robot goals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotAvailability {
    /// It drives to the coordinator's goals.
    Free,
    /// Its place has become uncertain, and it returns to one that it knows.
    Revisiting,
    /// A person drives it.
    Manual,
    /// Its pose in the map is not known.
    Lost,
    /// It does not answer any more; where it stands is an obstacle.
    Silent,
    /// It stands in an exclusion zone, and reaches no floor outside. Only an exploration says so; no input does.
    Excluded,
    /// It reaches no floor of the map, because of obstacles or because the map ends. Only an exploration says so; no input does.
    Enclosed,
}

impl RobotAvailability {
    /// Whether the exploration drives it and knows its place.
    pub fn explores(self) -> bool {
        matches!(self, Self::Free | Self::Revisiting)
    }
}

/// What a robot does with its goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalProgress {
    /// It has no goal.
    Idle,
    /// It drives or looks around.
    Active,
    /// It has arrived and looked at all headings.
    Reached,
    /// It gave up.
    Failed,
    /// It stands because its scans show something at the goal that the map does not.
    Occupied,
}

impl GoalProgress {
    pub(super) fn has_ended(self) -> bool {
        matches!(self, Self::Reached | Self::Failed | Self::Occupied)
    }
}

/// One robot of the fleet.
#[derive(Clone, Copy, Debug)]
pub struct CoordinatedRobot {
    /// The robot described.
    pub robot: RobotId,
    /// Pose in the map; `None` while unknown.
    pub map_from_base: Option<Pose2>,
    /// Pose to return to in the end, in the map; `None`: where it was first seen there.
    pub home: Option<Pose2>,
    /// Whether it may get goals.
    pub availability: RobotAvailability,
    /// What it does with its goal.
    pub progress: GoalProgress,
}

/// Why an exploration is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExplorationEnd {
    /// Nothing reachable is unknown, and the robots are back.
    Completed,
    /// Something that robots could reach is left: they drove for a long time and have seen nothing more. They are back.
    TookTooLong,
    /// All robots are lost, silent, in exclusion zones or surrounded by obstacles.
    NoRobot,
    /// Nothing reachable is unknown in the part of the map around the robots; the map is larger than what is planned on.
    MapTooLarge,
}

/// A leftover with the map that its position is in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundLeftover {
    /// Robot in whose own map it is; `None`: in the merged map.
    pub robot: Option<RobotId>,
    /// What is left there.
    pub leftover: Leftover,
}

/// The fleet at one moment.
#[derive(Clone, Copy, Debug)]
pub struct CoordinationInput<'a> {
    /// Time of the poses.
    pub stamp: Stamp,
    /// Map of all robots: the merged map.
    pub map: MapView<'a>,
    /// Robots whose poses are in this map. A fleet of several maps has a coordinator for each.
    pub robots: &'a [CoordinatedRobot],
    /// Polygons that no robot may enter, corners in the map, metres.
    pub excluded: &'a [Vec<[f64; 2]>],
}

/// Purpose of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalPurpose {
    /// See unknown space.
    Explore,
    /// Stay near a robot that sees much, to help as soon as ways part.
    Follow,
    /// Return to where the robot began.
    Home,
    /// Return to a place that the robot knows, so that SLAM closes a loop.
    Revisit,
}

/// Goal of one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotGoal {
    /// Purpose of the goal.
    pub purpose: GoalPurpose,
    /// Place to drive to, in the map, metres. Identifies the goal.
    pub position_m: [f64; 2],
    /// Headings to look at there, one after the other, radians. Steps are less than half a turn.
    pub headings_rad: Vec<f64>,
    /// Expected time of driving and looking, seconds.
    pub expected_s: f64,
    /// Area expected to be seen, square metres.
    pub gain_m2: f64,
}

/// What the fleet does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CoordinationPhase {
    /// No robot has been able to explore for 5 s. Only an exploration says so; no coordinator does.
    Waiting,
    /// Robots go to viewpoints.
    Exploring,
    /// Nothing reachable is unknown; robots return to where they began.
    Returning,
    /// All robots that could return have returned.
    Done,
}

/// Expected time until nothing reachable is unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeEstimate {
    /// Time to visit all viewpoints known now, seconds: more will be found.
    pub least_s: f64,
    /// Time with an allowance for what is found on the way, seconds: three times as much at first, less later.
    pub most_s: f64,
}
