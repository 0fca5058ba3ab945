//! Figures of all sessions beside the paper's: mean, standard deviation, and each session's.

use super::ExperimentArgs;
use super::link::LinkChoice;
use super::session::Session;
use crate::command::up::system::add_system;
use crate::command::up::{Paper, Report};
use crate::config::FleetConfig;
use crate::process::record::description::machine;
use reports::FleetView;
use reports::{Page, Row};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

/// One quantity of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Quantity {
    /// Name with its unit.
    pub name: String,
    /// Value of the paper, where it is known here.
    pub paper: Option<f64>,
    /// Mean over the sessions that have data.
    pub mean: Option<f64>,
    /// Standard deviation of the sessions, with n - 1; `None` for fewer than two.
    pub deviation: Option<f64>,
    /// Value of each session; `None`: no data.
    pub sessions: Vec<Option<f64>>,
    /// Digits behind the point in tables.
    #[serde(skip)]
    digits: usize,
}

/// Figures of an experiment.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// Number of sessions that were run.
    pub sessions: usize,
    /// Duration of a session, seconds.
    pub seconds: u32,
    /// Whether time was virtual.
    pub virtual_time: bool,
    /// Number of each session, from 1; failed ones are missing.
    pub numbers: Vec<u32>,
    /// Link between the operator and the fleet.
    pub link: &'static str,
    /// Seed of each session.
    pub seeds: Vec<u64>,
    /// Processor, cores, kernel and memory.
    pub machine: String,
    /// Version of the program.
    pub version: &'static str,
    /// Rows of the table.
    pub quantities: Vec<Quantity>,
}

type Figure = fn(&Paper, &FleetView) -> Option<f64>;

/// Rows of the table: name, digits, value of the paper, figure. Percentages are in percent.
const FIGURES: &[(&str, usize, Option<f64>, Figure)] = &[
    ("duration, s", 0, None, |paper, _| Some(paper.duration_s)),
    ("scan rate, mean of the slowest robot, Hz", 2, Some(8.83), |paper, _| paper.scan_hz),
    ("scans lost", 0, None, |paper, _| Some(paper.scans_lost as f64)),
    ("merged map, known area, m²", 1, None, |paper, _| paper.merged_m2),
    ("merged map, known share of its cells, %", 1, None, |paper, _| paper.merged_fraction.map(percent)),
    ("robots' maps, known share of their cells, %", 1, None, |paper, _| paper.coverage.map(percent)),
    ("merged map, known of what can be known, %", 2, None, |_, fleet| fleet.room_coverage.map(percent)),
    ("consistency, %", 1, Some(94.7), |paper, _| paper.consistency.map(percent)),
    ("consistency by chance, %", 1, None, |_, fleet| fleet.null_consistency_mean.map(percent)),
    ("occupied F1 of pairs, %", 1, None, |_, fleet| fleet.occupied_f1.map(percent)),
    ("occupied F1 of pairs by chance, %", 1, None, |_, fleet| fleet.null_f1_mean.map(percent)),
    ("occupied F1 of the merged map against the room, %", 1, None, |_, fleet| {
        fleet.against_room.as_ref().map(|room| percent(room.occupied_f1))
    }),
    ("TF jitter in shared memory, median, ms", 3, None, |paper, _| {
        paper.tf_jitter_ms.map(|jitter| jitter.p50)
    }),
    ("TF jitter in shared memory, 95 %, ms", 3, None, |paper, _| paper.tf_jitter_ms.map(|jitter| jitter.p95)),
    ("TF jitter at a TCP client, median, ms", 3, Some(6.3), |paper, _| {
        paper.tf_jitter_client_ms.map(|jitter| jitter.p50)
    }),
    ("TF jitter at a TCP client, 95 %, ms", 3, None, |paper, _| {
        paper.tf_jitter_client_ms.map(|jitter| jitter.p95)
    }),
    ("largest pose error at the end, m", 3, None, |_, fleet| {
        fleet.robots.iter().filter_map(|robot| robot.pose_error_m).max_by(f64::total_cmp)
    }),
    ("turns at a robot", 0, None, |paper, _| paper.teleoperation.map(|driven| driven.turns as f64)),
    ("velocities sent, Hz", 1, None, |paper, _| paper.teleoperation.map(|driven| driven.commands_hz)),
    ("distance driven, m", 1, None, |paper, _| paper.teleoperation.map(|driven| driven.driven_m)),
];

/// Returns the figures of a session by their names; `None`: no data.
pub fn figures(report: &Report) -> BTreeMap<String, Option<f64>> {
    let value = |figure: Figure| figure(report.paper.as_ref()?, report.fleet.as_ref()?);
    FIGURES.iter().map(|(name, _, _, figure)| ((*name).to_owned(), value(*figure))).collect()
}

fn percent(share: f64) -> f64 {
    100.0 * share
}

impl Quantity {
    fn new(name: &str, digits: usize, paper: Option<f64>, sessions: Vec<Option<f64>>) -> Self {
        let values: Vec<f64> = sessions.iter().flatten().copied().collect();
        let count = values.len() as f64;
        let mean = (!values.is_empty()).then(|| values.iter().sum::<f64>() / count);
        let deviation = mean.filter(|_| values.len() > 1).map(|mean| {
            let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
            (squares / (count - 1.0)).sqrt()
        });
        Self { name: name.into(), paper, mean, deviation, sessions, digits }
    }

    fn format(&self, value: Option<f64>, missing: &str) -> String {
        value.map_or_else(|| missing.to_owned(), |value| format!("{value:.*}", self.digits))
    }

    /// Returns mean and deviation as text.
    fn ours(&self) -> String {
        let mean = self.format(self.mean, "no data");
        self.deviation.map_or(mean.clone(), |deviation| format!("{mean} ± {deviation:.*}", self.digits))
    }
}

impl Results {
    /// Collects the figures of sessions.
    pub fn new(args: &ExperimentArgs, sessions: &[Session]) -> Self {
        let quantity = |(name, digits, paper, _): &(&str, usize, Option<f64>, Figure)| {
            let of_session = |session: &Session| session.figures.get(*name).copied().flatten();
            Quantity::new(name, *digits, *paper, sessions.iter().map(of_session).collect())
        };
        Self {
            sessions: sessions.len(),
            seconds: args.seconds,
            virtual_time: args.fast,
            link: args.link.name(),
            numbers: sessions.iter().map(|session| session.number).collect(),
            seeds: sessions.iter().map(|session| session.settings.seed).collect(),
            machine: machine(),
            version: env!("CARGO_PKG_VERSION"),
            quantities: FIGURES.iter().map(quantity).collect(),
        }
    }

    /// Formats the table for a terminal.
    pub fn text(&self) -> String {
        let mut text = format!("{:<50} {:>10}  {} sessions\n", "", "the paper", self.sessions);
        for quantity in &self.quantities {
            let paper = quantity.format(quantity.paper, "-");
            text += &format!("{:<50} {paper:>10}  {}\n", quantity.name, quantity.ours());
        }
        text
    }

    /// Writes report.html, experiment.json and sessions.csv.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, folder: &Path, sessions: &[Session]) -> std::io::Result<()> {
        let json = serde_json::to_string_pretty(self)?;
        let files =
            [("experiment.json", json), ("sessions.csv", self.csv()), ("report.html", self.html(sessions))];
        for (name, text) in files {
            formats::atomic::write(&folder.join(name), |file| file.write_all(text.as_bytes()))?;
        }
        Ok(())
    }

    /// Returns a line for each session; figures without data are empty.
    fn csv(&self) -> String {
        let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
        let names: Vec<String> = self.quantities.iter().map(|quantity| quoted(&quantity.name)).collect();
        let mut text = format!("session,seed,{}\n", names.join(","));
        for (session, (number, seed)) in self.numbers.iter().zip(&self.seeds).enumerate() {
            let values = self.quantities.iter().map(|quantity| match quantity.sessions.get(session) {
                Some(Some(value)) => value.to_string(),
                _ => String::new(),
            });
            text += &format!("{number},{seed},{}\n", values.collect::<Vec<_>>().join(","));
        }
        text
    }

    fn html(&self, sessions: &[Session]) -> String {
        let time = if self.virtual_time { "virtual time" } else { "real time" };
        let title = format!("Evaluation: {} sessions of {} s", self.sessions, self.seconds);
        let mut page = Page::new(
            &title,
            &format!("{time}, operator over {}, version {}, {}", self.link, self.version, self.machine),
        );
        page.heading("Table IV of the paper, and the same figures here");
        let mut heads: Vec<String> =
            ["", "the paper", "here, mean ± standard deviation"].map(str::to_owned).into();
        heads.extend(self.numbers.iter().map(|number| format!("session {number}")));
        let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
        let row = |quantity: &Quantity| -> Row {
            let mut row = vec![quantity.name.clone(), quantity.format(quantity.paper, "–"), quantity.ours()];
            row.extend(quantity.sessions.iter().map(|value| quantity.format(*value, "no data")));
            row
        };
        page.table(&heads, &self.quantities.iter().map(row).collect::<Vec<_>>());
        page.paragraph(
            "The paper is Aryan et al., MR-SLAM, University of Bern; – is a value that is not known here. Its people drove \
             robots over Wi-Fi with a headset; here a program drives simulated robots over TCP on one machine. By chance: the \
             same maps under wrong transforms that keep at least half of their overlap.",
        );
        if self.link != LinkChoice::Loopback.name() {
            page.paragraph(
                "A proxy delays, stalls and interrupts what passes between operator and fleet, as a Wi-Fi network may. The paper \
                 does not say how its own network behaved. Figures in shared memory are before the proxy.",
            );
        }
        if self.virtual_time {
            page.paragraph(
                "Time was virtual. Messages take no time then, so that jitter and latencies have no data, and the scan rate says \
                 only that no scan was lost.",
            );
        }
        // The sessions' configurations differ in their seeds alone.
        let config = sessions
            .first()
            .map(|first| FleetConfig::from_text(Path::new("session"), &first.settings.config));
        if let Some(Ok(config)) = config {
            add_system(&mut page, &config);
        }
        for session in sessions {
            page.heading(&format!("Session {}, seed {}", session.number, session.settings.seed));
            page.add_part(&session.pictures);
        }
        page.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_deviation_is_that_of_a_sample_and_what_is_missing_counts_for_nothing() {
        let quantity =
            Quantity::new("rate, Hz", 2, Some(8.83), vec![Some(9.0), None, Some(10.0), Some(11.0)]);
        assert_eq!((quantity.mean, quantity.deviation), (Some(10.0), Some(1.0)));
        assert_eq!(quantity.ours(), "10.00 ± 1.00");
        let missing = Quantity::new("jitter, ms", 3, Some(6.3), vec![None, None]);
        assert_eq!(missing.ours(), "no data", "and not 0.000 beside the paper's 6.3");
        assert_eq!(Quantity::new("one", 1, None, vec![Some(2.0)]).ours(), "2.0");
    }
}
