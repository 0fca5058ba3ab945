//! Serde representations of fields whose types have none, or whose bytes are copied as a whole for speed.
//!
//! Each module here is for `#[serde(with = ...)]`.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

const _: () = assert!(cfg!(target_endian = "little"), "session files are little-endian");

/// List of plain values as one byte string: count of bytes, then the values as they lie in memory.
pub mod plain {
    use super::*;
    use bytemuck::Pod;
    use serde::de::Error;

    /// Serializes the values.
    pub fn serialize<T: Pod, S: Serializer>(values: &[T], to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bytes(bytemuck::cast_slice(values))
    }

    /// Deserializes the values. Allocates no more than the bytes that are there.
    pub fn deserialize<'de, T: Pod, L: From<Vec<T>>, D: Deserializer<'de>>(from: D) -> Result<L, D::Error> {
        let bytes = <&[u8]>::deserialize(from)?;
        if !bytes.len().is_multiple_of(size_of::<T>()) {
            return Err(D::Error::invalid_length(bytes.len(), &"a multiple of a value's size"));
        }
        Ok(bytemuck::pod_collect_to_vec(bytes).into())
    }
}

/// A 3 x 3 matrix as its nine elements, column by column.
pub mod matrix {
    use super::*;
    use nalgebra::Matrix3;

    /// Serializes the matrix.
    pub fn serialize<S: Serializer>(matrix: &Matrix3<f64>, to: S) -> Result<S::Ok, S::Error> {
        matrix.data.0.serialize(to)
    }

    /// Deserializes the matrix.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Matrix3<f64>, D::Error> {
        <[[f64; 3]; 3]>::deserialize(from).map(Matrix3::from)
    }
}

/// A shared value as the value itself.
pub mod shared {
    use super::*;
    use std::sync::Arc;

    /// Serializes the value.
    pub fn serialize<T: Serialize, S: Serializer>(value: &Arc<T>, to: S) -> Result<S::Ok, S::Error> {
        value.as_ref().serialize(to)
    }

    /// Deserializes the value.
    pub fn deserialize<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<Arc<T>, D::Error> {
        T::deserialize(from).map(Arc::new)
    }
}
