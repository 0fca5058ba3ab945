//! Topics that clients may publish, by what the fleet does with their messages.

use msg::RobotId;

/// The topic on which a goal for the selected robot comes, here and in Nav2.
pub const SHARED_GOAL: &str = "/goal_pose";

/// The topic that starts and stops exploration; explore_lite's name for it.
pub const EXPLORE: &str = "/explore/resume";

/// The topic on which an exclusion zone is added.
pub const ADD_ZONE: &str = "/exclusion_zones/add";

/// The topic on which exclusion zones are removed.
pub const REMOVE_ZONE: &str = "/exclusion_zones/remove";

/// What the fleet does with the messages of a topic, from a client or from DDS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputPurpose {
    /// A velocity for the selected robot.
    SelectedCommand,
    /// A velocity for one robot.
    Command(RobotId),
    /// A thumb stick and a grip, as sensor_msgs/Joy, for the selected robot.
    Joystick,
    /// A thumb stick and a grip, as quest2ros/OVR2ROSInputs, for the selected robot.
    HandInputs,
    /// A robot's pose as a person gives it. `None`: the message's frame or the selection names the robot.
    InitialPose(Option<RobotId>),
    /// A pose to drive to. `None`: the selected robot is meant.
    Goal(Option<RobotId>),
    /// Poses for a robot to drive to, one after another.
    Waypoints(RobotId),
    /// Gives a robot's goal up.
    CancelNavigation(RobotId),
    /// Drives a robot on to the goal that was paused.
    ResumeNavigation(RobotId),
    /// `true` explores with all robots but those that drive to a person's goal, `false` stops the exploration.
    Explore,
    /// An area of the merged map to keep robots out of.
    AddZone,
    /// The number of the exclusion zone to remove; 0 for all.
    RemoveZone,
    /// The number of the robot to select.
    SelectRobot,
    /// The number of the robot to take over from its driver; 0 for all robots.
    TakeControl,
    /// `true` sets the emergency stop.
    EmergencyStop,
    /// Releases the emergency stop.
    ReleaseStop,
    /// `pin 1 2`, `unpin 1 2` or `undo 1 2`: what merging is to do with the edges between two robots' maps.
    MergeEdge,
    /// Transforms. Those of the fleet's own frames are refused, or taken as the robots' own in an external world.
    Transforms,
    /// Transforms of one robot on its own topic, in an external world: its frames may be plain.
    RobotTransforms(RobotId),
    /// Transforms of an external world that never change.
    StaticTransforms,
    /// The same of one robot on its own topic: its frames may be plain.
    RobotStaticTransforms(RobotId),
    /// A robot's scan, in an external world.
    Scan(RobotId),
    /// A robot's wheel odometry, in an external world.
    Odometry(RobotId),
    /// The state of a robot's battery, in an external world.
    Battery(RobotId),
    /// The time of an external world.
    Clock,
}
