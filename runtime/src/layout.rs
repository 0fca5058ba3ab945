//! Which build of the program a fleet runs: messages in shared memory have the layout of the build that wrote them.
//!
//! The launcher writes its own build into the fleet's runtime folder. Each process compares it before it opens a channel.

use crate::ports::ChannelError;
use std::io::{self, Write};
use std::path::Path;

/// Version of this program and the number of its channels' layout, which changes with messages and channels.
pub const OWN: &str = concat!(env!("CARGO_PKG_VERSION"), ", layout ", env!("MR_SLAM_LAYOUT"));
/// Name of the file in a fleet's runtime folder.
const FILE: &str = "build";
/// Largest size of that file, bytes.
const FILE_BYTES_MAX: u64 = 256;

/// Writes this build into a fleet's runtime folder.
///
/// # Errors
/// The file cannot be written.
pub fn write(root: &Path) -> io::Result<()> {
    formats::atomic::write(&root.join(FILE), |file| file.write_all(OWN.as_bytes()))
}

/// Compares this build with that of the fleet in a runtime folder.
///
/// # Errors
/// The fleet runs a build whose messages may differ, or its build cannot be read. A fleet without the file is accepted: it ends, or
/// its program does not write one.
pub fn check(root: &Path) -> Result<(), ChannelError> {
    match formats::limited::read_text(&root.join(FILE), FILE_BYTES_MAX) {
        Ok(running) if running == OWN => Ok(()),
        Ok(running) => {
            let running = running.chars().filter(|letter| !letter.is_control()).collect();
            Err(ChannelError::OtherBuild { running, own: OWN })
        }
        Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(why) => {
            Err(ChannelError::OtherBuild { running: format!("of an unknown build ({why})"), own: OWN })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fleet_of_another_build_is_refused_and_both_builds_are_named() {
        let folder = tempfile::tempdir().unwrap();
        check(folder.path()).unwrap();
        write(folder.path()).unwrap();
        check(folder.path()).unwrap();
        std::fs::write(folder.path().join(FILE), "0.0.9, layout 00\u{1b}[2J").unwrap();
        let said = check(folder.path()).unwrap_err().to_string();
        assert!(said.contains("0.0.9, layout 00[2J") && said.contains(OWN), "{said}");
        std::fs::write(folder.path().join(FILE), [0xff; 4]).unwrap();
        let said = check(folder.path()).unwrap_err().to_string();
        assert!(said.contains("unknown build") && said.contains(OWN), "{said}");
    }
}
