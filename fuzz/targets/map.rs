//! Maps: a YAML description, a zero byte, and an image (PGM or PNG).
#![no_main]

use libfuzzer_sys::fuzz_target;
use formats::map_file::decode_map;
use msg::GridView;

fuzz_target!(|bytes: &[u8]| {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    let Ok(yaml) = core::str::from_utf8(&bytes[..end]) else { return };
    let image = bytes.get(end + 1..).unwrap_or(&[]);
    match decode_map("fuzz.yaml".as_ref(), yaml, image) {
        Ok(grid) => assert!(GridView::new(&grid.header, &grid.cells).is_some()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
