//! What a replay did, and how that is said.

use serde::Serialize;
use slam::{BackEnd, ClosureSearchCounts, FrontEnd, RelocalizationCounts};
use std::time::Duration;

/// What a replay did.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Summary {
    /// The log.
    pub log: String,
    /// Scans that got a pose.
    pub scans: u64,
    /// Scans that were refused, by reason.
    pub stamp_repeated: u64,
    /// See [`Summary::stamp_repeated`].
    pub stamp_went_back: u64,
    /// See [`Summary::stamp_repeated`].
    pub refused_other: u64,
    /// Scans that did not fit the map.
    pub lost: u64,
    /// Scans while it was not known where the robot is in the session's map.
    pub not_located: u64,
    /// How searches for the robot ended.
    pub relocalization: RelocalizationCounts,
    /// Where the robot is said to be at the end: x m, y m, yaw rad.
    pub ends_at: [f64; 3],
    /// Malformed lines.
    pub malformed_lines: u64,
    /// Lines of other kinds.
    pub skipped_lines: u64,
    /// Nodes in the pose graph.
    pub nodes: usize,
    /// Scan to scan constraints.
    pub links: usize,
    /// Loop closures in force.
    pub closures: usize,
    /// Loop closures taken back.
    pub retracted: u64,
    /// How closure searches ended.
    pub closure_searches: ClosureSearchCounts,
    /// Solutions of the whole graph.
    pub solutions: u64,
    /// Reading to final trajectory, seconds.
    pub wall_s: f64,
    /// The log's duration over it.
    pub times_real_time: f64,
    /// Scan path, milliseconds a scan.
    pub scan_ms: Percentiles,
    /// Work beside it, milliseconds a node.
    pub beside_ms: Percentiles,
    /// Cells of the map.
    pub map_width: u32,
    /// See [`Summary::map_width`].
    pub map_height: u32,
    /// Drawing the whole map, milliseconds.
    pub map_ms: f64,
}

impl Summary {
    pub(super) fn count(&mut self, front: &FrontEnd, back: &BackEnd) {
        let (counts, done) = (front.counts(), back.counts());
        (self.scans, self.lost) = (counts.accepted, counts.lost);
        (self.stamp_repeated, self.stamp_went_back) = (counts.stamp_repeated, counts.stamp_went_back);
        self.refused_other = counts.beam_count + counts.geometry;
        (self.nodes, self.links, self.closures) = (done.nodes, done.links, done.closures);
        (self.retracted, self.solutions) = (done.retracted, done.solutions);
        self.closure_searches = done.searches;
        self.relocalization = done.relocalization;
    }
}

/// Of times in milliseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Percentiles {
    pub(super) fn of(mut times: Vec<Duration>) -> Self {
        times.sort_unstable();
        let Some(last) = times.len().checked_sub(1) else { return Self::default() };
        let at = |share: f64| times[(share * last as f64).ceil() as usize].as_secs_f64() * 1e3;
        Self { p50: at(0.5), p99: at(0.99), max: at(1.0) }
    }
}

/// For people, or for machines.
pub(super) fn print(summary: &Summary, json: bool) {
    if json {
        let text = serde_json::to_string_pretty(summary).unwrap_or_default();
        println!("{text}");
        return;
    }
    let s = summary;
    println!("{}", s.log);
    println!("  scans     {} ({} lost, {} malformed lines)", s.scans, s.lost, s.malformed_lines);
    println!(
        "  graph     {} nodes, {} links, {} closures ({} taken back)",
        s.nodes, s.links, s.closures, s.retracted
    );
    if s.relocalization.searches > 0 {
        println!(
            "  located   after {} scans; {} searches, {} found, {} ambiguous, {} contradicted",
            s.not_located,
            s.relocalization.searches,
            s.relocalization.found,
            s.relocalization.ambiguous,
            s.relocalization.contradicted
        );
    }
    println!("  map       {} x {} cells, drawn in {:.1} ms", s.map_width, s.map_height, s.map_ms);
    println!("  wall      {:.2} s, {:.0} x real time", s.wall_s, s.times_real_time);
    for (what, times) in [("scan path", s.scan_ms), ("beside   ", s.beside_ms)] {
        println!("  {what} p50 {:.2}, p99 {:.2}, max {:.2} ms", times.p50, times.p99, times.max);
    }
}
