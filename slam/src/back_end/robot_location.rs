//! What is known of where the robot is in its map, and who is finding it out.

use crate::localizer::Localizer;
use crate::relocalize::{PoseEstimate, RelocalizationCounts, Relocalizer};
use msg::SlamMode;

/// Location of the robot in its map.
pub(super) struct RobotLocation {
    /// What is done with the map.
    pub mode: SlamMode,
    /// In localization: tracks the robot in the fixed map, instead of a growing graph.
    pub localizer: Option<Localizer>,
    /// While it is not known where the robot is: searches the whole map.
    pub relocalizer: Option<Relocalizer>,
    /// While the newest node's component is disconnected: searches the whole map for it.
    pub component_relocalizer: Option<Relocalizer>,
    /// How searches ended, while no relocalizer counts.
    pub relocalization: RelocalizationCounts,
    /// Pose of the next node, if it does not follow from the node before.
    pub next_pose: Option<PoseEstimate>,
    /// The newest node is the one that located the robot.
    pub just_located: bool,
}

impl RobotLocation {
    pub fn new() -> Self {
        Self {
            mode: SlamMode::Mapping,
            localizer: None,
            relocalizer: None,
            component_relocalizer: None,
            relocalization: RelocalizationCounts::default(),
            next_pose: None,
            just_located: false,
        }
    }

    /// How searches for the robot ended.
    pub fn relocalization_counts(&self) -> RelocalizationCounts {
        self.relocalizer.as_ref().map_or(self.relocalization, Relocalizer::counts)
    }
}
