use super::*;
use crate::frame::Side;
use proptest::prelude::*;
use tungstenite::protocol::{Role, WebSocket};
use tungstenite::{Error, Message};

/// Reads all messages of a server's byte stream with a WebSocket library.
fn messages(stream: &[u8]) -> Vec<Message> {
    let mut client = WebSocket::from_raw_socket(std::io::Cursor::new(stream.to_vec()), Role::Client, None);
    let mut all = Vec::new();
    loop {
        match client.read() {
            Ok(message) => all.push(message),
            Err(Error::Protocol(_) | Error::Io(_) | Error::ConnectionClosed) => return all,
            Err(error) => panic!("{error}"),
        }
    }
}

fn encoder() -> Encoder {
    let mut encoder = Encoder::new(Vec::new());
    encoder.subscribe("/robot1/scan", "sensor_msgs/LaserScan", 7);
    encoder.subscribe("/merged_map", "nav_msgs/OccupancyGrid", 9);
    encoder
}

/// Passes a stream through an encoder in pieces, to a socket that takes so many bytes at a time and blocks in between.
fn encode(encoder: &mut Encoder, stream: &[u8], piece: usize, socket: usize) -> Vec<u8> {
    let (mut out, mut begin, mut turn) = (Vec::new(), 0, 0_usize);
    while begin < stream.len() || encoder.has_waiting() {
        let slices = [IoSlice::new(&stream[begin..stream.len().min(begin.saturating_add(piece))])];
        let mut write = |slices: &[IoSlice<'_>]| {
            turn += 1;
            if turn.is_multiple_of(2) {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            let all: Vec<u8> = slices.iter().flat_map(|slice| slice.iter().copied()).collect();
            let count = all.len().min(socket);
            out.extend_from_slice(&all[..count]);
            Ok(count)
        };
        match encoder.write(&slices, &mut write) {
            Ok(taken) => begin += taken,
            Err(error) => assert_eq!(error.kind(), io::ErrorKind::WouldBlock),
        }
    }
    out
}

fn payload(bytes: usize, seconds: u32) -> Vec<u8> {
    let mut payload = vec![0, 1, 0, 0];
    payload.extend_from_slice(&seconds.to_le_bytes());
    payload.extend_from_slice(&5_u32.to_le_bytes());
    payload.resize(bytes.max(12), 42);
    payload
}

#[test]
fn a_message_has_its_subscription_its_stamp_and_the_same_bytes() {
    let mut stream = Vec::new();
    let scan = payload(100, 3);
    Side::Server.write(&mut stream, "__handshake", b"{}");
    Side::Server.write(&mut stream, "/robot1/scan", &scan);
    Side::Server.write(&mut stream, "/not/subscribed", &scan);
    Side::Server.write_command(&mut stream, name::ERROR, &Notice { text: "no".into() });
    let out = encode(&mut encoder(), &stream, usize::MAX, usize::MAX);
    let read = messages(&out);
    let [Message::Binary(data), Message::Text(text)] = &read[..] else { panic!("{read:?}") };
    assert_eq!(data[0], MESSAGE_DATA);
    assert_eq!(data[1..5], 7_u32.to_le_bytes());
    assert_eq!(data[5..13], 3_000_000_005_u64.to_le_bytes());
    assert_eq!(data[13..], scan);
    assert_eq!(text.as_str(), r#"{"op":"status","level":2,"message":"no"}"#);
}

#[test]
fn a_response_has_its_call_and_a_failure_is_said_as_one() {
    let mut stream = Vec::new();
    let id = CallId { service: 3, call: u32::MAX };
    Side::Server.write_command(&mut stream, name::RESPONSE, &Call { srv_id: id.number() });
    // A response is one whatever its service's name is.
    Side::Server.write(&mut stream, "/robot1/scan", &[0, 1, 0, 0, 1]);
    let failure = CallFailure { srv_id: id.number(), text: "no".into() };
    Side::Server.write_command(&mut stream, name::CALL_FAILURE, &failure);
    Side::Server.write(&mut stream, "/robot1/scan", &payload(100, 3));
    for (piece, socket) in [(usize::MAX, usize::MAX), (7, 5)] {
        let read = messages(&encode(&mut encoder(), &stream, piece, socket));
        let [Message::Binary(response), Message::Text(failure), Message::Binary(scan)] = &read[..] else {
            panic!("{read:?}")
        };
        let expected =
            [&[3, 3, 0, 0, 0, 255, 255, 255, 255, 3, 0, 0, 0][..], b"cdr", &[0, 1, 0, 0, 1]].concat();
        assert_eq!(response[..], expected);
        let text = r#"{"op":"serviceCallFailure","serviceId":3,"callId":4294967295,"message":"no"}"#;
        assert_eq!(failure.as_str(), text);
        assert_eq!(scan[0], MESSAGE_DATA);
    }
}

#[test]
fn text_does_not_come_into_the_middle_of_a_message() {
    let mut stream = Vec::new();
    let map = payload(200_000, 1);
    Side::Server.write(&mut stream, "/merged_map", &map);
    let mut encoder = encoder();
    let half = stream.len() / 2;
    let mut out = encode(&mut encoder, &stream[..half], usize::MAX, 50_000);
    encoder.send(&ServerCommand::Status { level: StatusLevel::Info, message: "later" }).unwrap();
    out.extend(encode(&mut encoder, &stream[half..], usize::MAX, 50_000));
    let read = messages(&out);
    let [Message::Binary(data), Message::Text(_)] = &read[..] else { panic!("{} messages", read.len()) };
    assert_eq!(data[13..], map);
}

#[test]
fn a_client_that_reads_nothing_is_given_up() {
    let mut encoder = Encoder::new(Vec::new());
    encoder.subscribe("/merged_map", "nav_msgs/OccupancyGrid", 9);
    let mut stream = Vec::new();
    Side::Server.write(&mut stream, "/merged_map", &payload(100_000, 1));
    encode(&mut encoder, &stream[..50_000], usize::MAX, usize::MAX);
    let text = "x".repeat(1 << 20);
    let send = |encoder: &mut Encoder| {
        encoder.send(&ServerCommand::Status { level: StatusLevel::Info, message: &text })
    };
    assert!((0..3).all(|_| send(&mut encoder).is_ok()));
    assert!(send(&mut encoder).is_err());
}

proptest! {
    #[test]
    fn payloads_arrive_unchanged_however_the_stream_is_cut(
        sizes in proptest::collection::vec((0..3_usize, 12..20_000_usize), 1..12),
        piece in 1..30_000_usize,
        socket in 1..30_000_usize,
    ) {
        let names = ["/robot1/scan", "/merged_map", "/other"];
        let (mut stream, mut expected) = (Vec::new(), Vec::new());
        for (topic, bytes) in sizes {
            let payload = payload(bytes, bytes as u32);
            Side::Server.write(&mut stream, names[topic], &payload);
            if topic < 2 {
                expected.push(payload);
            }
        }
        let out = encode(&mut encoder(), &stream, piece, socket);
        let read: Vec<Vec<u8>> = messages(&out)
            .into_iter()
            .map(|message| message.into_data()[13..].to_vec())
            .collect();
        prop_assert_eq!(read, expected);
    }
}
