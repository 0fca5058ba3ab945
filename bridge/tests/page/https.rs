//! The page over HTTPS: the same files, the same checks, the same protocol.

use crate::Served;
use crate::browser::WAIT_MAX;
use bridge::{BridgeConfig, TlsAcceptor, process_clock, tls_acceptor};
use rcgen::{CertificateParams, KeyPair};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, LazyLock};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Error, HandshakeError, Message};

/// The certificate of the tests and its key, in PEM.
static CERTIFICATE: LazyLock<(String, String)> = LazyLock::new(|| {
    let key = KeyPair::generate().unwrap();
    let params = CertificateParams::new(["127.0.0.1".to_owned()]).unwrap();
    (params.self_signed(&key).unwrap().pem(), key.serialize_pem())
});

/// Returns the server's side of TLS.
pub(crate) fn acceptor() -> TlsAcceptor {
    tls_acceptor(CERTIFICATE.0.as_bytes(), CERTIFICATE.1.as_bytes()).unwrap()
}

/// Connects to the page as a browser does that trusts the certificate.
fn connect(address: SocketAddr) -> StreamOwned<ClientConnection, TcpStream> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(CERTIFICATE.0.as_bytes()).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let config = config.with_safe_default_protocol_versions().unwrap();
    let config = config.with_root_certificates(roots).with_no_client_auth();
    let session = ClientConnection::new(Arc::new(config), address.ip().into()).unwrap();
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
    StreamOwned::new(session, stream)
}

fn request(served: &Served, text: &str) -> String {
    let mut stream = connect(served.encrypted);
    stream.write_all(text.as_bytes()).unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    response
}

#[test]
fn the_page_is_served_encrypted_with_the_same_checks() {
    let served = Served::start(BridgeConfig::default());
    let page = request(&served, &format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", served.encrypted));
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.ends_with("\r\n\r\n<!doctype html>"), "{page}");
    let rebound = request(&served, "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert!(rebound.starts_with("HTTP/1.1 403 "), "{rebound}");
}

#[test]
fn a_web_socket_over_https_is_a_client_like_any_other() {
    let served = Served::start(BridgeConfig::default());
    let open = |origin: &str| {
        let mut request = format!("wss://{}/", served.encrypted).into_client_request().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("foxglove.sdk.v1"));
        request.headers_mut().insert("Origin", HeaderValue::from_str(origin).unwrap());
        match tungstenite::client::client(request, connect(served.encrypted)) {
            Ok((socket, _)) => Ok(socket),
            Err(HandshakeError::Failure(Error::Http(response))) => Err(response.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    };
    assert_eq!(open("https://evil.example").err(), Some(403), "a foreign page");
    let mut socket = open(&format!("https://{}", served.encrypted)).unwrap();
    let clients = served.with(|bridge| bridge.clients(process_clock()).len());
    assert_eq!(clients, 1);
    // The first messages name the server and the topics.
    for expected in ["serverInfo", "advertise"] {
        let Message::Text(text) = socket.read().unwrap() else { panic!("no text") };
        assert!(text.contains(expected), "{text}");
    }
    socket.close(None).unwrap();
    while socket.read().is_ok() {}
    let begun = std::time::Instant::now();
    while served.with(|bridge| bridge.clients(process_clock()).len()) > 0 {
        assert!(begun.elapsed() < WAIT_MAX, "the client stays");
    }
}

#[test]
fn who_speaks_no_tls_gets_nothing() {
    let served = Served::start(BridgeConfig::default());
    let mut stream = TcpStream::connect(served.encrypted).unwrap();
    stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
    stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let mut response = Vec::new();
    // An alert of TLS or a reset, never the page.
    let _ = stream.read_to_end(&mut response);
    assert!(!response.windows(4).any(|bytes| bytes == b"HTTP"), "{response:?}");
}
