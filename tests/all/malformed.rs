//! Malformed logs and frames are refused with the reason, and nothing else is lost.

use crate::harness::{Fleet, Folder, WATCHDOG, output};
use bridge::command::{Notice, name};
use bridge::frame::{KEEPALIVE, Parser, Side};
use flate2::{Compression, write::GzEncoder};
use std::io::{Read, Write};
use std::net::TcpStream;

const LASER: &str =
    "ROBOTLASER1 0 0.0 3.14159 1.570796 10.0 0.01 0 3 1.0 1.0 1.0 0 0 0 0 0 0 0 0 0 0 0 0 5.0 host 5.0\n";

fn replay(log: &[u8]) -> (bool, String) {
    let folder = Folder::new();
    let file = folder.file("robot.log", log);
    let said = output(&["replay", file.to_str().unwrap(), "--json"]);
    let all = [said.stdout, said.stderr].concat();
    (said.status.success(), String::from_utf8_lossy(&all).into_owned())
}

#[test]
fn a_valid_log_is_mapped_plain_and_gzipped() {
    let log = LASER.replace("5.0 host 5.0", "6.0 host 6.0");
    let log = format!("# a comment\n{LASER}{log}");
    let mut zipped = GzEncoder::new(Vec::new(), Compression::fast());
    zipped.write_all(log.as_bytes()).unwrap();
    for bytes in [log.into_bytes(), zipped.finish().unwrap()] {
        let (success, said) = replay(&bytes);
        assert!(success, "{said}");
        assert!(said.contains("\"scans\""), "{said}");
    }
}

#[test]
fn malformed_lines_are_reported_with_their_number() {
    let cut = &LASER[..LASER.len() / 2];
    let (_, said) = replay(format!("{LASER}{cut}\n").as_bytes());
    assert!(said.contains("line 2") || said.contains(":2"), "{said}");
    let (success, said) = replay(b"this is no log\n");
    assert!(!success, "{said}");
    let (success, said) = replay(&[0x1f, 0x8b, 8, 0, 1, 2, 3]);
    assert!(!success, "an incomplete gzip: {said}");
}

/// Connects, sends `bytes`, and reads until the bridge sends `__error` or closes the connection. A bridge
/// that is silent for [`WATCHDOG`] ends the read with an error.
fn error_for(port: u16, bytes: &[u8]) -> Option<String> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(WATCHDOG)).unwrap();
    let begun = std::time::Instant::now();
    stream.write_all(&KEEPALIVE).unwrap();
    stream.write_all(bytes).unwrap();
    let mut parser = Parser::new(1 << 20);
    loop {
        assert!(begun.elapsed() < WATCHDOG, "the bridge neither answers nor closes the connection");
        while let Some(frame) = parser.next_frame().unwrap() {
            if frame.name == name::ERROR.as_bytes() {
                return Some(serde_json::from_slice::<Notice>(frame.json()).unwrap().text);
            }
        }
        match stream.read(parser.space()) {
            Ok(0) | Err(_) => return None,
            Ok(count) => parser.filled(count),
        }
    }
}

#[test]
fn invalid_frames_are_answered_with_an_error_and_the_fleet_continues() {
    let mut fleet = Fleet::start("up", &["--robots", "1"]);
    fleet.until("scans", |view| view.robots.first().is_some_and(|robot| robot.scans > 5));
    let port = fleet.run.port;
    let mut unknown_topic = Vec::new();
    Side::Client.write(&mut unknown_topic, "/nobody/knows", b"\0\x01\0\0");
    assert!(error_for(port, &unknown_topic).unwrap().contains("/nobody/knows"));
    let mut unknown_command = Vec::new();
    Side::Client.write(&mut unknown_command, "__make_coffee", b"{}\0");
    assert!(error_for(port, &unknown_command).unwrap().contains("__make_coffee"));
    let mut bad_json = Vec::new();
    Side::Client.write(&mut bad_json, name::SUBSCRIBE, b"{\"topic\": \0");
    assert!(error_for(port, &bad_json).unwrap().contains(name::SUBSCRIBE));
    let oversize =
        [4_u32.to_le_bytes().to_vec(), b"/a\0\0".to_vec(), u32::MAX.to_le_bytes().to_vec()].concat();
    let _ = error_for(port, &oversize);
    let _ = error_for(port, b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n");
    let view = fleet.until("scans after the garbage", |view| view.robots[0].scans > 30);
    assert_eq!(view.robots[0].scans_lost, Some(0));
    assert!(view.processes.iter().all(|process| process.restarts == 0));
}
