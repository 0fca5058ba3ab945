//! Texts of bounded length in messages: a number of bytes, and storage for the most.

/// Stores as much of a text as fits, cut at the end of a character. Returns the number of bytes in use.
pub(crate) fn write(text: &str, storage: &mut [u8]) -> u32 {
    let mut len = text.len().min(storage.len());
    while !text.is_char_boundary(len) {
        len -= 1;
    }
    storage[..len].copy_from_slice(&text.as_bytes()[..len]);
    len as u32
}

/// Returns the text of the first `len` bytes, or of all if `len` is larger; empty if it is not UTF-8.
pub(crate) fn read(storage: &[u8], len: u32) -> &str {
    let len = (len as usize).min(storage.len());
    core::str::from_utf8(&storage[..len]).unwrap_or_default()
}
