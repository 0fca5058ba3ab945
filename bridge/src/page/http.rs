//! HTTP requests for the page's files and for WebSockets, and their responses.
//!
//! A connection serves one request: nothing can follow it that means something else to another program on the way.

use super::origin::{OriginError, check_host, check_origin};
use super::protocol::SUBPROTOCOLS;
use super::room::{ROOM_BYTES_MAX, ROOM_PATH};
use super::tlx::{TLX_BYTES_MAX, TLX_PATH};
use httparse::{EMPTY_HEADER, Header, Status};
use std::net::IpAddr;
use thiserror::Error;
use tungstenite::handshake::derive_accept_key;

/// The longest request with its headers, bytes. Browsers send less than 2 KB.
pub const HEAD_BYTES_MAX: usize = 16 << 10;
/// Most headers of a request.
const HEADERS_MAX: usize = 64;
/// Headers of every response. The page needs nothing from elsewhere, may not be framed, and is never stale.
const COMMON_HEADERS: &str = "Connection: close\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
    Referrer-Policy: no-referrer\r\nCross-Origin-Resource-Policy: same-origin\r\n\
    Content-Security-Policy: default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'\r\n";

/// A file of the page, embedded in the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageFile {
    /// Path in the URL, such as `/main.js`; `/` is the page itself.
    pub path: &'static str,
    /// Its media type, such as `text/javascript`.
    pub content_type: &'static str,
    /// Content as it is sent.
    pub bytes: &'static [u8],
}

/// What a request asks for.
#[derive(Debug, PartialEq, Eq)]
pub enum Request {
    /// A file. `with_body` is false for HEAD.
    File {
        /// The path without the query.
        path: String,
        /// Whether the content is wanted, or only the headers.
        with_body: bool,
    },
    /// A room that is offered; its bytes follow.
    Room {
        /// Bytes of the body.
        length: usize,
    },
    /// An answer to the form of workload; its bytes follow.
    Tlx {
        /// Bytes of the body.
        length: usize,
    },
    /// A WebSocket: the response that accepts it.
    WebSocket {
        /// The bytes of the response.
        response: Vec<u8>,
    },
}

/// Why a request is refused.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RequestError {
    /// The bytes are no HTTP request, or too long.
    #[error("not an HTTP/1.1 request of at most {HEAD_BYTES_MAX} bytes and {HEADERS_MAX} headers")]
    Malformed,
    /// The request is not for GET or HEAD, or has a body.
    #[error("only GET and HEAD without a body are served, and POST to {ROOM_PATH} and {TLX_PATH}")]
    Method,
    /// The room's length is not said, or too large.
    #[error("a room has a Content-Length of 1 to {ROOM_BYTES_MAX} bytes; scan a single room")]
    RoomLength,
    /// The answer's length is not said, or too large.
    #[error("an answer has a Content-Length of 1 to {TLX_BYTES_MAX} bytes")]
    TlxLength,
    /// The request comes from a page that may not talk to the bridge.
    #[error(transparent)]
    Origin(#[from] OriginError),
    /// The WebSocket handshake is incomplete.
    #[error("a WebSocket needs version 13, a key, and one of the protocols {}", SUBPROTOCOLS.join(", "))]
    WebSocket,
}

impl RequestError {
    /// Returns the response that says so.
    pub fn response(&self) -> Vec<u8> {
        let status = match self {
            Self::Malformed | Self::WebSocket => "400 Bad Request",
            Self::Method => "405 Method Not Allowed",
            Self::RoomLength | Self::TlxLength => "413 Content Too Large",
            Self::Origin(_) => "403 Forbidden",
        };
        text_response(status, &self.to_string())
    }
}

/// Reads a request; `None` if more bytes are needed. Returns its length too: bytes behind it are a WebSocket's.
pub fn parse_request(
    bytes: &[u8],
    local: IpAddr,
    origins: &[String],
) -> Result<Option<(Request, usize)>, RequestError> {
    let mut headers = [EMPTY_HEADER; HEADERS_MAX];
    let mut request = httparse::Request::new(&mut headers);
    let length = match request.parse(bytes) {
        Ok(Status::Complete(length)) => length,
        Ok(Status::Partial) if bytes.len() < HEAD_BYTES_MAX => return Ok(None),
        Ok(Status::Partial) | Err(_) => return Err(RequestError::Malformed),
    };
    let (method, target) = (request.method.unwrap_or(""), request.path.unwrap_or(""));
    let headers = Headers(request.headers);
    let host = headers.only("host").ok_or(OriginError::NoHost)?;
    check_host(Some(host), local)?;
    let path = target.split(['?', '#']).next().unwrap_or("");
    if method == "POST" && path == ROOM_PATH {
        let body = accept_json(&headers, host, origins, ROOM_BYTES_MAX)?;
        return Ok(Some((Request::Room { length: body.ok_or(RequestError::RoomLength)? }, length)));
    }
    if method == "POST" && path == TLX_PATH {
        let body = accept_json(&headers, host, origins, TLX_BYTES_MAX)?;
        return Ok(Some((Request::Tlx { length: body.ok_or(RequestError::TlxLength)? }, length)));
    }
    let has_body =
        headers.has("transfer-encoding") || headers.only("content-length").is_some_and(|n| n != "0");
    if !matches!(method, "GET" | "HEAD") || has_body {
        return Err(RequestError::Method);
    }
    if headers.has_token("upgrade", "websocket") && method == "GET" {
        check_one_origin(&headers, host, origins)?;
        let response = accept_web_socket(&headers)?;
        return Ok(Some((Request::WebSocket { response }, length)));
    }
    let path = path.to_owned();
    Ok(Some((Request::File { path, with_body: method == "GET" }, length)))
}

/// Checks that the request comes from a page that may talk to the bridge.
fn check_one_origin(headers: &Headers<'_, '_>, host: &str, origins: &[String]) -> Result<(), RequestError> {
    // Two origins would be none that can be judged.
    if headers.has("origin") && headers.only("origin").is_none() {
        return Err(RequestError::Malformed);
    }
    Ok(check_origin(headers.only("origin"), host, origins)?)
}

/// Returns the length of a body in JSON from a page that may send one; `None`: it is not said, 0 or above `bytes_max`.
fn accept_json(
    headers: &Headers<'_, '_>,
    host: &str,
    origins: &[String],
    bytes_max: usize,
) -> Result<Option<usize>, RequestError> {
    check_one_origin(headers, host, origins)?;
    // JSON is a type that a foreign page cannot send without asking first (Fetch, CORS-safelisted request-header).
    if !headers.has_token("content-type", "application/json") || headers.has("transfer-encoding") {
        return Err(RequestError::Malformed);
    }
    let length = headers.only("content-length").and_then(|length| length.parse().ok());
    Ok(length.filter(|length| (1..=bytes_max).contains(length)))
}

/// Returns the response that accepts a WebSocket (RFC 6455, 4.2.2).
fn accept_web_socket(headers: &Headers<'_, '_>) -> Result<Vec<u8>, RequestError> {
    let key = headers.only("sec-websocket-key").filter(|key| key.len() == 24);
    let is_known =
        headers.only("sec-websocket-version") == Some("13") && headers.has_token("connection", "upgrade");
    let protocol = SUBPROTOCOLS.into_iter().find(|known| headers.has_token("sec-websocket-protocol", known));
    let (Some(key), true, Some(protocol)) = (key, is_known, protocol) else {
        return Err(RequestError::WebSocket);
    };
    let accept = derive_accept_key(key.as_bytes());
    let response = format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Accept: {accept}\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n"
    );
    Ok(response.into_bytes())
}

/// Returns the response with a file's headers, or that there is none; and the content that follows.
pub fn file_response(files: &[PageFile], path: &str, with_body: bool) -> (Vec<u8>, &'static [u8]) {
    let Some(file) = files.iter().find(|file| file.path == path) else {
        return (text_response("404 Not Found", "there is no such file"), &[]);
    };
    let head = format!(
        "HTTP/1.1 200 OK\r\nContent-Type: {}\r\nContent-Length: {}\r\n{COMMON_HEADERS}\r\n",
        file.content_type,
        file.bytes.len()
    );
    (head.into_bytes(), if with_body { file.bytes } else { &[] })
}

/// Returns a response of plain text.
pub fn text_response(status: &str, text: &str) -> Vec<u8> {
    let length = text.len() + 1;
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {length}\r\n\
         {COMMON_HEADERS}\r\n{text}\n"
    )
    .into_bytes()
}

/// The headers of a request.
struct Headers<'h, 'b>(&'h [Header<'b>]);

impl<'b> Headers<'_, 'b> {
    fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'b [u8]> + 'a {
        self.0.iter().filter(move |header| header.name.eq_ignore_ascii_case(name)).map(|header| header.value)
    }

    fn has(&self, name: &str) -> bool {
        self.all(name).next().is_some()
    }

    /// Returns a header's value if the request has it once.
    fn only(&self, name: &str) -> Option<&'b str> {
        let mut values = self.all(name);
        let value = values.next().filter(|_| values.next().is_none())?;
        std::str::from_utf8(value).ok().map(str::trim)
    }

    /// Returns whether a header's list has this word.
    fn has_token(&self, name: &str, token: &str) -> bool {
        let values = self.all(name).filter_map(|value| std::str::from_utf8(value).ok());
        let mut tokens = values.flat_map(|value| value.split(','));
        tokens.any(|known| known.trim().eq_ignore_ascii_case(token))
    }
}

#[cfg(test)]
mod tests;
