//! Which options have no effect on which kind of replay: they are refused, not ignored.

use super::{ReplayArgs, ReplayError};
use crate::config::Mode;

/// An option's name, and whether it is given.
type NamedOption = (&'static str, fn(&ReplayArgs) -> bool);

/// Options without effect on a fleet's recording: its robots, parameters and scans are those of the recording.
pub const OF_FLEET: &[NamedOption] = &[
    ("--config", |args| args.config.is_some()),
    ("--trajectory", |args| args.trajectory.is_some()),
    ("--fov-deg", |args| args.fov_deg.is_some()),
    ("--no-odometry", |args| args.no_odometry),
    ("--no-closures", |args| args.no_closures),
    ("--scanner", |args| args.bag.scanner.is_some()),
    ("--session", |args| args.session.is_some()),
    ("--save-session", |args| args.save_session.is_some()),
    ("--mode", |args| args.mode != Mode::default()),
    ("--skip", |args| args.skip > 0),
    ("--scans", |args| args.scans.is_some()),
];

/// Options without effect on CARMEN logs: they name parts of recordings.
pub const OF_CARMEN: &[NamedOption] = &[
    ("--scanner", |args| args.bag.scanner.is_some()),
    ("--scan-topic", |args| args.bag.scan_topic.is_some()),
    ("--odom-topic", |args| args.bag.odom_topic.is_some()),
    ("--odom-frame", |args| args.bag.odom_frame.is_some()),
    ("--truth-topic", |args| args.bag.truth_topic.is_some()),
];

/// Options without effect on several logs that are merged.
pub const OF_MERGED_LOGS: &[NamedOption] = &[
    ("--session", |args| args.session.is_some()),
    ("--save-session", |args| args.save_session.is_some()),
    ("--mode", |args| args.mode != Mode::default()),
    ("--skip", |args| args.skip > 0),
    ("--scans", |args| args.scans.is_some()),
];

/// Refuses options that are given and have no effect.
pub fn refuse(options: &[NamedOption], args: &ReplayArgs, replay: &'static str) -> Result<(), ReplayError> {
    let given: Vec<&str> =
        options.iter().filter(|(_, is_given)| is_given(args)).map(|(name, _)| *name).collect();
    if given.is_empty() {
        return Ok(());
    }
    Err(ReplayError::WithoutEffect { options: given.join(", "), replay })
}
