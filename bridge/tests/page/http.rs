//! Files of the page, and requests that are refused.

use crate::Served;
use crate::browser::{Browser, WAIT_MAX};
use bridge::{BridgeConfig, PageConfig};
use std::io::{Read, Write};
use std::net::TcpStream;

/// Sends bytes and reads the response to its end.
fn request(served: &Served, text: &str) -> String {
    let mut stream = TcpStream::connect(served.page).unwrap();
    stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
    stream.write_all(text.as_bytes()).unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    response
}

#[test]
fn the_page_is_served_to_this_machine_alone() {
    let served = Served::start(BridgeConfig::default());
    let page = request(&served, &format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", served.page));
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.ends_with("\r\n\r\n<!doctype html>"), "{page}");
    assert!(page.contains("frame-ancestors 'none'"), "{page}");
    let rebound = request(&served, "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert!(rebound.starts_with("HTTP/1.1 403 "), "{rebound}");
    let missing = request(&served, "GET /x HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(missing.starts_with("HTTP/1.1 404 "), "{missing}");
    let endless = request(&served, &"x".repeat(20_000));
    assert!(endless.is_empty() || endless.starts_with("HTTP/1.1 400 "), "{endless}");
}

#[test]
fn a_connection_that_asks_nothing_is_closed() {
    let served = Served::start(BridgeConfig::default());
    assert_eq!(request(&served, "GET / HTTP/1.1\r\n"), "", "half a request");
}

#[test]
fn a_foreign_page_cannot_open_a_web_socket() {
    let origins = vec!["https://app.foxglove.dev".to_owned()];
    let page = PageConfig { origins, ..PageConfig::default() };
    let served = Served::start(BridgeConfig { page, ..BridgeConfig::default() });
    let connect = |headers: &[(&'static str, &str)]| Browser::try_connect(served.page, headers).map(drop);
    assert_eq!(connect(&[("Origin", "https://evil.example")]), Err(403));
    assert_eq!(connect(&[("Origin", "http://localhost:3000")]), Err(403));
    assert_eq!(connect(&[("Host", "evil.example"), ("Origin", "http://evil.example")]), Err(403));
    assert_eq!(connect(&[("Origin", "https://app.foxglove.dev")]), Ok(()));
    assert_eq!(connect(&[]), Ok(()), "no browser");
    assert_eq!(connect(&[("Sec-WebSocket-Protocol", "foxglove.websocket.v1")]), Err(400));
}

#[test]
fn a_browser_too_many_is_refused() {
    let served = Served::start(BridgeConfig { clients_max: 1, ..BridgeConfig::default() });
    let first = Browser::connect(served.page);
    assert_eq!(Browser::try_connect(served.page, &[]).map(drop), Err(503));
    drop(first);
    let begun = std::time::Instant::now();
    while Browser::try_connect(served.page, &[]).is_err() {
        assert!(begun.elapsed() < WAIT_MAX, "the place of a browser that left is not free");
    }
}
