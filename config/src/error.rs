//! Reasons why a configuration is refused, and the line of the file that sets a key.

use super::{MachineLinkConfigError, RecordingConfigError, SessionsConfigError};
use bridge::RobotNameError;
use msg::ROBOTS_MAX;
use runtime::realtime::RealtimeConfigError;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Reason why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {why}", path.display())]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        why: std::io::Error,
    },
    /// The file is no TOML, has an unknown key or a value of the wrong type.
    #[error("{}:{line}: {setting}{}", path.display(), why.message())]
    Syntax {
        /// Path of the file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is set there, such as `` `fleet.robots = "three"`:  ``; empty if the text is no TOML.
        setting: String,
        /// Error of the parser.
        why: Box<toml::de::Error>,
    },
    /// A value of the file is out of range.
    #[error("{}:{line}: {why}", path.display())]
    InFile {
        /// Path of the file.
        path: PathBuf,
        /// Line number of the key, from 1.
        line: usize,
        /// The value, and what was expected.
        why: ValueError,
    },
    /// A value that an option sets, or that the program sets itself, is out of range.
    #[error(transparent)]
    Value(#[from] ValueError),
}

/// A value that is out of range, or that does not go with another key's.
#[derive(Debug, thiserror::Error)]
pub enum ValueError {
    /// No fleet has so many robots.
    #[error("fleet.robots is {0}; expected 1 to {ROBOTS_MAX} robots")]
    Robots(usize),
    /// The number of starts is not that of the robots.
    #[error("fleet.starts has {starts} poses for {robots} robots; expected one for each, or none")]
    StartsCount {
        /// Number of poses.
        starts: usize,
        /// Number of robots.
        robots: usize,
    },
    /// The seed is larger than a file's integers.
    #[error("fleet.seed is {0}; expected 0 to 9223372036854775807")]
    Seed(u64),
    /// A start is not finite, is in millimetres, or has a yaw in degrees.
    #[error(
        "fleet.starts[{index}] is {start:?}; expected [x, y, yaw]: metres from -{m} to {m}, and radians from -6.29 to 6.29 (90 degrees are 1.57)",
        m = crate::START_MAX_M
    )]
    Start {
        /// Place in the list, from 0.
        index: usize,
        /// Pose as the file has it.
        start: [f64; 3],
    },
    /// The number of names is not that of the robots.
    #[error("fleet.names has {names} names for {robots} robots; expected one for each, or none")]
    NamesCount {
        /// Number of names.
        names: usize,
        /// Number of robots.
        robots: usize,
    },
    /// A name cannot be used in ROS.
    #[error("fleet.names: {0}")]
    Name(#[from] RobotNameError),
    /// The address to listen on is none.
    #[error("fleet.address is `{0}`; expected an IP address, such as 0.0.0.0 or 127.0.0.1")]
    Address(String),
    /// The world is ROS's, but ROS 2 is off.
    #[error(
        "world is `ros`, which needs ROS 2; expected bridge.dds.enabled = true, or the option --ros-domain ID"
    )]
    RosWithoutDds,
    /// A value of the simulated robot.
    #[error(transparent)]
    Sim(#[from] sim::ConfigError),
    /// A value of SLAM.
    #[error(transparent)]
    Slam(#[from] slam::ConfigError),
    /// A value of the sessions.
    #[error(transparent)]
    Sessions(#[from] SessionsConfigError),
    /// A value of section `[recording]`.
    #[error(transparent)]
    Recording(#[from] RecordingConfigError),
    /// A value of section `[link]`.
    #[error(transparent)]
    Link(#[from] MachineLinkConfigError),
    /// A value of merging.
    #[error(transparent)]
    Merge(#[from] merge::InvalidMergeConfig),
    /// A value of the bridge.
    #[error(transparent)]
    Bridge(#[from] bridge::ConfigError),
    /// Limits of a robot that the fleet does not have.
    #[error(
        "bridge.velocity.robots[{index}].robot is {robot}; expected a robot of this fleet, 1 to {robots} (fleet.robots)"
    )]
    LimitsOfNoRobot {
        /// Place in the list, from 0.
        index: usize,
        /// Number of the robot, as the file has it.
        robot: usize,
        /// Number of robots.
        robots: usize,
    },
    /// A file cannot hold the configuration, from which the fleet's processes read it: a path is no UTF-8, for example.
    #[error("the configuration cannot be written to a file: {0}; expected paths in UTF-8")]
    NotWritable(String),
    /// A value of ROS 2's environment variables.
    #[error(transparent)]
    Discovery(#[from] bridge::dds::DiscoveryError),
    /// A value of the real-time settings.
    #[error(transparent)]
    Realtime(#[from] RealtimeConfigError),
}

/// Keys whose range depends on another key, which alone may be in the file: key and other key.
const DEPENDENT_KEYS: [(&str, &str); 4] = [
    ("sim.lidar.range_max_m", "sim.lidar.range_min_m"),
    ("bridge.frame_bytes_max", "bridge.limits.held_bytes_max"),
    ("fleet.starts", "fleet.robots"),
    ("fleet.names", "fleet.robots"),
];

impl ValueError {
    /// Returns the dotted path of the key, such as `slam.map.resolution_m` or `fleet.starts[1]`.
    pub fn key(&self) -> String {
        match self {
            Self::Robots(_) => "fleet.robots".into(),
            Self::Seed(_) => "fleet.seed".into(),
            Self::StartsCount { .. } => "fleet.starts".into(),
            Self::Start { index, .. } => format!("fleet.starts[{index}]"),
            Self::NamesCount { .. } | Self::Name(_) => "fleet.names".into(),
            Self::Address(_) => "fleet.address".into(),
            Self::RosWithoutDds => "world".into(),
            Self::Sim(why) => format!("sim.{}", why.field),
            Self::Slam(why) => format!("slam.{}", why.field),
            Self::Sessions(why) => format!("sessions.{}", why.key()),
            Self::Recording(why) => format!("recording.{}", why.key()),
            Self::Link(why) => format!("link.{}", why.key()),
            Self::Merge(why) => format!("merge.{}", why.key),
            Self::Bridge(why) => format!("bridge.{}", why.key),
            Self::LimitsOfNoRobot { index, .. } => format!("bridge.velocity.robots[{index}].robot"),
            Self::NotWritable(_) => "fleet".into(),
            Self::Discovery(_) => "bridge.dds".into(),
            Self::Realtime(why) => format!("realtime.{}", why.key()),
        }
    }

    /// Adds the line on which a file's text sets the key, or the key that it depends on.
    pub(super) fn locate(self, path: &Path, text: &str) -> ConfigError {
        let key = self.key();
        let other = DEPENDENT_KEYS.iter().find(|(dependent, _)| *dependent == key);
        let line = line_of_key(text, &key).or_else(|| line_of_key(text, other?.1));
        match line {
            Some(line) => ConfigError::InFile { path: path.into(), line, why: self },
            None => self.into(),
        }
    }
}

/// Returns the line number, from 1, of a byte of the text.
pub(super) fn line_of(text: &str, byte: usize) -> usize {
    1 + text.as_bytes()[..byte.min(text.len())].iter().filter(|b| **b == b'\n').count()
}

/// Longest value that an error repeats, characters.
const VALUE_SHOWN_MAX: usize = 60;

/// Returns the key that the text sets at a byte, with its value if that is short; empty if it sets none there.
pub(super) fn setting_at(text: &str, byte: usize) -> String {
    let Ok(root) = DeTable::parse(text) else { return String::new() };
    let Some((key, value)) = innermost(root.get_ref(), "", byte) else { return String::new() };
    let written = text.get(value.span()).unwrap_or_default();
    let is_short = written.chars().count() <= VALUE_SHOWN_MAX && !written.contains('\n');
    match value.get_ref() {
        DeValue::Table(_) => format!("`{key}`: "),
        _ if is_short => format!("`{key} = {written}`: "),
        _ => format!("`{key}`: "),
    }
}

/// Returns the innermost key, as a dotted path, that or whose value is written at a byte, and the value. A table that a header or
/// dotted keys make is not written in one place, so all are searched.
fn innermost<'a, 'i>(
    table: &'a DeTable<'i>,
    prefix: &str,
    byte: usize,
) -> Option<(String, &'a Spanned<DeValue<'i>>)> {
    table.iter().find_map(|(key, value)| {
        let path = format!("{prefix}{}", key.get_ref());
        let below = match value.get_ref() {
            DeValue::Table(below) => innermost(below, &format!("{path}."), byte),
            DeValue::Array(list) => list.iter().enumerate().find_map(|(index, element)| {
                let DeValue::Table(below) = element.get_ref() else { return None };
                innermost(below, &format!("{path}[{index}]."), byte)
            }),
            _ => None,
        };
        let is_here = key.span().contains(&byte) || value.span().contains(&byte);
        below.or_else(|| is_here.then_some((path, value)))
    })
}

/// Returns the line, from 1, on which the text sets the key with this dotted path; `None` if it does not set it.
fn line_of_key(text: &str, key: &str) -> Option<usize> {
    let root = DeTable::parse(text).ok()?;
    let mut names = key.split('.');
    let (mut at, mut value) = find(root.get_ref(), names.next()?)?;
    for name in names {
        let DeValue::Table(table) = value.get_ref() else { return None };
        (at, value) = find(table, name)?;
    }
    Some(line_of(text, at))
}

/// Finds a key of a table, or an element of its list as `key[index]`; returns its first byte and its value.
fn find<'a, 'i>(table: &'a DeTable<'i>, name: &str) -> Option<(usize, &'a Spanned<DeValue<'i>>)> {
    let (name, index) = match name.strip_suffix(']').and_then(|rest| rest.split_once('[')) {
        Some((name, index)) => (name, Some(index.parse::<usize>().ok()?)),
        None => (name, None),
    };
    let (key, value) = table.iter().find(|(key, _)| key.get_ref() == name)?;
    let Some(index) = index else { return Some((key.span().start, value)) };
    let DeValue::Array(list) = value.get_ref() else { return None };
    let element = list.get(index)?;
    Some((element.span().start, element))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_found_however_the_file_writes_it() {
        for (text, key, line) in [
            ("# world = 1\nworld = \"ros\"\n", "world", Some(2)),
            ("[fleet]\nrobots_ = 1\nrobots = 2\n", "fleet.robots", Some(3)),
            (
                "[slam.map]\nhit_log_odds = 1\n\n[slam]\nmap_ = 1\n[sim.noise]\nhit = 3",
                "slam.map.hit_log_odds",
                Some(2),
            ),
            ("slam.map.hit_log_odds = 1", "slam.map.hit_log_odds", Some(1)),
            ("\nslam = { map = { hit_log_odds = 1 } }", "slam.map.hit_log_odds", Some(2)),
            ("[slam]\n\"map\".'hit_log_odds' = 1", "slam.map.hit_log_odds", Some(2)),
            ("[fleet]\nstarts = [\n  [0, 0, 0],\n  [1, nan, 0],\n]\n", "fleet.starts[1]", Some(4)),
            ("[[a.b]]\nx = 1\n[[a.b]]\n\nx = 2\n", "a.b[1].x", Some(5)),
            ("[slam]\n", "slam.map.hit_log_odds", None),
            ("slam = 3\n", "slam.map.hit_log_odds", None),
        ] {
            assert_eq!(line_of_key(text, key), line, "{key} in {text}");
        }
    }
}
