//! A room that a browser offers: saved, shown to the operator, and bounded.

use crate::browser::WAIT_MAX;
use crate::{SAVED_ROOM, Served};
use bridge::{BridgeConfig, RoomOffer};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream};

fn connect(served: &Served) -> TcpStream {
    let stream = TcpStream::connect(served.page).unwrap();
    stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
    stream
}

fn head(served: &Served, origin: &str, length: usize) -> String {
    format!(
        "POST /room HTTP/1.1\r\nHost: {}\r\nOrigin: {origin}\r\nContent-Type: application/json\r\n\
         Content-Length: {length}\r\n\r\n",
        served.page
    )
}

fn own_origin(served: &Served) -> String {
    format!("http://{}", served.page)
}

fn response(mut stream: TcpStream) -> String {
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    response
}

#[test]
fn an_offered_room_is_saved_and_waits_for_the_operator() {
    let served = Served::start(BridgeConfig::default());
    let room = vec![b'x'; 300_000];
    let mut stream = connect(&served);
    stream.write_all(head(&served, &own_origin(&served), room.len()).as_bytes()).unwrap();
    stream.write_all(&room).unwrap();
    assert!(response(stream).starts_with("HTTP/1.1 202 "));
    assert_eq!(served.with(|_| SAVED_ROOM.take()), Some(room));
    let expected = RoomOffer { address: Ipv4Addr::LOCALHOST.into(), bytes: 300_000 };
    assert_eq!(served.with(|bridge| bridge.room_offer()), Some(expected));
    assert!(served.with(|bridge| bridge.take_events())[0].contains("127.0.0.1 offers its room (0.3 MB)"));
    served.with(|bridge| bridge.answer_room());
    assert_eq!(served.with(|bridge| bridge.room_offer()), None);
}

#[test]
fn a_room_of_a_foreign_page_or_without_an_end_is_refused() {
    let served = Served::start(BridgeConfig::default());
    let ask = |origin: &str, length: usize| {
        let mut stream = connect(&served);
        stream.write_all(head(&served, origin, length).as_bytes()).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        response(stream)
    };
    assert!(ask("https://evil.example", 10).starts_with("HTTP/1.1 403 "));
    let own = own_origin(&served);
    let large = ask(&own, 1 << 30);
    assert!(large.starts_with("HTTP/1.1 413 ") && large.contains("16777216 bytes"), "{large}");
    // One that ends early, and a second one while the first is on its way.
    let mut first = connect(&served);
    first.write_all(head(&served, &own, 10).as_bytes()).unwrap();
    let begun = std::time::Instant::now();
    while !ask(&own, 10).starts_with("HTTP/1.1 503 ") {
        assert!(begun.elapsed() < WAIT_MAX, "the first is not being received");
    }
    first.shutdown(std::net::Shutdown::Write).unwrap();
    assert!(response(first).starts_with("HTTP/1.1 408 "));
    assert_eq!(served.with(|bridge| (SAVED_ROOM.take(), bridge.room_offer())), (None, None));
}

#[test]
fn a_denied_address_offers_no_room() {
    let served = Served::start(BridgeConfig::default());
    served.with(|bridge| bridge.deny(Ipv4Addr::LOCALHOST.into())).unwrap();
    let mut stream = connect(&served);
    stream.write_all(head(&served, &own_origin(&served), 3).as_bytes()).unwrap();
    stream.write_all(b"abc").unwrap();
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    let refused = response(stream);
    assert!(refused.starts_with("HTTP/1.1 403 ") && refused.contains("it is denied"), "{refused}");
    assert_eq!(served.with(|bridge| (SAVED_ROOM.take(), bridge.room_offer())), (None, None));
}
