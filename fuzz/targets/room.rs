//! Rooms: a byte that selects the ending of the file's name, and the file: scene JSON (also MRUK's), glTF, OBJ, each maybe gzipped.
#![no_main]

use libfuzzer_sys::fuzz_target;
use sim::Room;

/// Names whose endings select a reader; the content tells the rest.
const NAMES: [&str; 4] = ["room.obj", "room.json", "room.glb", "room.gltf.gz"];

fuzz_target!(|bytes: &[u8]| {
    let Some((first, file)) = bytes.split_first() else { return };
    let name = NAMES[usize::from(*first) % NAMES.len()];
    match Room::from_bytes(name, file) {
        Ok(room) => assert_eq!(room.name(), name),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
