//! The clear side of an encrypted connection, as the page's server reads and writes it.

use crate::connection::Stream;
use socket2::SockRef;
use std::io::{self, IoSlice};
use std::net::Shutdown;
use tokio::io::{Interest, Ready};
use tokio::net::{TcpStream, UnixStream};

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
