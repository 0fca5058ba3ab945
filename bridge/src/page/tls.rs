//! HTTPS: TLS around the connections of the page's server.
//!
//! The server reads and writes one end of a pair of sockets, and a task carries bytes between the other end and TLS. The
//! pair is small: what waits for a slow browser waits in the router, where newer maps replace older ones.

use super::server::{REQUEST_TIMEOUT, Shared, serve_connection};
use super::stream::ClearStream;
use socket2::SockRef;
use std::io;
use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;
use tokio::io::copy_bidirectional_with_sizes;
use tokio::net::{TcpStream, UnixStream};
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

/// Bytes that the pair of sockets holds in each direction; the kernel doubles it for its own use.
const PAIR_BYTES: usize = 16 << 10;
/// Bytes that are encrypted at a time: one record of TLS.
const RECORD_BYTES: usize = 16 << 10;
/// Time for a browser to take the end of what was said, and to close.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);
/// The one protocol that is spoken inside (RFC 7301): without it browsers try HTTP/2.
const ALPN: &[u8] = b"http/1.1";

/// Why a certificate and its key cannot be used.
#[derive(Debug, Error)]
pub enum TlsError {
    /// The certificate's text is no PEM file with a certificate.
    #[error("the certificate is no PEM file: {0}")]
    Certificate(pem::Error),
    /// The key's text is no PEM file with a private key.
    #[error("the private key is no PEM file: {0}")]
    Key(pem::Error),
    /// The certificate and the key do not fit to each other, or are of a kind that TLS does not know.
    #[error("certificate and private key cannot be used: {0}")]
    Unusable(#[from] rustls::Error),
}

/// Reads a chain of certificates and its private key, both in PEM, and prepares TLS 1.2 and 1.3 with them.
pub fn tls_acceptor(certificate_pem: &[u8], key_pem: &[u8]) -> Result<TlsAcceptor, TlsError> {
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(certificate_pem).collect();
    let chain = chain.map_err(TlsError::Certificate)?;
    if chain.is_empty() {
        return Err(TlsError::Certificate(pem::Error::NoItemsFound));
    }
    let key = PrivateKeyDer::from_pem_slice(key_pem).map_err(TlsError::Key)?;
    let builder = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let builder = builder.with_safe_default_protocol_versions()?.with_no_client_auth();
    let mut config = builder.with_single_cert(chain, key)?;
    config.alpn_protocols = vec![ALPN.to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// Serves one encrypted connection.
pub async fn serve_encrypted(shared: Rc<Shared>, stream: TcpStream, peer: SocketAddr, acceptor: TlsAcceptor) {
    let (Ok(tcp), Ok((clear, mut other))) = (second_handle(&stream), pair()) else { return };
    let Ok(Ok(mut encrypted)) = timeout(REQUEST_TIMEOUT, acceptor.accept(stream)).await else { return };
    let carry = copy_bidirectional_with_sizes(&mut encrypted, &mut other, RECORD_BYTES, RECORD_BYTES);
    let serve = async {
        serve_connection(shared, ClearStream { pair: clear, tcp }, peer).await;
        sleep(CLOSE_TIMEOUT).await;
    };
    // It ends when both sides have closed; a browser that does not is not waited for.
    tokio::select! {
        _ = carry => {}
        () = serve => {}
    }
}

/// Returns another handle of the same connection.
fn second_handle(stream: &TcpStream) -> io::Result<TcpStream> {
    TcpStream::from_std(std::net::TcpStream::from(stream.as_fd().try_clone_to_owned()?))
}

/// Creates a pair of sockets that hold little.
fn pair() -> io::Result<(UnixStream, UnixStream)> {
    let (one, other) = UnixStream::pair()?;
    for end in [&one, &other] {
        SockRef::from(end).set_send_buffer_size(PAIR_BYTES)?;
    }
    Ok((one, other))
}
