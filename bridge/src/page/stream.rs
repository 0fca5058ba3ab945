//! The clear side of an encrypted connection, as the page's server reads and writes it; responses and last words on any connection.

use super::encoder::Encoder;
use crate::connection::{Stream, close_gently};
use crate::router::{BufferPool, FlushOutcome, OutgoingQueue};
use socket2::SockRef;
use std::cell::RefCell;
use std::io::{self, IoSlice};
use std::net::Shutdown;
use std::time::Duration;
use tokio::io::{Interest, Ready};
use tokio::net::{TcpStream, UnixStream};
use tokio::task::yield_now;
use tokio::time::timeout;

/// A file must be taken in this time. The whole page is smaller than a map.
const FILE_TIMEOUT: Duration = Duration::from_secs(20);
/// A WebSocket frame that closes the connection, with code 1000: normal (RFC 6455, 5.5.1 and 7.4.1).
const CLOSE_FRAME: [u8; 4] = [0x88, 2, 0x03, 0xe8];

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

/// Sends what is left for a client, then a WebSocket's close, unless the client's own close is answered already.
pub(super) async fn send_last_words(
    mut unsent: Option<OutgoingQueue>,
    encoder: &RefCell<Encoder>,
    stream: &impl Stream,
    has_closed: bool,
) -> io::Result<()> {
    let mut pool = BufferPool::default();
    while let Some(queue) = &mut unsent {
        let write = |slices: &[IoSlice<'_>]| {
            encoder.borrow_mut().write(slices, |slices| stream.try_write_vectored(slices))
        };
        match queue.flush(write, &mut pool)? {
            FlushOutcome::Complete => unsent = None,
            FlushOutcome::Blocked => drop(stream.ready(Interest::WRITABLE).await?),
            FlushOutcome::TurnEnded => yield_now().await,
        }
    }
    if !has_closed {
        encoder.borrow_mut().send_frames(&CLOSE_FRAME)?;
    }
    while encoder.borrow().has_waiting() {
        stream.ready(Interest::WRITABLE).await?;
        flush(encoder, stream)?;
    }
    Ok(())
}

/// Writes what the encoder holds, as far as the socket takes it.
pub(super) fn flush(encoder: &RefCell<Encoder>, stream: &impl Stream) -> io::Result<()> {
    match encoder.borrow_mut().flush(&mut |slices: &[IoSlice<'_>]| stream.try_write_vectored(slices)) {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
        result => result,
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
