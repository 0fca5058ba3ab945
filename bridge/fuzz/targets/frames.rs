//! Fuzzes the parser of ros_tcp frames. Any stream gives the same frames and the same error however it is cut, memory
//! stays within the bytes that have arrived and the limit, and written frames are parsed unchanged.
#![no_main]

use bridge::frame::{FrameError, NAME_MAX, Parser, Side};
use libfuzzer_sys::fuzz_target;

/// Small, so that the limit is met.
const PAYLOAD_MAX: usize = 512;
/// What a parser holds at rest.
const REST_BYTES: usize = 64 * 1024;

type Owned = (Vec<u8>, Vec<u8>);

/// The frames of a stream that comes in pieces of `step` bytes, and how it ends.
fn parse(stream: &[u8], step: usize) -> (Vec<Owned>, Option<FrameError>) {
    let mut parser = Parser::new(PAYLOAD_MAX);
    let mut frames = Vec::new();
    let mut rest = stream;
    while !rest.is_empty() {
        let space = parser.space();
        let take = step.min(rest.len()).min(space.len());
        assert!(take > 0, "there is always room");
        space[..take].copy_from_slice(&rest[..take]);
        parser.filled(take);
        rest = &rest[take..];
        loop {
            match parser.next_frame() {
                Ok(Some(frame)) => {
                    assert!(frame.name.len() <= NAME_MAX && frame.payload.len() <= PAYLOAD_MAX);
                    assert!(frame.json().len() <= frame.payload.len());
                    frames.push((frame.name.to_vec(), frame.payload.to_vec()));
                }
                Ok(None) => break,
                Err(error) => {
                    assert!(!error.to_string().is_empty());
                    return (frames, Some(error));
                }
            }
        }
        assert!(parser.capacity() <= REST_BYTES + 8 + NAME_MAX + PAYLOAD_MAX);
    }
    (frames, None)
}

fuzz_target!(|bytes: &[u8]| {
    let Some((step, stream)) = bytes.split_first() else { return };
    let whole = parse(stream, usize::MAX);
    assert_eq!(whole, parse(stream, usize::from(*step).max(1)));
    let mut again = Vec::new();
    let names = whole.0.iter().map(|(name, _)| core::str::from_utf8(name)).collect::<Result<Vec<_>, _>>();
    let Ok(names) = names else { return };
    names.iter().zip(&whole.0).for_each(|(name, (_, payload))| Side::Server.write(&mut again, name, payload));
    assert_eq!(parse(&again, usize::MAX), (whole.0, None));
});
