//! What an experiment keeps of each session, in `session.json`, so that it can go on after an interruption.

use super::{Experiment, summary};
use crate::command::Error;
use crate::command::up::{Report, add_plots};
use crate::config::FleetConfig;
use reports::Page;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// File of a session in its folder.
const FILE: &str = "session.json";
/// Largest size of the file, bytes: figures, and pictures of at most 65 maps.
const FILE_BYTES_MAX: u64 = 256 << 20;

/// Returns the folder of a session of an experiment.
pub fn folder(experiment: &Path, number: u32) -> PathBuf {
    experiment.join(format!("session_{number}"))
}

/// What decides about a session; sessions of one experiment differ in their seeds alone.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Seed of the fleet.
    pub seed: u64,
    /// Duration of the session, seconds.
    pub seconds: u32,
    /// Whether time was virtual.
    pub virtual_time: bool,
    /// Link before the operator, and before the robots if they live in a headset.
    pub link: String,
    /// Version of the program.
    pub version: String,
    /// Configuration of the fleet, as TOML.
    pub config: String,
    /// Digest of the room's files; `None`: the room has none.
    #[serde(default)]
    pub room_sha256: Option<String>,
}

impl Settings {
    /// Returns the settings of a session.
    pub fn new(experiment: &Experiment, config: &FleetConfig) -> Self {
        Self {
            seed: config.fleet.seed,
            seconds: experiment.args.seconds,
            virtual_time: experiment.args.fast,
            link: experiment.link_name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            config: config.to_toml(),
            room_sha256: experiment.room_sha256.clone(),
        }
    }
}

/// A session that was run to its end.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Session {
    /// Number of the session, from 1: that of its folder.
    #[serde(skip)]
    pub number: u32,
    /// What decided about it.
    pub settings: Settings,
    /// Figures by their names; `None`: no data.
    pub figures: BTreeMap<String, Option<f64>>,
    /// Maps and plots, as a part of a page.
    pub pictures: String,
}

impl Session {
    /// Keeps what an experiment shows of a report.
    pub fn new(number: u32, settings: Settings, report: &Report) -> Self {
        let mut part = Page::part();
        report.pictures.add_to(&mut part);
        add_plots(&mut part, &report.series, report.fleet.as_ref());
        Self { number, settings, figures: summary::figures(report), pictures: part.into_part() }
    }

    /// Reads the session of a folder; `None`: it has none that was run to its end.
    ///
    /// # Errors
    /// The file cannot be read, or the session had other settings or figures.
    pub fn read(folder: &Path, number: u32, settings: &Settings) -> Result<Option<Self>, Error> {
        let path = folder.join(FILE);
        if !path.exists() {
            return Ok(None);
        }
        let named = |why: String| format!("{}: {why}; choose another folder with --out", path.display());
        let text =
            formats::limited::read_text(&path, FILE_BYTES_MAX).map_err(|why| named(why.to_string()))?;
        let session: Self = serde_json::from_str(&text).map_err(|why| named(why.to_string()))?;
        let room_sha256 = settings.room_sha256.clone();
        if session.settings.room_sha256 != room_sha256
            && (Settings { room_sha256, ..session.settings.clone() }) == *settings
        {
            return Err(named("a session in a room whose files had another content".into()).into());
        }
        if session.settings != *settings {
            return Err(named("a session with other settings".into()).into());
        }
        if !summary::has_all_figures(&session.figures) {
            return Err(named("a session of a program whose figures are others".into()).into());
        }
        Ok(Some(Self { number, ..session }))
    }

    /// Writes the session into its folder.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        let json = serde_json::to_string(self)?;
        formats::atomic::write(&folder.join(FILE), |file| file.write_all(json.as_bytes()))
    }
}

/// Renames the folder of a session that was not run to its end: its saved maps would be taken for the new session's.
pub fn set_aside(folder: &Path) -> std::io::Result<()> {
    if !folder.exists() {
        return Ok(());
    }
    let free =
        (1..).map(|number| folder.with_extension(format!("unfinished-{number}"))).find(|to| !to.exists());
    free.map_or(Ok(()), |to| std::fs::rename(folder, to))
}
