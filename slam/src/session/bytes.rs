//! Bytes out and in: plain values one after the other, little-endian, every length checked against
//! what is there before anything is allocated.

use super::SessionError;
use bytemuck::Pod;

const _: () = assert!(cfg!(target_endian = "little"), "session files are little-endian");

/// Writer of plain values as bytes, in the machine's byte order.
#[derive(Default)]
pub struct Out {
    pub bytes: Vec<u8>,
}

impl Out {
    pub fn put<T: Pod>(&mut self, value: &T) {
        self.bytes.extend_from_slice(bytemuck::bytes_of(value));
    }

    /// Whether there is one, then the value or zeros.
    pub fn maybe<T: Pod>(&mut self, value: Option<T>) {
        self.put(&u64::from(value.is_some()));
        self.put(&value.unwrap_or(T::zeroed()));
    }

    /// How many, then the values.
    pub fn list<T: Pod>(&mut self, values: &[T]) {
        self.put(&(values.len() as u64));
        self.bytes.extend_from_slice(bytemuck::cast_slice(values));
    }
}

/// Gives bytes out again.
pub struct In<'a> {
    rest: &'a [u8],
}

impl<'a> In<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    fn bytes(&mut self, count: usize, what: &'static str) -> Result<&'a [u8], SessionError> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(SessionError::Ends { what })?;
        self.rest = rest;
        Ok(taken)
    }

    pub fn take<T: Pod>(&mut self, what: &'static str) -> Result<T, SessionError> {
        let mut value = T::zeroed();
        bytemuck::bytes_of_mut(&mut value).copy_from_slice(self.bytes(size_of::<T>(), what)?);
        Ok(value)
    }

    /// As [`Out::maybe`] wrote it.
    pub fn maybe<T: Pod>(&mut self, what: &'static str) -> Result<Option<T>, SessionError> {
        let known: u64 = self.take(what)?;
        let value = self.take(what)?;
        Ok((known != 0).then_some(value))
    }

    /// `count` values that lie one after the other.
    pub fn values<T: Pod>(&mut self, count: usize, what: &'static str) -> Result<Vec<T>, SessionError> {
        let size = count.checked_mul(size_of::<T>()).ok_or(SessionError::Ends { what })?;
        let bytes = self.bytes(size, what)?;
        let mut values = vec![T::zeroed(); count];
        bytemuck::cast_slice_mut(&mut values).copy_from_slice(bytes);
        Ok(values)
    }

    /// As [`Out::list`] wrote them; not more than `most`.
    pub fn list<T: Pod>(&mut self, most: usize, what: &'static str) -> Result<Vec<T>, SessionError> {
        let count = self.count(most, what)?;
        self.values(count, what)
    }

    pub fn count(&mut self, most: usize, what: &'static str) -> Result<usize, SessionError> {
        let count: u64 = self.take(what)?;
        match usize::try_from(count) {
            Ok(count) if count <= most => Ok(count),
            _ => Err(SessionError::TooMany { what, found: count, most }),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }
}
