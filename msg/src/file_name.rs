//! Names of files that a client gives: the one rule for those that come over the network and those that SLAM gets.

use thiserror::Error;

/// Why a text is no name for a file.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FileNameError {
    /// The text is empty, ends with a slash, or has control characters.
    #[error("'{}' names no file; expected a name like `monday` or `maps/monday`", .0.escape_debug())]
    NoFile(String),
    /// The name is absolute, or has parts that are empty, `.` or `..`.
    #[error("'{0}' leads out of the folder for saved files; expected a name like `monday` or `maps/monday`")]
    Outside(String),
}

/// Checks that a name, joined to any folder, is a file below that folder.
///
/// # Errors
/// The name is empty or has control characters; or it is absolute, or has a part that is empty, `.` or `..`.
pub fn check_relative_file_name(name: &str) -> Result<(), FileNameError> {
    check_file_name(name)?;
    let is_below = name.split('/').all(|part| !matches!(part, "" | "." | ".."));
    is_below.then_some(()).ok_or_else(|| FileNameError::Outside(name.to_owned()))
}

/// Checks that a name, which may be absolute, names a file and no folder.
///
/// # Errors
/// The name is empty, ends as a folder's does, or has control characters.
pub fn check_file_name(name: &str) -> Result<(), FileNameError> {
    let last = name.rsplit('/').next().unwrap_or_default();
    let is_file = !matches!(last, "" | "." | "..") && !name.contains(char::is_control);
    is_file.then_some(()).ok_or_else(|| FileNameError::NoFile(name.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::path::{Component, Path};

    #[test]
    fn names_that_lead_out_or_name_no_file_are_refused() {
        for name in ["monday", "maps/monday", "map.v2", "..monday", "accepted-room.json"] {
            assert_eq!(check_relative_file_name(name), Ok(()), "{name}");
        }
        for name in ["", "a/", "..", "a/..", ".", "a\n", "a\0b"] {
            let error = check_relative_file_name(name).unwrap_err();
            assert!(matches!(error, FileNameError::NoFile(_)), "{name:?}");
            assert!(check_file_name(name).is_err(), "{name:?}");
        }
        for name in ["/etc/passwd", "../up", "a/../../b", "./a", "a//b", "a/./b"] {
            let error = check_relative_file_name(name).unwrap_err();
            assert!(matches!(error, FileNameError::Outside(_)), "{name:?}");
        }
        assert_eq!(check_file_name("/home/ana/monday.slam"), Ok(()));
    }

    proptest! {
        #[test]
        fn no_accepted_name_leaves_its_folder(name in "[a./\\\\-]{0,12}") {
            if check_relative_file_name(&name).is_ok() {
                let parts = Path::new(&name).components();
                prop_assert!(parts.clone().all(|part| matches!(part, Component::Normal(_))));
                prop_assert!(parts.count() > 0);
            }
        }
    }
}
