//! Report of a run, `report.json` for programs and a summary for people.

use super::pictures::{Pictures, write_html};
use crate::config::FleetConfig;
use crate::lossy_path;
use crate::nasa_tlx;
use crate::run::{Run, RunError};
use reports::{DistributionView, Events, FleetView, RobotView, Series, Style, TlxEntry};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Content of `report.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Duration of the run, seconds.
    pub seconds: f64,
    /// Room, or source of the world.
    pub room: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Figures of the paper; `None` if telemetry sent none.
    pub paper: Option<Paper>,
    /// All figures at the end of the run; `None` if telemetry sent none.
    pub fleet: Option<FleetView>,
    /// Measurements of the scripted operator at its end of TCP; `None` without one.
    pub operator: Option<serde_json::Value>,
    /// Figures over time.
    pub series: Series,
    /// Maps as pictures, for the report in HTML.
    #[serde(skip)]
    pub pictures: Pictures,
    /// Paths of the maps without extension (.pgm, .yaml, .png).
    #[serde(serialize_with = "lossy_path::serialize_all")]
    pub maps: Vec<PathBuf>,
    /// What could not be written, with the reasons; empty if everything was.
    pub not_written: Vec<String>,
    /// Ratings of the people who drove, by the raw NASA-TLX form; empty: nobody filled it in.
    pub nasa_tlx: Vec<TlxEntry>,
    /// What happened, with the times.
    #[serde(flatten)]
    pub events: Events,
}

/// Figures of the paper for the whole fleet, as the paper defines them; `None` without data.
#[derive(Clone, Debug, Serialize)]
pub struct Paper {
    /// Duration of the run, seconds.
    pub duration_s: f64,
    /// Scans that SLAM received per second: mean of the run, of the slowest robot (paper: 8.83).
    pub scan_hz: Option<f64>,
    /// Scans that were sent and not received by SLAM, all robots; `None`: not known of one of them.
    pub scans_lost: Option<u64>,
    /// Known area of the merged map, free and occupied, square metres.
    pub merged_m2: Option<f64>,
    /// Known cells over all cells of the merged map, 0 to 1.
    pub merged_fraction: Option<f64>,
    /// Known cells over all cells, mean over the robots' maps, 0 to 1.
    pub coverage: Option<f64>,
    /// Cross-instance consistency, 0 to 1 (paper: 0.947).
    pub consistency: Option<f64>,
    /// TF jitter at telemetry, in shared memory, of the worst robot: median and P95, milliseconds (paper: 6.3).
    pub tf_jitter_ms: Option<Spread>,
    /// Time over which that jitter is counted, seconds: less than the run if telemetry was started again.
    pub tf_jitter_counted_s: f64,
    /// TF jitter at the end of TCP, as the operator's client measures it over all robots, milliseconds.
    pub tf_jitter_client_ms: Option<Spread>,
    /// What the operator drove; `None` without an operator.
    pub teleoperation: Option<Teleoperation>,
}

/// Median and 95th percentile of a distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Median of the values.
    pub p50: f64,
    /// 95th percentile of the values.
    pub p95: f64,
}

/// Profile of the teleoperation: sums over the robots.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Teleoperation {
    /// Number of velocities that were sent.
    pub commands: u64,
    /// Velocities sent per second.
    pub commands_hz: f64,
    /// Number of turns at a robot.
    pub turns: u64,
    /// Time in which a robot was held, seconds.
    pub held_s: f64,
    /// Distance driven, metres.
    pub driven_m: f64,
}

impl Spread {
    fn of(distribution: &DistributionView) -> Option<Self> {
        Some(Self { p50: distribution.p50?.into(), p95: distribution.p95?.into() })
    }

    fn of_json(percentiles: &serde_json::Value) -> Option<Self> {
        Some(Self { p50: percentiles["median"].as_f64()?, p95: percentiles["p95"].as_f64()? })
    }

    /// Formats the values, which are in milliseconds.
    fn milliseconds(spread: Option<Self>) -> String {
        spread.map_or_else(|| "no data".into(), |s| format!("{:.3} ms, P95 {:.3}", s.p50, s.p95))
    }
}

impl Teleoperation {
    fn of_json(operator: &serde_json::Value) -> Option<Self> {
        let robots = operator["robots"].as_array()?;
        // The sum of nothing is -0.
        let sum = |of: fn(&serde_json::Value) -> Option<f64>| robots.iter().filter_map(of).sum::<f64>() + 0.0;
        let (commands, seconds) = (operator["commands"].as_u64()?, operator["seconds"].as_f64()?);
        Some(Self {
            commands,
            commands_hz: if seconds > 0.0 { commands as f64 / seconds } else { 0.0 },
            turns: sum(|robot| robot["turns"].as_f64()) as u64,
            held_s: sum(|robot| robot["held_s"].as_f64()),
            driven_m: sum(|robot| robot["did"]["driven_m"].as_f64()),
        })
    }
}

impl Paper {
    fn new(duration: Duration, fleet: &FleetView, operator: Option<&serde_json::Value>) -> Self {
        let robots = &fleet.robots;
        let rates = robots.iter().filter_map(|robot| robot.scan_hz);
        let jitters = robots.iter().filter_map(|robot| Spread::of(&robot.tf_jitter_ms));
        let coverages: Vec<f64> = robots.iter().filter_map(RobotView::coverage).collect();
        let [free, occupied, _, total, _, _, resolution_m] = fleet.merged_map.slam_stats;
        let known = (total > 0.0).then_some(free + occupied);
        Self {
            duration_s: duration.as_secs_f64(),
            scan_hz: rates.min_by(f64::total_cmp),
            scans_lost: robots.iter().map(|robot| robot.scans_lost).sum(),
            merged_m2: known.map(|cells| cells * resolution_m * resolution_m),
            merged_fraction: known.map(|cells| cells / total),
            coverage: (!coverages.is_empty()).then(|| coverages.iter().sum::<f64>() / coverages.len() as f64),
            consistency: fleet.consistency,
            tf_jitter_ms: jitters.max_by(|a, b| a.p50.total_cmp(&b.p50)),
            tf_jitter_counted_s: fleet.counted_s,
            tf_jitter_client_ms: operator
                .filter(|operator| operator["link"]["tf"]["received"].as_u64() > Some(0))
                .and_then(|operator| Spread::of_json(&operator["link"]["tf"]["jitter_ms"])),
            teleoperation: operator.and_then(Teleoperation::of_json),
        }
    }

    /// Returns the figures beside those that the paper gives: name, this run, the paper.
    pub fn rows(&self) -> Vec<[String; 3]> {
        let no_data = || "no data".to_owned();
        let percent = |value: Option<f64>| value.map_or_else(no_data, |v| format!("{:.1} %", 100.0 * v));
        let lost =
            self.scans_lost.map_or_else(|| "lost: not known".to_owned(), |lost| format!("{lost} lost"));
        let rate = self.scan_hz.map_or_else(no_data, |hz| format!("{hz:.2} Hz, {lost}"));
        let merged = self.merged_m2.map_or_else(no_data, |m2| format!("{m2:.1} m2"));
        let rows = [
            ("duration", format!("{:.0} s", self.duration_s), ""),
            ("scan rate, mean", rate, "8.83 Hz"),
            ("merged map, known", format!("{merged}, {}", percent(self.merged_fraction)), ""),
            ("robots' maps, known", percent(self.coverage), ""),
            ("consistency", percent(self.consistency), "94.7 %"),
            ("TF jitter, telemetry", Spread::milliseconds(self.tf_jitter_ms), "6.3 ms"),
            ("TF jitter, TCP client", Spread::milliseconds(self.tf_jitter_client_ms), ""),
        ];
        rows.map(|(name, here, there)| [name.to_owned(), here, there.to_owned()]).into()
    }

    /// Formats the figures beside those that the paper gives, for a terminal.
    fn table(&self, style: &Style) -> String {
        let mut text = "\n".to_owned() + &style.value_table(["", "this run", "the paper"], &self.rows());
        if let Some(Teleoperation { commands, commands_hz, turns, held_s, driven_m }) = self.teleoperation {
            let line = format!(
                "teleoperation: {turns} turns, {held_s:.0} s held, {driven_m:.1} m driven, {commands} commands ({commands_hz:.1} Hz)"
            );
            text += &style.wrap(&line, 2);
        }
        text
    }
}

impl Report {
    /// Collects the figures at the end of a run.
    pub(super) fn new(
        run: &Run,
        elapsed: Duration,
        fleet: Option<FleetView>,
        operator: Option<serde_json::Value>,
        maps: Vec<PathBuf>,
        events: Events,
    ) -> Self {
        // A file that cannot be read is no lack of answers.
        let (nasa_tlx, not_written) = match nasa_tlx::read(&run.dir, run.begun) {
            Ok(entries) => (entries, Vec::new()),
            Err(why) => (Vec::new(), vec![format!("answers about workload: {why}")]),
        };
        Self {
            maps,
            events,
            nasa_tlx,
            not_written,
            ..Self::of_figures(&run.config, elapsed, fleet, operator)
        }
    }

    /// Collects figures without maps and events.
    pub fn of_figures(
        config: &FleetConfig,
        elapsed: Duration,
        fleet: Option<FleetView>,
        operator: Option<serde_json::Value>,
    ) -> Self {
        Self {
            seconds: elapsed.as_secs_f64(),
            room: config.world_name().into(),
            seed: config.fleet.seed,
            paper: fleet.as_ref().map(|fleet| Paper::new(elapsed, fleet, operator.as_ref())),
            fleet,
            operator,
            series: Series::default(),
            pictures: Pictures::default(),
            maps: Vec::new(),
            not_written: Vec::new(),
            nasa_tlx: Vec::new(),
            events: Events::default(),
        }
    }

    /// Writes `report.json` and `report.html` into the run's folder.
    pub fn write(&self, dir: &Path) -> Result<(), RunError> {
        let json = serde_json::to_string_pretty(self)
            .map_err(|source| RunError::Json { path: dir.join("report.json"), source })?;
        for (name, text) in [("report.json", json), ("report.html", write_html(self))] {
            let path = dir.join(name);
            formats::atomic::write(&path, |file| file.write_all(text.as_bytes()))
                .map_err(RunError::file(&path))?;
        }
        Ok(())
    }

    /// Formats the report for a terminal.
    pub fn summary(&self, style: &Style) -> String {
        let mut text = "\n".to_owned() + &style.wrap(&format!("{:.0} s in {}", self.seconds, self.room), 2);
        if let Some(fleet) = &self.fleet {
            text += &fleet.table(style);
            text += &map_figures(fleet, style);
        }
        if let Some(paper) = &self.paper {
            text += &paper.table(style);
        }
        for map in &self.maps {
            let _ = writeln!(text, "{}.png", map.display());
        }
        if let Some(folder) = self.maps.first().and_then(|map| map.parent()) {
            let _ = writeln!(text, "{}", folder.join("report.html").display());
        }
        text
    }
}

/// Formats how well the maps agree with each other and with the room: figures that a wrong merge cannot reach.
fn map_figures(fleet: &FleetView, style: &Style) -> String {
    let percent = |value: Option<f64>| value.map_or_else(|| "-".into(), |v| format!("{:.1} %", 100.0 * v));
    let row = |name: &str, here: String, chance: String| [name.to_owned(), here, chance];
    let shared = fleet.overlap_m2.map_or_else(|| "-".into(), |m2| format!("{m2:.1} m2"));
    let rows = [
        row("consistency", percent(fleet.consistency), percent(fleet.null_consistency_mean)),
        row("consistency within one cell", percent(fleet.consistency_one_cell), String::new()),
        row("occupied F1 within one cell", percent(fleet.occupied_f1), percent(fleet.null_f1_mean)),
        row("shared area, mean of pairs", shared, String::new()),
    ];
    let headings = ["agreement of the robots' maps", "this run", "by chance"];
    let mut text = "\n".to_owned() + &style.value_table(headings, &rows);
    if fleet.null_transforms > 0 {
        let line = format!("by chance: the same maps under {} wrong transforms, mean", fleet.null_transforms);
        text += &style.wrap(&line, 2);
    }
    if let Some(room) = &fleet.against_room {
        text += "\n";
        text += &room.table(fleet.room_coverage, style);
    }
    for robot in fleet.robots.iter().filter(|robot| robot.map_transform_error_m.is_some()) {
        let (m, deg) =
            (robot.map_transform_error_m.unwrap_or(0.0), robot.map_transform_error_deg.unwrap_or(0.0));
        let line = format!(
            "{}'s map is {m:.3} m and {deg:.2} degrees from its true pose in the merged map",
            robot.robot
        );
        text += &style.wrap(&line, 2);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{Distribution, FleetStats};

    fn stats() -> Box<FleetStats> {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        stats.robot_count = 2;
        stats
    }

    #[test]
    fn a_report_of_a_folder_whose_name_is_not_text_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join(crate::other_fleets::path(b"run\xff".to_vec()));
        std::fs::create_dir(&dir).unwrap();
        let report = Report::of_figures(&FleetConfig::default(), Duration::ZERO, None, None);
        let report = Report { maps: vec![dir.join("merged_map")], ..report };
        report.write(&dir).unwrap();
        let json = std::fs::read_to_string(dir.join("report.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert!(json["maps"][0].as_str().unwrap().ends_with("run\u{fffd}/merged_map"), "{json}");
    }

    #[test]
    fn the_summary_fits_a_narrow_terminal() {
        let mut stats = stats();
        stats.robots[0].scan_hz = 10.0;
        let fleet = FleetView::new(&stats);
        let operator = serde_json::json!({ "commands": 200, "seconds": 10.0, "robots": [] });
        let elapsed = Duration::from_secs(60);
        let report = Report::of_figures(&FleetConfig::default(), elapsed, Some(fleet), Some(operator));
        for width in [39, 60, 79] {
            let text = report.summary(&Style { width, is_coloured: false });
            for line in text.lines() {
                assert!(line.chars().count() <= width, "{width}: `{line}`");
            }
            assert!(text.contains("the paper: 8.83 Hz") == (width < 60), "{width}: {text}");
            assert!(!text.contains("-0"), "a sum of nothing has no sign: {text}");
        }
    }

    #[test]
    fn figures_without_data_are_null_and_not_zero() {
        let paper = Paper::new(Duration::from_secs(60), &FleetView::new(&stats()), None);
        let json = serde_json::to_value(&paper).unwrap();
        for name in [
            "scan_hz",
            "merged_m2",
            "merged_fraction",
            "coverage",
            "consistency",
            "tf_jitter_ms",
            "tf_jitter_client_ms",
            "teleoperation",
        ] {
            assert!(json[name].is_null(), "{name}: {json:#}");
        }
        assert_eq!(json["duration_s"], 60.0);
        let text = paper.table(&Style::PLAIN);
        assert!(text.contains("no data") && !text.contains("0.000 ms"), "{text}");
    }

    #[test]
    fn the_figures_are_those_of_the_slowest_and_worst_robot_and_of_the_client() {
        let mut stats = stats();
        for (robot, p50) in stats.robots.iter_mut().zip([0.1, 0.4]) {
            robot.tf_jitter_ms = Distribution { count: 9, p50, p95: 2.0 * p50, p99: 1.0, max: 2.0 };
        }
        stats.merged_map.free_cells = 300;
        stats.merged_map.occupied_cells = 100;
        (stats.merged_map.width, stats.merged_map.height, stats.merged_map.resolution_m) = (20, 40, 0.1);
        let mut fleet = FleetView::new(&stats);
        (fleet.robots[0].scan_hz, fleet.robots[1].scan_hz) = (Some(10.0), Some(9.67));
        fleet.robots[1].scan_hz_last_second = 10.0;
        let operator = serde_json::json!({
            "commands": 200, "seconds": 10.0,
            "robots": [{ "turns": 2, "held_s": 4.0, "did": { "driven_m": 1.5 } },
                       { "turns": 1, "held_s": 5.0, "did": { "driven_m": 2.0 } }],
            "link": { "tf": { "received": 40, "jitter_ms": { "median": 0.5, "p95": 0.9 } } },
        });
        let paper = Paper::new(Duration::from_secs(10), &fleet, Some(&operator));
        assert_eq!(paper.scan_hz, Some(9.67), "the mean, not the last second");
        let jitter = paper.tf_jitter_ms.unwrap();
        assert!((jitter.p50 - 0.4).abs() < 1e-6 && (jitter.p95 - 0.8).abs() < 1e-6);
        assert_eq!(paper.tf_jitter_client_ms, Some(Spread { p50: 0.5, p95: 0.9 }));
        assert!((paper.merged_m2.unwrap() - 4.0).abs() < 1e-9);
        assert!((paper.merged_fraction.unwrap() - 0.5).abs() < 1e-9);
        let expected =
            Teleoperation { commands: 200, commands_hz: 20.0, turns: 3, held_s: 9.0, driven_m: 3.5 };
        assert_eq!(paper.teleoperation, Some(expected));
    }
}
