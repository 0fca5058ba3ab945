//! Figures of all sessions beside the paper's: mean, standard deviation, and each session's.

use super::Experiment;
use super::session::Session;
use crate::command::Error;
use crate::command::exit_code::UsageError;
use crate::command::up::system::add_system;
use crate::command::up::{Paper, Report};
use crate::config::{FleetConfig, RobotSource};
use crate::process::record::description::machine;
use headset::wireless::LinkChoice;
use reports::FleetView;
use reports::{Page, Row};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

/// File of the figures in an experiment's folder.
const FILE: &str = "experiment.json";
/// Largest size of the file, bytes.
const FILE_BYTES_MAX: u64 = 16 << 20;
/// Row whose value the paper gives for robots in a headset, and that of another place for simulated ones.
const JITTER: &str = "TF jitter in shared memory, median, ms";
/// TF jitter of the paper, median, milliseconds.
const PAPER_JITTER_MS: f64 = 6.3;

/// One quantity of the table.
#[derive(Clone, Debug, Serialize, Deserialize)]
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
    /// Value of the additional session, which counts in no mean; `None`: no data, or there was none.
    #[serde(default)]
    pub additional: Option<f64>,
    /// Digits behind the point in tables.
    #[serde(skip)]
    digits: usize,
}

/// Figures of an experiment.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Results {
    /// Where the robots live: the simulator, or a headset.
    #[serde(default)]
    pub world: String,
    /// Number of sessions that were run, without the additional one.
    pub sessions: usize,
    /// Duration of a session, seconds.
    pub seconds: u32,
    /// Whether time was virtual.
    pub virtual_time: bool,
    /// Number of each session, from 1; failed ones are missing.
    pub numbers: Vec<u32>,
    /// Link before the operator, and before the robots if they live in a headset.
    pub link: String,
    /// Seed of each session.
    pub seeds: Vec<u64>,
    /// Seed of the additional session; `None`: there was none.
    #[serde(default)]
    pub additional_seed: Option<u64>,
    /// Processor, cores, kernel and memory.
    pub machine: String,
    /// Version of the program.
    pub version: String,
    /// Rows of the table.
    pub quantities: Vec<Quantity>,
}

type Figure = fn(&Paper, &FleetView) -> Option<f64>;

/// Rows of the table: name, digits, value of the paper, figure. Percentages are in percent.
///
/// A figure whose definition changes gets another name: figures of before are then not taken for it.
const FIGURES: &[(&str, usize, Option<f64>, Figure)] = &[
    ("duration, s", 0, None, |paper, _| Some(paper.duration_s)),
    ("scan rate, mean of the slowest robot, Hz", 2, Some(8.83), |paper, _| paper.scan_hz),
    ("scans lost", 0, None, |paper, _| paper.scans_lost.map(|lost| lost as f64)),
    ("merged map, known area, m²", 1, None, |paper, _| paper.merged_m2),
    ("merged map, known share of its cells, %", 1, None, |paper, _| paper.merged_fraction.map(percent)),
    ("robots' maps, known share of their cells, %", 1, None, |paper, _| paper.coverage.map(percent)),
    ("merged map, known share, walls within a cell, %", 2, None, |_, fleet| fleet.room_coverage.map(percent)),
    ("consistency, %", 1, Some(94.7), |paper, _| paper.consistency.map(percent)),
    ("consistency by chance, %", 1, None, |_, fleet| fleet.null_consistency_mean.map(percent)),
    ("occupied F1 of pairs, %", 1, None, |_, fleet| fleet.occupied_f1.map(percent)),
    ("occupied F1 of pairs by chance, %", 1, None, |_, fleet| fleet.null_f1_mean.map(percent)),
    ("occupied F1 of the merged map against the room, %", 1, None, |_, fleet| {
        fleet.against_room.as_ref().map(|room| percent(room.occupied_f1))
    }),
    (JITTER, 3, None, |paper, _| paper.tf_jitter_ms.map(|jitter| jitter.p50)),
    ("TF jitter in shared memory, 95 %, ms", 3, None, |paper, _| paper.tf_jitter_ms.map(|jitter| jitter.p95)),
    ("TF jitter at a TCP client, median, ms", 3, Some(PAPER_JITTER_MS), |paper, _| {
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

/// Returns whether figures have the names that this program gives them.
pub fn has_all_figures(figures: &BTreeMap<String, Option<f64>>) -> bool {
    figures.len() == FIGURES.len() && FIGURES.iter().all(|(name, ..)| figures.contains_key(*name))
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
        Self { name: name.into(), paper, mean, deviation, sessions, additional: None, digits }
    }

    fn format(&self, value: Option<f64>, missing: &str) -> String {
        value.map_or_else(|| missing.to_owned(), |value| format!("{value:.*}", self.digits))
    }

    /// Returns mean and deviation as text.
    fn ours(&self) -> String {
        let mean = self.format(self.mean, "no data");
        let text =
            self.deviation.map_or(mean.clone(), |deviation| format!("{mean} ± {deviation:.*}", self.digits));
        let (known, all) = (self.sessions.iter().flatten().count(), self.sessions.len());
        if known == 0 || known == all { text } else { format!("{text} ({known} of {all})") }
    }
}

impl Results {
    /// Collects the figures of sessions; those behind the experiment's number of sessions are additional.
    pub fn new(experiment: &Experiment, sessions: &[Session]) -> Self {
        let (args, world) = (&experiment.args, experiment.config.world);
        let (counted, additional): (Vec<&Session>, Vec<&Session>) =
            sessions.iter().partition(|session| session.number <= args.sessions);
        let quantity = |(name, digits, paper, _): &(&str, usize, Option<f64>, Figure)| {
            let of_session = |session: &&Session| session.figures.get(*name).copied().flatten();
            let is_compared = *name == JITTER && world == RobotSource::Headset;
            let paper = if is_compared { Some(PAPER_JITTER_MS) } else { *paper };
            let quantity = Quantity::new(name, *digits, paper, counted.iter().map(of_session).collect());
            Quantity { additional: additional.first().and_then(of_session), ..quantity }
        };
        Self {
            world: if world == RobotSource::Headset { "headset" } else { "simulator" }.into(),
            sessions: counted.len(),
            seconds: args.seconds,
            virtual_time: args.fast,
            link: experiment.link_name.clone(),
            numbers: counted.iter().map(|session| session.number).collect(),
            seeds: counted.iter().map(|session| session.settings.seed).collect(),
            additional_seed: additional.first().map(|session| session.settings.seed),
            machine: machine(),
            version: env!("CARGO_PKG_VERSION").into(),
            quantities: FIGURES.iter().map(quantity).collect(),
        }
    }

    /// Reads the figures of another experiment from its folder.
    ///
    /// # Errors
    /// The file cannot be read, or is not one of this program's.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let path = folder.join(FILE);
        let named = |why: String| {
            UsageError(format!("{}: {why}; expected the folder of an experiment", path.display()))
        };
        let text =
            formats::limited::read_text(&path, FILE_BYTES_MAX).map_err(|why| named(why.to_string()))?;
        Ok(serde_json::from_str(&text).map_err(|why| named(why.to_string()))?)
    }

    /// Returns under which conditions the figures were measured, as the head of a column.
    fn conditions(&self) -> String {
        let time = if self.virtual_time { "virtual time" } else { "real time" };
        // The values of the link stand in the report's title, and in experiment.json.
        let link = self.link.split(" (").next().unwrap_or_default();
        format!("{} over {link}, {} sessions of {} s, {time}", self.world, self.sessions, self.seconds)
    }

    /// Returns mean and deviation of a quantity of this table, written as `like` is.
    fn ours(&self, like: &Quantity) -> String {
        let here = self.quantities.iter().find(|quantity| quantity.name == like.name);
        here.map_or_else(|| "no data".into(), |here| Quantity { digits: like.digits, ..here.clone() }.ours())
    }

    /// Formats the table for a terminal, with the means of other experiments.
    pub fn text(&self, beside: &[Self]) -> String {
        let mut text = format!("{:<50} {:>10}  {}\n", "", "the paper", self.conditions());
        for (number, other) in (1..).zip(beside) {
            text += &format!("{:<61}  [{number}] {}\n", "", other.conditions());
        }
        for quantity in &self.quantities {
            let paper = quantity.format(quantity.paper, "-");
            text += &format!("{:<50} {paper:>10}  {:<20}", quantity.name, quantity.ours());
            if self.additional_seed.is_some() {
                text += &format!(" additional: {}", quantity.format(quantity.additional, "no data"));
            }
            for (number, other) in (1..).zip(beside) {
                text += &format!(" [{number}] {}", other.ours(quantity));
            }
            text.truncate(text.trim_end().len());
            text.push('\n');
        }
        text
    }

    /// Writes report.html, experiment.json and sessions.csv; the report shows the means of other experiments too.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, folder: &Path, sessions: &[Session], beside: &[Self]) -> std::io::Result<()> {
        let json = serde_json::to_string_pretty(self)?;
        let files =
            [(FILE, json), ("sessions.csv", self.csv()), ("report.html", self.html(sessions, beside))];
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
        if let Some(seed) = self.additional_seed {
            let value = |quantity: &Quantity| quantity.additional.map_or(String::new(), |v| v.to_string());
            let values: Vec<String> = self.quantities.iter().map(value).collect();
            text += &format!("additional,{seed},{}\n", values.join(","));
        }
        text
    }

    fn html(&self, sessions: &[Session], beside: &[Self]) -> String {
        let time = if self.virtual_time { "virtual time" } else { "real time" };
        let title = format!("Evaluation: {} sessions of {} s", self.sessions, self.seconds);
        let who = if self.is_in_headset() { "robots in a headset and operator" } else { "operator" };
        let about = format!("{time}, {who} over {}, version {}, {}", self.link, self.version, self.machine);
        let mut page = Page::new(&title, &about);
        page.heading("Table IV of the paper, and the same figures here");
        self.add_table(&mut page, beside);
        self.add_notes(&mut page);
        // The sessions' configurations differ in their seeds alone.
        let config = sessions
            .first()
            .map(|first| FleetConfig::from_text(Path::new("session"), &first.settings.config));
        if let Some(Ok(config)) = config {
            add_system(&mut page, &config);
        }
        for session in sessions {
            let is_counted = self.numbers.contains(&session.number);
            let name =
                if is_counted { format!("Session {}", session.number) } else { "Additional session".into() };
            page.heading(&format!("{name}, seed {}", session.settings.seed));
            page.add_part(&session.pictures);
        }
        page.finish()
    }

    fn is_in_headset(&self) -> bool {
        self.world == "headset"
    }

    /// Adds the paper's table, with a column for each other experiment and each session.
    fn add_table(&self, page: &mut Page, beside: &[Self]) {
        let mut heads = vec![String::new(), "the paper".into(), format!("here: {}", self.conditions())];
        heads.extend(beside.iter().map(Self::conditions));
        heads.extend(self.numbers.iter().map(|number| format!("session {number}")));
        heads.extend(self.additional_seed.map(|_| "additional session".into()));
        let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
        let row = |quantity: &Quantity| -> Row {
            let mut row = vec![quantity.name.clone(), quantity.format(quantity.paper, "–"), quantity.ours()];
            row.extend(beside.iter().map(|other| other.ours(quantity)));
            row.extend(quantity.sessions.iter().map(|value| quantity.format(*value, "no data")));
            row.extend(self.additional_seed.map(|_| quantity.format(quantity.additional, "no data")));
            row
        };
        page.table(&heads, &self.quantities.iter().map(row).collect::<Vec<_>>());
    }

    /// Adds what a reader must know to compare the columns.
    fn add_notes(&self, page: &mut Page) {
        page.paragraph(
            "Means are with their standard deviation over the sessions. The paper is Aryan et al., MR-SLAM, University of Bern; – \
             is a value that is not known here. Its robots lived in a headset behind Wi-Fi and people drove them; here a program \
             drives simulated robots over TCP on one machine. By chance: the same maps under wrong transforms that keep at least \
             half of their overlap.",
        );
        if self.is_in_headset() {
            page.paragraph(
                "The robots are simulated in a headset's application, which sends scans, transforms and its clock over TCP as in the \
                 paper, 5 s ahead of the fleet's clock. Jitter in shared memory is that of its transforms where SLAM gets them. The \
                 poses' errors have no data: the fleet does not know where a headset's robots are.",
            );
        }
        if self.link != LinkChoice::Loopback.name() {
            page.paragraph(if self.is_in_headset() {
                "A link delays, stalls and interrupts what passes between headset and fleet, as a Wi-Fi network may. The paper does \
                 not say how its own network behaved."
            } else {
                "A link delays, stalls and interrupts what passes between operator and fleet, as a Wi-Fi network may. The paper does \
                 not say how its own network behaved. Figures in shared memory are before the link."
            });
        }
        if self.virtual_time {
            page.paragraph(
                "Time was virtual: processes take no time, so that jitter and latencies have no data but for what a link before the \
                 robots makes, and the scan rate says only that no scan was lost.",
            );
        }
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
        assert_eq!(quantity.ours(), "10.00 ± 1.00 (3 of 4)");
        let missing = Quantity::new("jitter, ms", 3, Some(6.3), vec![None, None]);
        assert_eq!(missing.ours(), "no data", "and not 0.000 beside the paper's 6.3");
        assert_eq!(Quantity::new("one", 1, None, vec![Some(2.0)]).ours(), "2.0");
    }
}
