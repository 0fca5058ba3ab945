//! Paths in JSON, which is UTF-8: what is not becomes the replacement character, and the rest of the document is written all the same.

use serde::{Serialize, Serializer};
use std::path::{Path, PathBuf};

/// Serializes a path; for `serialize_with`.
///
/// # Errors
/// Whatever the serializer says.
pub fn serialize<S: Serializer>(path: impl AsRef<Path>, to: S) -> Result<S::Ok, S::Error> {
    path.as_ref().to_string_lossy().serialize(to)
}

/// Serializes a path that may be missing; for `serialize_with`.
///
/// # Errors
/// Whatever the serializer says.
pub fn serialize_optional<S: Serializer>(path: &Option<PathBuf>, to: S) -> Result<S::Ok, S::Error> {
    path.as_ref().map(|path| path.to_string_lossy()).serialize(to)
}

/// Serializes a list of paths; for `serialize_with`.
///
/// # Errors
/// Whatever the serializer says.
pub fn serialize_all<S: Serializer>(paths: &[PathBuf], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(paths.iter().map(|path| path.to_string_lossy()))
}
