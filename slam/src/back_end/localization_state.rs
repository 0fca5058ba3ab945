//! Location of the robot in its map: the current mode, and the localizer or relocalizer at work.

use super::component_search::ComponentSearches;
use crate::localizer::Localizer;
use crate::relocalize::{LocalFrameEstimate, RelocalizationCounts, Relocalizer};
use msg::SlamMode;

/// An estimate by a person that was accepted because no scan spoke against it.
#[derive(Clone, Copy)]
pub(super) struct UnconfirmedEstimate {
    /// The estimate as it was given.
    pub estimate: LocalFrameEstimate,
    /// First node that was placed by it, if the map grows: a link with a node before confirms it.
    pub first_node: u32,
    /// Nodes that had matched a fixed map before it: one more confirms it.
    pub matched_before: u64,
}

/// Location of the robot in its map.
pub(super) struct LocalizationState {
    /// Mode of SLAM: mapping, localization or lifelong mapping.
    pub mode: SlamMode,
    /// In localization: tracks the robot in the fixed map, instead of a growing graph.
    pub localizer: Option<Localizer>,
    /// While the robot is not located: searches the whole map.
    pub relocalizer: Option<Relocalizer>,
    /// While components are unplaced: the searches for the newest node in them and in the map.
    pub component_searches: ComponentSearches,
    /// Counts of searches, while no relocalizer is at work.
    pub relocalization: RelocalizationCounts,
    /// Estimate of the next node's pose, if it does not follow from the node before.
    pub next_node_estimate: Option<LocalFrameEstimate>,
    /// What a person said about where the robot is, while no scan has confirmed it.
    pub unconfirmed: Option<UnconfirmedEstimate>,
    /// The newest node is the one that located the robot.
    pub just_located: bool,
}

impl LocalizationState {
    pub fn new() -> Self {
        Self {
            mode: SlamMode::Mapping,
            localizer: None,
            relocalizer: None,
            component_searches: ComponentSearches::default(),
            relocalization: RelocalizationCounts::default(),
            next_node_estimate: None,
            unconfirmed: None,
            just_located: false,
        }
    }

    /// Counts of relocalization searches by how they ended.
    pub fn relocalization_counts(&self) -> RelocalizationCounts {
        self.relocalizer.as_ref().map_or(self.relocalization, Relocalizer::counts)
    }
}
