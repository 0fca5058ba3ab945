//! The two ends that a page's connection can have: a TCP socket, or the clear side of an encrypted connection.

use crate::server::ClosingStream;
use socket2::SockRef;
use std::io::{self, IoSlice};
use tokio::io::{Interest, Ready};
use tokio::net::{TcpStream, UnixStream};

/// A connection to a browser, as the server reads and writes it.
pub enum PageStream {
    /// A socket that nothing encrypts.
    Plain(TcpStream),
    /// One end of a pair; TLS reads and writes the other end.
    Decrypted(UnixStream),
}

/// Calls a method of whichever stream it is.
macro_rules! each {
    ($stream:expr, $inner:ident => $call:expr) => {
        match $stream {
            PageStream::Plain($inner) => $call,
            PageStream::Decrypted($inner) => $call,
        }
    };
}

impl PageStream {
    /// Waits until the stream is ready for one of the operations.
    pub async fn ready(&self, interest: Interest) -> io::Result<Ready> {
        each!(self, stream => stream.ready(interest).await)
    }

    /// Waits until something can be written.
    pub async fn writable(&self) -> io::Result<()> {
        each!(self, stream => stream.writable().await)
    }

    /// Writes as much as the stream takes.
    pub fn try_write(&self, bytes: &[u8]) -> io::Result<usize> {
        each!(self, stream => stream.try_write(bytes))
    }

    /// Writes as much of several slices as the stream takes.
    pub fn try_write_vectored(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        each!(self, stream => stream.try_write_vectored(slices))
    }
}

impl ClosingStream for PageStream {
    fn socket(&self) -> SockRef<'_> {
        each!(self, stream => SockRef::from(stream))
    }

    async fn readable(&self) -> io::Result<()> {
        each!(self, stream => stream.readable().await)
    }

    fn try_read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        each!(self, stream => stream.try_read(buffer))
    }
}
