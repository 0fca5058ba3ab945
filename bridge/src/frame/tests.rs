//! The parser with every cut of a stream, and with random bytes.

use super::*;
use proptest::prelude::*;

type Owned = (Vec<u8>, Vec<u8>);

/// Feeds `bytes` in pieces of the given sizes (then whole) and collects the frames.
fn parse(parser: &mut Parser, bytes: &[u8], cuts: &[usize]) -> Result<Vec<Owned>, FrameError> {
    let mut frames = Vec::new();
    let mut rest = bytes;
    let mut cuts = cuts.iter().copied();
    while !rest.is_empty() {
        let space = parser.space();
        let take = cuts.next().unwrap_or(usize::MAX).clamp(1, rest.len()).min(space.len());
        space[..take].copy_from_slice(&rest[..take]);
        parser.filled(take);
        rest = &rest[take..];
        while let Some(frame) = parser.next_frame()? {
            frames.push((frame.name.to_vec(), frame.payload.to_vec()));
        }
    }
    Ok(frames)
}

fn frames() -> impl Strategy<Value = Vec<(String, Vec<u8>)>> {
    prop::collection::vec(("[a-z_/0-9]{0,20}", prop::collection::vec(any::<u8>(), 0..300)), 0..12)
}

proptest! {
    #[test]
    fn any_cut_gives_the_same_frames(sent in frames(), cuts in prop::collection::vec(1_usize..40, 0..300),
                                     client in any::<bool>()) {
        let side = if client { Side::Client } else { Side::Server };
        let mut bytes = Vec::new();
        sent.iter().for_each(|(name, payload)| side.write(&mut bytes, name, payload));
        let got = parse(&mut Parser::new(300), &bytes, &cuts).unwrap();
        let want: Vec<Owned> = sent.iter().map(|(n, p)| (n.clone().into_bytes(), p.clone())).collect();
        prop_assert_eq!(got, want);
    }

    #[test]
    fn random_bytes_never_cost_more_memory_than_the_limit(bytes in prop::collection::vec(any::<u8>(), 0..2000),
                                             cuts in prop::collection::vec(1_usize..100, 0..50)) {
        let mut parser = Parser::new(4096);
        let _ = parse(&mut parser, &bytes, &cuts);
        prop_assert!(parser.capacity() <= IDLE_BYTES + 8 + NAME_MAX + 4096);
    }

    #[test]
    fn random_short_lengths_are_frames_or_an_error(words in prop::collection::vec(0_u32..40, 0..200)) {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let whole = parse(&mut Parser::new(64), &bytes, &[]);
        let single = parse(&mut Parser::new(64), &bytes, &vec![1; bytes.len()]);
        prop_assert_eq!(whole, single);
    }
}

#[test]
fn two_frames_are_parsed_at_every_split() {
    let mut bytes = KEEPALIVE.to_vec();
    Side::Client.write(&mut bytes, "/cmd_vel", &[7; 52]);
    Side::Client.write_command(&mut bytes, "__subscribe", &serde_json::json!({"topic": "/tf"}));
    let want = parse(&mut Parser::new(100), &bytes, &[]).unwrap();
    assert_eq!(want.len(), 3);
    assert_eq!(want[2].1, b"{\"topic\":\"/tf\"}\0");
    for split in 1..bytes.len() {
        assert_eq!(parse(&mut Parser::new(100), &bytes, &[split]).unwrap(), want, "split at {split}");
    }
}

#[test]
fn a_length_over_the_limit_is_refused_before_allocating() {
    let announce = |name: &[u8], payload: u32| {
        let mut bytes = (name.len() as u32).to_le_bytes().to_vec();
        bytes.extend_from_slice(name);
        bytes.extend_from_slice(&payload.to_le_bytes());
        bytes
    };
    let mut parser = Parser::new(64 << 20);
    let long_name = parse(&mut parser, b"GET / HTTP/1.1\r\n", &[]);
    assert_eq!(long_name, Err(FrameError::Name { announced: u32::from_le_bytes(*b"GET ") }));

    let mut parser = Parser::new(64 << 20);
    let error = parse(&mut parser, &announce(b"/x\0", u32::MAX), &[]).unwrap_err();
    assert!(error.to_string().contains("'/x' announces 4294967295 bytes"), "{error}");

    let mut parser = Parser::new(64 << 20);
    assert_eq!(parse(&mut parser, &announce(b"/x\0", 64 << 20), &[]), Ok(vec![]));
    parser.space();
    assert!(parser.capacity() <= 2 * IDLE_BYTES, "announced, not sent: {}", parser.capacity());
}

#[test]
fn a_large_frame_is_parsed_and_its_memory_released() {
    let payload: Vec<u8> = (0..16_000_000_u32).map(|i| (i % 251) as u8).collect();
    let mut bytes = Vec::new();
    Side::Server.write(&mut bytes, "/robot1/map", &payload);
    let mut parser = Parser::new(payload.len());
    let frames = parse(&mut parser, &bytes, &[]).unwrap();
    assert_eq!(frames[0].1, payload);
    parser.release();
    assert_eq!(parser.capacity(), IDLE_BYTES);
}

#[test]
fn a_skipped_frame_is_not_held_and_the_next_one_is_parsed() {
    let mut bytes = Vec::new();
    Side::Client.write(&mut bytes, "/large", &vec![7; 1_000_000]);
    let first = bytes.len();
    Side::Client.write(&mut bytes, "/next", b"whole");
    for step in [1000, 64 << 10] {
        let (mut parser, mut names) = (Parser::new(1 << 20), Vec::new());
        for part in bytes.chunks(step) {
            parser.push(part);
            if let Some(incomplete) = parser.incomplete().filter(|frame| frame.name == b"/large") {
                assert_eq!((incomplete.payload_bytes, incomplete.arrived_bytes), (1_000_000, step));
                parser.skip_frame();
            }
            while let Some(frame) = parser.next_frame().unwrap() {
                names.push(frame.name.to_vec());
            }
            assert!(parser.next_size() <= IDLE_BYTES && parser.capacity() == IDLE_BYTES);
        }
        assert_eq!(names, [b"/next".to_vec()], "after {first} bytes in steps of {step}");
    }
}

#[test]
fn the_server_writes_no_nul() {
    let mut bytes = Vec::new();
    Side::Server.write_command(&mut bytes, "__error", &serde_json::json!({"text": "no"}));
    assert_eq!(bytes, b"\x07\0\0\0__error\x0d\0\0\0{\"text\":\"no\"}");
}
