//! ros_tcp over TCP, with one task for each client, all on one thread, around the same [`Bridge`].

use crate::bridge::Bridge;
use crate::command::{Notice, handshake, name};
use crate::core::ConnectError;
use crate::frame::{IDLE_BYTES, Parser, Side};
use crate::router::{BufferPool, ClientId, ClientSocket, FlushOutcome, OutgoingQueue};
use msg::Monotonic;
use rustix::net::{SendAncillaryBuffer, SendFlags, sendmsg};
use socket2::{SockRef, TcpKeepalive};
use std::cell::Cell;
use std::future::Future;
use std::io::{self, IoSlice};
use std::net::{Shutdown, SocketAddr};
use std::rc::Rc;
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use tokio::io::Interest;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::task::{JoinSet, spawn_local, yield_now};
use tokio::time::{sleep, timeout};

/// Frames of one client that are handled before other clients get their turn.
const FRAMES_PER_TURN: usize = 64;
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
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);
/// Bytes read and dropped meanwhile: unread bytes would turn the close into a reset, which loses the reason.
const DRAINED_BYTES_MAX: usize = 1 << 20;
/// Buffer for bytes that are read and dropped.
const DRAIN_BUFFER_BYTES: usize = 4096;
/// Connections that are being closed or refused, beside the clients; more are dropped without a reason.
const CLOSING_MAX: usize = 64;
/// Bytes handed to the kernel in one write while its send buffer is small, and the number of frames in them.
const PORTION_BYTES: usize = 2048;
const SLICES_MAX: usize = 64;
/// A larger send buffer belongs to a fast connection, on which a few segments more or less do not matter, bytes.
const BOUNDED_BUFFER_MAX: usize = 64 << 10;
/// Pause after accept(2) failed, as it does when file descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Returns the time since the first call in this process: a clock for [`serve`] where nothing else needs the time.
pub fn process_clock() -> Monotonic {
    static START: OnceLock<Instant> = OnceLock::new();
    Monotonic(START.get_or_init(Instant::now).elapsed().as_nanos() as u64)
}

/// Accepts clients and calls [`Bridge::tick`] until `stop` is ready, then disconnects all clients.
///
/// `clock` returns the monotonic time that the bridge is called with. Runs inside a [`tokio::task::LocalSet`] on a
/// current-thread runtime with io and time enabled.
pub async fn serve(
    bridge: Rc<Bridge>,
    listener: TcpListener,
    clock: fn() -> Monotonic,
    stop: impl Future<Output = ()>,
) {
    let ticks = spawn_local(run_ticks(bridge.clone(), clock));
    serve_clients(bridge, listener, clock, stop).await;
    ticks.abort();
}

/// Accepts clients until `stop` is ready, then disconnects them all. The caller calls [`Bridge::tick`].
pub async fn serve_clients(
    bridge: Rc<Bridge>,
    listener: TcpListener,
    clock: fn() -> Monotonic,
    stop: impl Future<Output = ()>,
) {
    let clients_max = bridge.clients_max();
    let mut tasks = JoinSet::new();
    let mut stop = std::pin::pin!(stop);
    loop {
        tokio::select! {
            biased;
            () = &mut stop => break,
            Some(_) = tasks.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok((stream, peer)) if tasks.len() < clients_max + CLOSING_MAX => {
                    tasks.spawn_local(run_client(bridge.clone(), stream, peer, clock));
                }
                Ok(_) => {}
                Err(_) => sleep(ACCEPT_PAUSE).await,
            },
        }
    }
    tasks.shutdown().await;
}

/// Calls the bridge when something is due. It is a task of its own, so that robots stop in time whatever clients do.
async fn run_ticks(bridge: Rc<Bridge>, clock: fn() -> Monotonic) {
    loop {
        bridge.tick(clock());
        let now = clock();
        sleep(Duration::from_nanos(bridge.next_tick(now).since(now))).await;
    }
}

/// A client's socket for the router.
struct TcpSocket {
    stream: Rc<TcpStream>,
    wake: Rc<Notify>,
    clock: fn() -> Monotonic,
    /// Whether the kernel takes small portions, so that it holds no more than its send buffer.
    is_bounded: Cell<bool>,
    /// Bytes written since the last one that ended a portion.
    portion: Cell<usize>,
}

impl TcpSocket {
    fn new(stream: Rc<TcpStream>, wake: Rc<Notify>, clock: fn() -> Monotonic) -> Self {
        Self { stream, wake, clock, is_bounded: Cell::new(true), portion: Cell::new(0) }
    }

    /// Writes one portion at most. Linux checks the send buffer only where it begins a new segment buffer, and would
    /// fill the last one up to 64 kB; a write that ends a record closes it.
    fn write_portion(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        let mut portion = [IoSlice::new(&[]); SLICES_MAX];
        let (mut count, mut total) = (0, 0);
        for slice in slices.iter().take(SLICES_MAX) {
            let part = slice.len().min(PORTION_BYTES - total);
            portion[count] = IoSlice::new(&slice[..part]);
            (count, total) = (count + 1, total + part);
            if total == PORTION_BYTES {
                break;
            }
        }
        let ends = self.portion.get() + total >= PORTION_BYTES / 2;
        let flags = if ends { SendFlags::EOR } else { SendFlags::empty() };
        let written = self.stream.try_io(Interest::WRITABLE, || {
            let mut control = SendAncillaryBuffer::default();
            Ok(sendmsg(&*self.stream, &portion[..count], &mut control, flags)?)
        })?;
        self.portion.set(if ends { 0 } else { self.portion.get() + written });
        Ok(written)
    }
}

impl ClientSocket for TcpSocket {
    fn now(&self) -> Monotonic {
        (self.clock)()
    }

    fn try_write(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        if self.is_bounded.get() {
            self.write_portion(slices)
        } else {
            self.stream.try_write_vectored(slices)
        }
    }

    fn set_send_buffer(&self, bytes: usize) {
        self.is_bounded.set(bytes <= BOUNDED_BUFFER_MAX);
        // It fails only on a connection that is closed, which the next write notices.
        let _ = SockRef::from(&*self.stream).set_send_buffer_size(bytes);
    }

    fn wake(&self) {
        self.wake.notify_one();
    }
}

/// Disconnects the client however its task ends.
struct Connection<'a> {
    bridge: &'a Bridge,
    id: ClientId,
    stream: &'a TcpStream,
    wake: &'a Notify,
    clock: fn() -> Monotonic,
}

impl Drop for Connection<'_> {
    fn drop(&mut self) {
        self.bridge.disconnect(self.id);
    }
}

async fn run_client(bridge: Rc<Bridge>, stream: TcpStream, peer: SocketAddr, clock: fn() -> Monotonic) {
    if set_socket_options(&stream, bridge.unsent_bytes_max()).is_err() {
        return;
    }
    let stream = Rc::new(stream);
    let wake = Rc::new(Notify::new());
    let socket = Box::new(TcpSocket::new(stream.clone(), wake.clone(), clock));
    let id = match bridge.connect_socket(peer, socket) {
        Ok(id) => id,
        Err(error) => {
            return drain_and_close(&stream, refusal(bridge.dialect(), &error)).await;
        }
    };
    let connection = Connection { bridge: &bridge, id, stream: &stream, wake: &wake, clock };
    if let ConnectionEnd::InvalidStream(why) = serve_client(&connection).await {
        bridge.drop_client(id, why);
    }
    drop(connection);
    if let Some(unsent) = bridge.take_unsent(id) {
        drain_and_close(&stream, unsent).await;
    }
}

/// Why a connection ends.
enum ConnectionEnd {
    /// The peer has closed, or does not read what it asked for.
    Closed,
    /// The peer's stream cannot be cut into frames any more, and why.
    InvalidStream(String),
}

/// Reads and writes until the connection ends.
async fn serve_client(connection: &Connection<'_>) -> ConnectionEnd {
    let Connection { bridge, id, stream, wake, .. } = *connection;
    let mut parser = Parser::new(bridge.frame_bytes_max());
    while let Ok(is_blocked) = bridge.is_blocked(id) {
        let interest = if is_blocked { Interest::READABLE | Interest::WRITABLE } else { Interest::READABLE };
        let ready = tokio::select! {
            biased;
            ready = stream.ready(interest) => ready,
            () = wake.notified() => continue,
        };
        let Ok(ready) = ready else { break };
        if (ready.is_readable() || ready.is_read_closed())
            && let Some(end) = read_frames(connection, &mut parser).await
        {
            return end;
        }
        if ready.is_writable() && is_blocked && bridge.flush_client(id) {
            yield_now().await;
        }
    }
    ConnectionEnd::Closed
}

/// Reads once and handles the frames that are complete; `Some` at the end of the connection.
async fn read_frames(connection: &Connection<'_>, parser: &mut Parser) -> Option<ConnectionEnd> {
    match read(connection.stream, parser.space()) {
        Ok(0) => return Some(ConnectionEnd::Closed),
        Ok(count) => parser.filled(count),
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => return None,
        Err(error) if error.kind() == io::ErrorKind::Interrupted => return None,
        Err(_) => return Some(ConnectionEnd::Closed),
    }
    let mut frames = 0;
    loop {
        match parser.next_frame() {
            Ok(Some(frame)) => connection.bridge.receive(connection.id, frame, (connection.clock)()),
            Ok(None) => break,
            Err(error) => return Some(ConnectionEnd::InvalidStream(error.to_string())),
        }
        frames += 1;
        if frames % FRAMES_PER_TURN == 0 {
            connection.bridge.flush();
            yield_now().await;
        }
    }
    connection.bridge.flush();
    check_large_frame(connection, parser);
    None
}

/// Asks whether the rest of a large frame may be received, and skips it if not.
fn check_large_frame(connection: &Connection<'_>, parser: &mut Parser) {
    let size = parser.next_size();
    match parser.incomplete() {
        Some(frame) if frame.frame_bytes > IDLE_BYTES => {
            let now = (connection.clock)();
            if !connection.bridge.admit_large_frame(connection.id, frame, size, now) {
                parser.skip_frame();
            }
        }
        _ if parser.capacity() > size => {
            parser.release();
            connection.bridge.end_large_frame(connection.id);
        }
        _ => {}
    }
}

/// Reads with quick acknowledgement before and after.
///
/// Unity's connector writes field by field with Nagle's algorithm on. Each of its writes waits for the
/// acknowledgement of the one before, which Linux would delay by 40 ms. The option does not last, so that it is set
/// again each time.
fn read(stream: &TcpStream, space: &mut [u8]) -> io::Result<usize> {
    set_quick_ack(stream);
    let count = stream.try_read(space)?;
    set_quick_ack(stream);
    Ok(count)
}

#[cfg(target_os = "linux")]
fn set_quick_ack(stream: &TcpStream) {
    // It fails only on a connection that is closed, which the read notices.
    let _ = stream.set_quickack(true);
}

#[cfg(not(target_os = "linux"))]
fn set_quick_ack(_: &TcpStream) {}

/// Sets keepalive, time-outs and the limit of unsent bytes; no delay for short frames.
pub(crate) fn set_socket_options(stream: &TcpStream, unsent_bytes_max: u32) -> io::Result<()> {
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

/// Returns the frames for a client that cannot connect: the handshake, which must come first, and the reason.
fn refusal(dialect: ros_messages::cdr::Dialect, error: &ConnectError) -> OutgoingQueue {
    let mut frames = Vec::new();
    Side::Server.write(&mut frames, name::HANDSHAKE, handshake(dialect));
    Side::Server.write_command(&mut frames, name::ERROR, &Notice { text: error.to_string() });
    OutgoingQueue::with_frames(Rc::new(frames))
}

/// Sends what is left, closes the bridge's side, and reads until the peer closes, at most [`CLOSE_TIMEOUT`].
async fn drain_and_close(stream: &TcpStream, mut unsent: OutgoingQueue) {
    let drain = async {
        let mut pool = BufferPool::default();
        loop {
            stream.writable().await?;
            match unsent.flush(|slices| stream.try_write_vectored(slices), &mut pool)? {
                FlushOutcome::Complete => break,
                FlushOutcome::Blocked => {}
                FlushOutcome::TurnEnded => yield_now().await,
            }
        }
        close_and_read(stream).await
    };
    // The connection is closed in any case.
    let _ = timeout(CLOSE_TIMEOUT, drain).await;
}

/// What closing a connection needs of its stream.
pub(crate) trait ClosingStream {
    /// Returns the socket.
    fn socket(&self) -> SockRef<'_>;
    /// Waits until something can be read, or the other side has closed.
    async fn readable(&self) -> io::Result<()>;
    /// Reads what is there.
    fn try_read(&self, buffer: &mut [u8]) -> io::Result<usize>;
}

impl ClosingStream for TcpStream {
    fn socket(&self) -> SockRef<'_> {
        SockRef::from(self)
    }

    async fn readable(&self) -> io::Result<()> {
        self.readable().await
    }

    fn try_read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        self.try_read(buffer)
    }
}

/// Closes the bridge's side of a connection, and reads until the peer closes, at most [`CLOSE_TIMEOUT`].
pub(crate) async fn close_gently(stream: &impl ClosingStream) {
    let _ = timeout(CLOSE_TIMEOUT, close_and_read(stream)).await;
}

async fn close_and_read(stream: &impl ClosingStream) -> io::Result<()> {
    stream.socket().shutdown(Shutdown::Write)?;
    let (mut buffer, mut total) = ([0; DRAIN_BUFFER_BYTES], 0);
    while total < DRAINED_BYTES_MAX {
        stream.readable().await?;
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
