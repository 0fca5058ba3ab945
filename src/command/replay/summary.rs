//! Summary of a replay, for people and for programs.

use super::records::{Log, Records};
use crate::command::output;
use msg::{Pose2, Stamp};
use recording::ScanGaps;
use recording::bag::LeftOut;
use serde::Serialize;
use slam::{
    BackEnd, ClosureSearchCounts, FrontEnd, OdometryAgreement, PlaceInMap, ReliabilityEvidence,
    RelocalizationCounts, TrajectoryError,
};
use std::time::Duration;

/// Figures of a replay of one log.
// More than 12 fields: the fields are the keys of one flat JSON object, which scripts read.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Summary {
    /// Path of the log.
    pub log: String,
    /// Number of scans that got a pose.
    pub scans: u64,
    /// Number of scans rejected because their stamp repeated.
    pub rejected_stamp_repeated: u64,
    /// Number of scans rejected because their stamp went back.
    pub rejected_stamp_went_back: u64,
    /// Number of scans rejected for their beam count or geometry.
    pub rejected_other: u64,
    /// Number of scans that did not match the map.
    pub lost: u64,
    /// Number of scans without a pose in the map: the robot was not located then.
    pub not_located: u64,
    /// Outcomes of the searches for the robot.
    pub relocalization: RelocalizationCounts,
    /// Error of the trajectory; `None`: the log does not have the true poses.
    pub error: Option<TrajectoryError>,
    /// Pose in the map at the last scan: x m, y m, yaw rad; `None`: it is not known.
    pub ends_at: Option<[f64; 3]>,
    /// Why a recording is used in part: it was cut off or damaged. `None`: it is whole.
    pub damage: Option<String>,
    /// Files of a recording's folder that are not read.
    pub not_read: Vec<String>,
    /// Pauses in the scans of a recording; `None`: there is none.
    pub gaps: Option<ScanGaps>,
    /// Number of malformed lines.
    pub malformed_lines: u64,
    /// Number of lines of other kinds.
    pub skipped_lines: u64,
    /// What is left out of a recording.
    pub left_out: LeftOut,
    /// Number of scans from which the robot's motion during the sweep was not removed.
    pub not_deskewed: u64,
    /// Number of nodes in the pose graph.
    pub nodes: usize,
    /// Number of nodes that nothing connects with the map: they are not in it.
    pub unplaced_nodes: usize,
    /// Number of components of such nodes.
    pub unplaced_components: usize,
    /// Whether there is evidence that the map is wrong: parts of it may be metres off.
    pub unreliable: bool,
    /// The evidence, each as a measured value.
    pub evidence: ReliabilityEvidence,
    /// The evidence that is strong enough, in words.
    pub unreliable_reasons: Vec<&'static str>,
    /// Number of scan-to-scan edges.
    pub links: usize,
    /// Number of loop closures in the pose graph.
    pub closures: usize,
    /// Number of loop closures that were removed.
    pub retracted: u64,
    /// Outcomes of the closure searches.
    pub closure_searches: ClosureSearchCounts,
    /// Number of solutions of the whole graph, failed ones included.
    pub solutions: u64,
    /// Number of solutions that failed; the map stayed as it was.
    pub failed_solutions: u64,
    /// Duration from reading to the final trajectory, seconds; `None`, like the others: not measured.
    pub wall_s: Option<f64>,
    /// Duration of the log over the duration of the replay.
    pub times_real_time: Option<f64>,
    /// Duration of the front end for a scan, milliseconds.
    pub scan_ms: Option<Percentiles>,
    /// Duration of the back end for a node, milliseconds.
    pub back_end_ms: Option<Percentiles>,
    /// Width of the map, cells; `None`, like the others: it was not drawn.
    pub map_width: Option<u32>,
    /// Height of the map, cells.
    pub map_height: Option<u32>,
    /// Duration of drawing the whole map, milliseconds.
    pub map_ms: Option<f64>,
}

impl Summary {
    /// Formats the summary for a terminal.
    pub(super) fn text(&self) -> String {
        let s = self;
        let mut text = format!(
            "{}\n  scans     {} ({} lost, {} malformed lines)\n  graph     {} nodes, {} links, {} closures ({} removed)\n",
            s.log, s.scans, s.lost, s.malformed_lines, s.nodes, s.links, s.closures, s.retracted
        );
        if s.relocalization.searches > 0 {
            text += &format!(
                "  located   in all but {} scans; {} searches, {} found, {} ambiguous, {} contradicted\n",
                s.not_located,
                s.relocalization.searches,
                s.relocalization.found,
                s.relocalization.ambiguous,
                s.relocalization.contradicted
            );
        }
        text += &s.left_out_text();
        if s.not_deskewed > 0 {
            text += &format!(
                "  skewed    {} scans whose time increment is implausible, or during which the motion is unknown\n",
                s.not_deskewed
            );
        }
        text += &s.error.map_or(String::new(), |error| error.text());
        if s.unplaced_nodes > 0 {
            text += &format!(
                "  missing   {} nodes in {} components whose place in the map is not known\n",
                s.unplaced_nodes, s.unplaced_components
            );
        }
        text += &s.doubts();
        if let (Some(width), Some(height), Some(ms)) = (s.map_width, s.map_height, s.map_ms) {
            text += &format!("  map       {width} x {height} cells, rendered in {ms:.1} ms\n");
        }
        if let (Some(wall_s), Some(times)) = (s.wall_s, s.times_real_time) {
            text += &format!("  wall time {wall_s:.2} s, {times:.0} x real time\n");
        }
        for (name, times) in [("front end", s.scan_ms), ("back end ", s.back_end_ms)] {
            if let Some(Percentiles { p50, p99, max }) = times {
                text += &format!("  {name} p50 {p50:.2}, p99 {p99:.2}, max {max:.2} ms\n");
            }
        }
        text
    }

    /// Says what of the log was not read or used, if anything.
    fn left_out_text(&self) -> String {
        let s = self;
        let mut text = String::new();
        if let Some(why) = &s.damage {
            text += &format!("  damaged   {why}\n");
        }
        if !s.not_read.is_empty() {
            text += &format!("  not read  {}\n", s.not_read.join(", "));
        }
        if let Some(gaps) = &s.gaps {
            text += &format!("  pauses    {gaps}\n");
        }
        let rejected = s.rejected();
        if rejected > 0 {
            text += &format!(
                "  left out  {rejected} scans whose stamps repeat or go back, or whose geometry is wrong\n"
            );
        }
        if s.left_out.stray_stamps > 0 {
            text += &format!("  left out  {} scans whose single stamps are wrong\n", s.left_out.stray_stamps);
        }
        text
    }

    /// Says why the map may be wrong, if there is a reason.
    fn doubts(&self) -> String {
        let reason = |reason: &&str| format!("  unreliable {reason}: the map may be wrong by metres\n");
        let mut text: String = self.unreliable_reasons.iter().map(reason).collect();
        let agreement = &self.evidence.odometry_agreement;
        if agreement.reasons().next().is_some() || self.has_other_scale() {
            text += &agreement_text(agreement);
        }
        text
    }

    /// Returns the number of scans that are left out.
    pub(super) fn rejected(&self) -> u64 {
        self.rejected_stamp_repeated + self.rejected_stamp_went_back + self.rejected_other
    }

    /// Returns whether one of scans and odometry measures lengths wrongly.
    pub(super) fn has_other_scale(&self) -> bool {
        let ratio = self.evidence.odometry_agreement.distance_ratio;
        ratio.is_some_and(|ratio| (ratio - 1.0).abs() > SCALE_TOLD)
    }

    /// Copies the pose at the last scan, with its place in the map.
    pub(super) fn set_end(&mut self, last: Option<&(Stamp, Pose2, PlaceInMap)>) {
        let known = last.filter(|(_, _, place)| *place == PlaceInMap::Known);
        self.ends_at = known.map(|(_, pose, _)| [pose.x_m, pose.y_m, pose.yaw_rad]);
    }

    /// Copies what a log says about itself, once all is read.
    pub(super) fn count_log(&mut self, log: &Log) {
        self.left_out = log.left_out();
        self.gaps = log.gaps();
        self.damage = log.damage().map(str::to_owned);
        self.not_read = log.not_read().to_vec();
    }

    /// Counts what reading the scans has left out, and says it.
    pub(super) fn count_records(&mut self, records: &Records<'_>) {
        (self.malformed_lines, self.skipped_lines) = (records.malformed, records.skipped());
        let stray = records.stray_stamps();
        self.left_out.stray_stamps += stray;
        if stray > 0 {
            output::note(&format!(
                "{}: {stray} scans are left out: their stamps are more than a second later than those of the scans after them",
                self.log
            ));
        }
    }

    /// Copies the counters of front end and back end.
    pub(super) fn count(&mut self, front: &FrontEnd, back: &BackEnd) {
        let (counts, done) = (front.counts(), back.counts());
        (self.scans, self.lost) = (counts.accepted, counts.lost);
        (self.rejected_stamp_repeated, self.rejected_stamp_went_back) =
            (counts.rejected_stamp_repeated, counts.rejected_stamp_went_back);
        self.not_deskewed = counts.not_deskewed;
        self.rejected_other = counts.rejected_beam_count + counts.rejected_geometry;
        (self.nodes, self.links, self.closures) = (done.nodes, done.links, done.closures);
        (self.retracted, self.solutions) = (done.retracted, done.solutions);
        self.unplaced_nodes = done.unplaced;
        self.unplaced_components = back.unplaced_component_count();
        self.evidence = back.reliability_evidence();
        self.unreliable = self.evidence.is_unreliable();
        self.unreliable_reasons = self.evidence.reasons().collect();
        self.failed_solutions = done.failed_solutions;
        self.closure_searches = done.searches;
        self.relocalization = done.relocalization;
    }
}

/// Deviation of the lengths in the map from odometry's from which it is said, as a share: wheels and their tracks are measured better.
const SCALE_TOLD: f64 = 0.1;

/// Returns the line that says how the motion in the map compares with odometry's.
fn agreement_text(agreement: &OdometryAgreement) -> String {
    let OdometryAgreement { turn_ratio, distance_ratio, direction_rad } = agreement;
    let text = |value: &Option<f64>, decimals: usize| {
        value.map_or("unknown".into(), |value| format!("{value:.decimals$}"))
    };
    format!(
        "  odometry  in the map turns are {} and distances {} times odometry's, and directions are {} rad from odometry's\n",
        text(turn_ratio, 2),
        text(distance_ratio, 2),
        text(direction_rad, 3)
    )
}

/// Percentiles of durations, milliseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Percentiles {
    /// 50th percentile, milliseconds.
    pub p50: f64,
    /// 99th percentile, milliseconds.
    pub p99: f64,
    /// Largest duration, milliseconds.
    pub max: f64,
}

impl Percentiles {
    /// Returns the percentiles of the durations; `None` without any.
    pub(super) fn of(mut times: Vec<Duration>) -> Option<Self> {
        times.sort_unstable();
        let last = times.len().checked_sub(1)?;
        let at = |share: f64| times[(share * last as f64).ceil() as usize].as_secs_f64() * 1e3;
        Some(Self { p50: at(0.5), p99: at(0.99), max: at(1.0) })
    }
}
