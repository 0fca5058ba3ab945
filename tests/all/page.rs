//! The operator's page of a whole fleet: it is served where the launcher says, also by a bridge that replaces a dead one.

use crate::harness::{Fleet, WATCHDOG, output, process, send};
use rustix::process::Signal;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Instant;

/// Fetches a file of the page; `None` while nobody listens.
fn fetch(port: u16, path: &str) -> Option<String> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(WATCHDOG)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n").ok()?;
    let mut response = String::new();
    stream.read_to_string(&mut response).ok()?;
    Some(response).filter(|response| !response.is_empty())
}

/// Fetches a file as soon as somebody listens.
fn fetch_when_served(port: u16, path: &str) -> String {
    let begun = Instant::now();
    loop {
        if let Some(response) = fetch(port, path) {
            return response;
        }
        assert!(begun.elapsed() < WATCHDOG, "nobody serves port {port}");
        std::thread::yield_now();
    }
}

#[test]
fn a_fleet_serves_the_operators_page_also_after_its_bridge_was_killed() {
    let mut fleet = Fleet::start("up", &["--robots", "1", "--page", "0"]);
    let port = fleet.run.config.bridge.page.port;
    assert_ne!(port, 0, "the run's configuration has the port that was chosen");
    let page = fetch_when_served(port, "/");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("<title>MR-SLAM</title>"), "{page}");
    assert!(fetch_when_served(port, "/main.js").starts_with("HTTP/1.1 200 OK\r\n"));
    let before = fleet.until("the bridge", |view| process(view, "bridge").is_some());
    let killed = process(&before, "bridge").unwrap().pid;
    send(killed, Signal::KILL);
    fleet.until("another bridge", |view| {
        process(view, "bridge").is_some_and(|process| process.pid != killed && process.state == "up")
    });
    assert!(fetch_when_served(port, "/").contains("<title>MR-SLAM</title>"));
}

#[test]
fn a_page_that_is_off_is_not_served() {
    let fleet = Fleet::start("up", &["--robots", "1", "--page", "off"]);
    assert!(!fleet.run.config.bridge.page.enabled);
    let wrong = output(&["up", "--page", "on"]);
    assert!(!wrong.status.success());
    let text = String::from_utf8_lossy(&wrong.stderr);
    assert!(text.contains("expected a port, 0 to 65535, or `off`"), "{text}");
}
