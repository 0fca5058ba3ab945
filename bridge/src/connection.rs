//! What the servers of ros_tcp and of the page share: the accept loop, a connection's options, and its end.

use crate::bridge::Bridge;
use socket2::{SockRef, TcpKeepalive};
use std::future::Future;
use std::io::{self, IoSlice};
use std::net::{Shutdown, SocketAddr};
use std::time::Duration;
use tokio::io::{Interest, Ready};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

/// A client that is silent for so long is probed by TCP keepalive.
///
/// A client that vanished without closing (battery, Wi-Fi) is disconnected after [`UNACKNOWLEDGED_MAX`] on Linux,
/// where that limit replaces the count of probes; elsewhere after the probes.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(5);
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(2);
const KEEPALIVE_RETRIES: u32 = 3;
/// A peer that acknowledges nothing for so long is gone. A headset that sleeps for a moment is not.
const UNACKNOWLEDGED_MAX: Duration = Duration::from_secs(60);
/// How long a connection that is being closed may take to read the reason.
pub(crate) const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);
/// Bytes read and dropped meanwhile: unread bytes would turn the close into a reset, which loses the reason.
const DRAINED_BYTES_MAX: usize = 1 << 20;
/// Buffer for bytes that are read and dropped.
const DRAIN_BUFFER_BYTES: usize = 4096;
/// Pause after accept(2) failed, as it does when file descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// A connection's bytes, read and written without waiting: TCP, or what is carried by it.
///
/// All methods but [`Stream::tcp`] mean what those of [`TcpStream`] mean. `ready` is safe to cancel.
pub(crate) trait Stream: 'static {
    /// Returns the TCP connection below, for its addresses and options.
    fn tcp(&self) -> &TcpStream;
    /// Waits until the stream can probably be read or written.
    async fn ready(&self, interest: Interest) -> io::Result<Ready>;
    /// Reads what has arrived; 0 at the end.
    fn try_read(&self, buffer: &mut [u8]) -> io::Result<usize>;
    /// Writes as many bytes as are taken now, and returns their number.
    fn try_write_vectored(&self, slices: &[IoSlice<'_>]) -> io::Result<usize>;
    /// Tells the peer that nothing more will be sent.
    fn shutdown_write(&self) -> io::Result<()>;
}

impl Stream for TcpStream {
    fn tcp(&self) -> &TcpStream {
        self
    }

    async fn ready(&self, interest: Interest) -> io::Result<Ready> {
        TcpStream::ready(self, interest).await
    }

    fn try_read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        TcpStream::try_read(self, buffer)
    }

    fn try_write_vectored(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        TcpStream::try_write_vectored(self, slices)
    }

    fn shutdown_write(&self) -> io::Result<()> {
        SockRef::from(self).shutdown(Shutdown::Write)
    }
}

/// Accepts connections until `stop` is ready, and serves each in a task of its own; then ends these tasks.
///
/// Connections beyond the bridge's clients and `others_max` more are dropped. Runs inside a [`tokio::task::LocalSet`].
pub(crate) async fn accept_connections<F: Future<Output = ()> + 'static>(
    bridge: &Bridge,
    listener: TcpListener,
    others_max: usize,
    stop: impl Future<Output = ()>,
    serve_connection: impl Fn(TcpStream, SocketAddr) -> F,
) {
    let connections_max = bridge.clients_max() + others_max;
    let mut tasks = JoinSet::new();
    let mut stop = std::pin::pin!(stop);
    loop {
        tokio::select! {
            biased;
            () = &mut stop => break,
            Some(_) = tasks.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok((stream, peer)) if tasks.len() < connections_max => {
                    // It fails only on a connection that is closed already.
                    if set_socket_options(&stream, bridge.unsent_bytes_max()).is_ok() {
                        tasks.spawn_local(serve_connection(stream, peer));
                    }
                }
                Ok(_) => {}
                Err(_) => sleep(ACCEPT_PAUSE).await,
            },
        }
    }
    tasks.shutdown().await;
}

#[cfg(target_os = "linux")]
pub(crate) fn set_quick_ack(stream: &TcpStream) {
    // It fails only on a connection that is closed, which the read notices.
    let _ = stream.set_quickack(true);
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn set_quick_ack(_: &TcpStream) {}

/// Sets keepalive, time-outs and the limit of unsent bytes; no delay for short frames.
fn set_socket_options(stream: &TcpStream, unsent_bytes_max: u32) -> io::Result<()> {
    stream.set_nodelay(true)?;
    set_quick_ack(stream);
    let socket = SockRef::from(stream);
    let keepalive = TcpKeepalive::new().with_time(KEEPALIVE_IDLE).with_interval(KEEPALIVE_INTERVAL);
    socket.set_tcp_keepalive(&keepalive.with_retries(KEEPALIVE_RETRIES))?;
    #[cfg(target_os = "linux")]
    {
        socket.set_tcp_user_timeout(Some(UNACKNOWLEDGED_MAX))?;
        socket.set_tcp_notsent_lowat(unsent_bytes_max)?;
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (unsent_bytes_max, UNACKNOWLEDGED_MAX);
    Ok(())
}

/// Closes the bridge's side of a connection, and reads until the peer closes, at most [`CLOSE_TIMEOUT`].
pub(crate) async fn close_gently(stream: &impl Stream) {
    // The connection is closed in any case.
    let _ = timeout(CLOSE_TIMEOUT, close_and_read(stream)).await;
}

async fn close_and_read(stream: &impl Stream) -> io::Result<()> {
    stream.shutdown_write()?;
    let (mut buffer, mut total) = ([0; DRAIN_BUFFER_BYTES], 0);
    while total < DRAINED_BYTES_MAX {
        stream.ready(Interest::READABLE).await?;
        match stream.try_read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => total += count,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "current_thread")]
    async fn a_clients_socket_has_keepalive_and_no_delay() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let _client = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let (stream, _) = listener.accept().await.unwrap();
        set_socket_options(&stream, 1 << 17).unwrap();
        let socket = SockRef::from(&stream);
        assert!(stream.nodelay().unwrap());
        assert!(socket.keepalive().unwrap());
        assert_eq!(socket.tcp_keepalive_time().unwrap(), KEEPALIVE_IDLE);
        assert_eq!(socket.tcp_keepalive_interval().unwrap(), KEEPALIVE_INTERVAL);
        assert_eq!(socket.tcp_keepalive_retries().unwrap(), KEEPALIVE_RETRIES);
        #[cfg(target_os = "linux")]
        {
            assert_eq!(socket.tcp_user_timeout().unwrap(), Some(UNACKNOWLEDGED_MAX));
            assert_eq!(socket.tcp_notsent_lowat().unwrap(), 1 << 17);
        }
    }
}
