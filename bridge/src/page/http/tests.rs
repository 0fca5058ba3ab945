use super::*;
use proptest::prelude::*;
use std::net::Ipv4Addr;

const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
const SOCKET: &str = "GET /ws HTTP/1.1\r\nHost: localhost:8080\r\nUpgrade: websocket\r\n\
    Connection: keep-alive, Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\
    Sec-WebSocket-Protocol: other, foxglove.sdk.v1\r\nOrigin: http://localhost:8080\r\n\r\n";

fn parse(text: &str) -> Result<Option<(Request, usize)>, RequestError> {
    parse_request(text.as_bytes(), LOOPBACK, &[])
}

#[test]
fn a_file_is_asked_for_by_its_path() {
    let text = "GET /main.js?x=1 HTTP/1.1\r\nHost: localhost:8080\r\n\r\n";
    let expected = Request::File { path: "/main.js".into(), with_body: true };
    assert_eq!(parse(text), Ok(Some((expected, text.len()))));
    assert_eq!(parse(&text[..text.len() - 1]), Ok(None));
    let files = [PageFile { path: "/main.js", content_type: "text/javascript", bytes: b"1" }];
    let (head, body) = file_response(&files, "/main.js", true);
    assert!(head.starts_with(b"HTTP/1.1 200 OK\r\n") && head.ends_with(b"\r\n\r\n"));
    assert_eq!(body, b"1");
    assert!(file_response(&files, "/../etc/passwd", true).0.starts_with(b"HTTP/1.1 404"));
}

#[test]
fn a_web_socket_of_the_own_page_is_accepted_as_the_rfc_says() {
    let Ok(Some((Request::WebSocket { response }, _))) = parse(SOCKET) else { panic!("{:?}", parse(SOCKET)) };
    let response = String::from_utf8(response).unwrap();
    // The key and its answer are the example of RFC 6455, 1.3.
    assert!(response.contains("Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n"), "{response}");
    assert!(response.contains("Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"), "{response}");
}

#[test]
fn foreign_pages_and_foreign_hosts_are_forbidden() {
    let replaced = |from: &str, to: &str| parse(&SOCKET.replace(from, to)).unwrap_err();
    let foreign = replaced("Origin: http://localhost:8080", "Origin: https://evil.example");
    assert!(foreign.response().starts_with(b"HTTP/1.1 403"), "{foreign}");
    let rebound = SOCKET.replace("localhost:8080", "evil.example:8080");
    assert!(matches!(parse(&rebound), Err(RequestError::Origin(OriginError::Host(_)))));
    let two = replaced("Origin:", "Origin: https://evil.example\r\nOrigin:");
    assert_eq!(two, RequestError::Malformed);
    let two = replaced("Host:", "Host: evil.example\r\nHost:");
    assert_eq!(two, RequestError::Origin(OriginError::NoHost));
    assert_eq!(replaced("foxglove.sdk.v1", "foxglove.websocket.v1"), RequestError::WebSocket);
    assert_eq!(replaced("Version: 13", "Version: 8"), RequestError::WebSocket);
}

#[test]
fn a_room_is_offered_by_the_own_page_alone_and_bounded() {
    let room = "POST /room HTTP/1.1\r\nHost: localhost:8080\r\nOrigin: http://localhost:8080\r\n\
        Content-Type: application/json\r\nContent-Length: 70000\r\n\r\n";
    assert_eq!(parse(room), Ok(Some((Request::Room { length: 70_000 }, room.len()))));
    let replaced = |from: &str, to: &str| parse(&room.replace(from, to)).unwrap_err();
    assert!(matches!(
        replaced("Origin: http://localhost", "Origin: https://evil.example"),
        RequestError::Origin(_)
    ));
    assert_eq!(replaced("application/json", "text/plain"), RequestError::Malformed);
    for length in ["0", "16777217", "-1", "x", "99999999999999999999999"] {
        assert_eq!(replaced("70000", length), RequestError::RoomLength);
    }
    assert_eq!(replaced("Content-Length: 70000", "Transfer-Encoding: chunked"), RequestError::Malformed);
    assert_eq!(replaced("/room", "/rooms"), RequestError::Method);
}

#[test]
fn other_methods_and_bodies_are_refused() {
    for head in ["POST / HTTP/1.1", "PUT / HTTP/1.1", "OPTIONS / HTTP/1.1"] {
        assert_eq!(parse(&format!("{head}\r\nHost: localhost\r\n\r\n")), Err(RequestError::Method));
    }
    let body = "GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nabc";
    assert_eq!(parse(body), Err(RequestError::Method));
    assert_eq!(parse(&"x".repeat(HEAD_BYTES_MAX)), Err(RequestError::Malformed));
}

proptest! {
    #[test]
    fn random_bytes_are_a_request_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = parse_request(&bytes, LOOPBACK, &[]);
    }

    #[test]
    fn a_damaged_handshake_is_answered_or_an_error(
        damage in proptest::collection::vec((0..400_usize, any::<u8>()), 1..4)
    ) {
        let mut bytes = SOCKET.as_bytes().to_vec();
        for (place, byte) in damage {
            let place = place % bytes.len();
            bytes[place] = byte;
        }
        let _ = parse_request(&bytes, LOOPBACK, &[]);
    }
}
