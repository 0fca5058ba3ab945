//! Why bytes are not a message of the link.

use crate::table::Kind;

/// Version of the format. Machines with different versions do not talk.
pub const VERSION: u8 = 6;

/// Reason why bytes are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The message is too short or too long.
    #[error("a message of {0} bytes is too short or too long for its kind")]
    Length(usize),
    /// The sender is of another version.
    #[error(
        "the peer speaks version {0} of the link's format, this program version {VERSION}; update the older one"
    )]
    Version(u8),
    /// The kind is unknown.
    #[error("message kind {0} is unknown")]
    Kind(u8),
    /// A number is out of its range.
    #[error("a number in a message of kind `{}` is out of its range", .0.row().name)]
    Range(Kind),
}
