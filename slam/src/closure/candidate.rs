//! Candidates of loop closures, and the detector's state and counts.

use msg::Pose2;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// A place seen before that a later node was found at.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ClosureCandidate {
    /// The later node, which was searched for.
    pub newer: u32,
    /// The earlier node, near which the later one was found.
    pub older: u32,
    /// Pose of the later node in the frame of the earlier one, as measured.
    pub older_from_newer: Pose2,
    /// Inverse covariance in the frame of the earlier node, 1/m² and 1/rad².
    #[serde(with = "crate::encoding::matrix")]
    pub information: Matrix3<f64>,
    /// Mean field value under the later node's points, 0 to 1.
    pub response: f32,
}

/// State of a detector, kept in a session.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ClosureDetectorState {
    /// Candidates that wait for confirmation, oldest first.
    pub pending: Vec<ClosureCandidate>,
    /// Counts of searches by how they ended.
    pub counts: ClosureSearchCounts,
    /// Length of the path at the last search, metres.
    pub last_search_m: Option<f64>,
}

/// Counts of closure searches by how they ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClosureSearchCounts {
    /// Searches of a place, whatever their result.
    pub searches: u64,
    /// Searches in which no pose reached the least score.
    pub below_min_response: u64,
    /// Searches in which two places looked alike, or that stopped at a limit.
    pub ambiguous: u64,
    /// Searches whose alignment overlapped too little, moved too far or contradicted scans.
    pub contradicted: u64,
    /// Candidates that were never confirmed.
    pub unconfirmed: u64,
    /// Candidates that enough others confirmed.
    pub accepted: u64,
}
