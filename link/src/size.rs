//! Sizes that every part of a message must know.

/// Largest message, bytes: a message of a higher priority never waits for more.
pub const MESSAGE_MAX: usize = 4096;
/// Number of bytes before the body.
pub const HEAD_BYTES: usize = 30;
