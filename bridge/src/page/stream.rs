//! The clear side of an encrypted connection, as the page's server reads and writes it, and responses on any connection.

use crate::connection::{Stream, close_gently};
use socket2::SockRef;
use std::io::{self, IoSlice};
use std::net::Shutdown;
use std::time::Duration;
use tokio::io::{Interest, Ready};
use tokio::net::{TcpStream, UnixStream};
use tokio::time::timeout;

/// A file must be taken in this time. The whole page is smaller than a map.
const FILE_TIMEOUT: Duration = Duration::from_secs(20);

/// One end of a pair of sockets; TLS reads and writes the other end.
pub struct ClearStream {
    /// The end of the pair.
    pub pair: UnixStream,
    /// The TCP connection below TLS: a handle of its own, for addresses and options alone.
    pub tcp: TcpStream,
}

impl Stream for ClearStream {
    fn tcp(&self) -> &TcpStream {
        &self.tcp
    }

    async fn ready(&self, interest: Interest) -> io::Result<Ready> {
        self.pair.ready(interest).await
    }

    fn try_read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        self.pair.try_read(buffer)
    }

    fn try_write_vectored(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        self.pair.try_write_vectored(slices)
    }

    fn shutdown_write(&self) -> io::Result<()> {
        SockRef::from(&self.pair).shutdown(Shutdown::Write)
    }
}

/// Sends a response and closes the connection.
pub(super) async fn respond(stream: &impl Stream, head: &[u8], body: &[u8]) {
    let write = async {
        for mut bytes in [head, body] {
            while !bytes.is_empty() {
                stream.ready(Interest::WRITABLE).await?;
                match stream.try_write_vectored(&[IoSlice::new(bytes)]) {
                    Ok(written) => bytes = &bytes[written..],
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                    Err(error) => return Err(error),
                }
            }
        }
        Ok::<(), io::Error>(())
    };
    if let Ok(Ok(())) = timeout(FILE_TIMEOUT, write).await {
        close_gently(stream).await;
    }
}
