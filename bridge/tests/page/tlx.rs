//! Answers to the form of workload: validated, saved, and bounded.

use crate::browser::WAIT_MAX;
use crate::{SAVED_TLX, Served};
use bridge::BridgeConfig;
use std::io::{Read, Write};
use std::net::TcpStream;

const ANSWER: &str = r#"{"mental_demand":70,"physical_demand":5,"temporal_demand":40,"performance":20,"effort":60,"frustration":0}"#;

fn post(served: &Served, origin: &str, body: &str, length: usize) -> String {
    let mut stream = TcpStream::connect(served.page).unwrap();
    stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
    let head = format!(
        "POST /tlx HTTP/1.1\r\nHost: {}\r\nOrigin: {origin}\r\nContent-Type: application/json\r\n\
         Content-Length: {length}\r\n\r\n",
        served.page
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(body.as_bytes()).unwrap();
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    response
}

#[test]
fn an_answer_of_the_own_page_is_saved_and_others_are_refused_with_the_reason() {
    let served = Served::start(BridgeConfig::default());
    let own = format!("http://{}", served.page);
    let saved = || served.with(|_| SAVED_TLX.take());
    assert!(post(&served, "https://evil.example", ANSWER, ANSWER.len()).starts_with("HTTP/1.1 403 "));
    let large = post(&served, &own, "", 513);
    assert!(large.starts_with("HTTP/1.1 413 ") && large.contains("512 bytes"), "{large}");
    assert!(post(&served, &own, "{", ANSWER.len()).starts_with("HTTP/1.1 408 "), "it ends early");
    let wrong = ANSWER.replace("70", "71");
    let wrong = post(&served, &own, &wrong, wrong.len());
    assert!(wrong.starts_with("HTTP/1.1 422 ") && wrong.contains("mental demand is 71"), "{wrong}");
    assert_eq!(saved(), None);
    assert!(post(&served, &own, ANSWER, ANSWER.len()).starts_with("HTTP/1.1 201 "));
    assert_eq!(saved().map(|answer| answer.raw()), Some(32.5));
}

#[test]
fn a_denied_address_is_refused_and_takes_no_place() {
    let served = Served::start(BridgeConfig::default());
    let own = format!("http://{}", served.page);
    served.with(|bridge| bridge.deny(std::net::Ipv4Addr::LOCALHOST.into())).unwrap();
    let refused = post(&served, &own, ANSWER, ANSWER.len());
    assert!(refused.starts_with("HTTP/1.1 403 ") && refused.contains("it is denied"), "{refused}");
    assert_eq!(served.with(|_| SAVED_TLX.take()), None);
}
