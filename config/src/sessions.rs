//! The settings of sessions: what SLAM begins with, and how often it saves.

use msg::SlamMode;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Shortest autosave period, seconds: saving a large map takes a good part of a second.
const AUTOSAVE_MIN_S: f64 = 1.0;
/// Longest autosave period, seconds: a day. Somebody who wants it longer wants none.
const AUTOSAVE_MAX_S: f64 = 86_400.0;

/// Use of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The map grows
    #[default]
    #[value(alias = "continue")]
    Mapping,
    /// The map stays unchanged
    #[value(alias = "localize")]
    Localization,
    /// The map grows, and obstacles that later scans contradict are removed
    Lifelong,
}

impl From<Mode> for SlamMode {
    fn from(mode: Mode) -> Self {
        match mode {
            Mode::Mapping => Self::Mapping,
            Mode::Localization => Self::Localization,
            Mode::Lifelong => Self::Lifelong,
        }
    }
}

/// Reason why the section `[sessions]` is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionsConfigError {
    /// The period is out of range.
    #[error(
        "sessions.autosave_s is {0}; expected {AUTOSAVE_MIN_S} to {AUTOSAVE_MAX_S} seconds, or 0 for never"
    )]
    Autosave(f64),
    /// There is no map to localize in.
    #[error(
        "sessions.mode is `localization`, which needs maps; expected begin_with = \"DIR\", or the option --sessions DIR"
    )]
    LocalizationWithoutMaps,
}

impl SessionsConfigError {
    /// Returns the key below `sessions`.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Autosave(_) => "autosave_s",
            Self::LocalizationWithoutMaps => "mode",
        }
    }
}

/// Section `[sessions]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SessionsConfig {
    /// Use of the map at the start: `mapping`, `localization` or `lifelong`.
    pub mode: Mode,
    /// Folder of sessions to begin with, such as `runs/TIME/sessions`; empty: none. Robots without a file in it begin a
    /// new map.
    pub begin_with: PathBuf,
    /// Period at which each SLAM process saves what has changed, seconds, 1 to 86400; 0: never. In between, nodes go to a
    /// log beside the session: a crash of SLAM loses 0.5 s of the map at most. Without saving, it loses the map.
    pub autosave_s: f64,
}

impl Default for SessionsConfig {
    fn default() -> Self {
        Self { mode: Mode::Mapping, begin_with: PathBuf::new(), autosave_s: 30.0 }
    }
}

impl SessionsConfig {
    /// Checks ranges and keys that depend on each other.
    pub fn validate(&self) -> Result<(), SessionsConfigError> {
        if self.autosave_s != 0.0 && !(AUTOSAVE_MIN_S..=AUTOSAVE_MAX_S).contains(&self.autosave_s) {
            return Err(SessionsConfigError::Autosave(self.autosave_s));
        }
        if self.mode == Mode::Localization && self.folder().is_none() {
            return Err(SessionsConfigError::LocalizationWithoutMaps);
        }
        Ok(())
    }

    /// Returns the folder to begin with, if there is one.
    pub fn folder(&self) -> Option<&Path> {
        (!self.begin_with.as_os_str().is_empty()).then_some(self.begin_with.as_path())
    }
}
