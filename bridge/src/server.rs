//! ros_tcp over TCP, with one task for each client, all on one thread, around the same [`Bridge`].

use crate::bridge::Bridge;
use crate::command::{Notice, handshake, name};
use crate::connection::{CLOSE_TIMEOUT, accept_connections, close_gently, set_quick_ack};
use crate::core::ConnectError;
use crate::frame::{IDLE_BYTES, Parser, Side};
use crate::router::{BufferPool, ClientId, ClientSocket, FlushOutcome, OutgoingQueue};
use msg::Monotonic;
use rustix::net::{SendAncillaryBuffer, SendFlags, sendmsg};
use socket2::SockRef;
use std::cell::Cell;
use std::future::Future;
use std::io::{self, IoSlice};
use std::net::SocketAddr;
use std::rc::Rc;
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use tokio::io::Interest;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::task::{spawn_local, yield_now};
use tokio::time::{sleep, timeout};

/// Frames of one client that are handled before other clients get their turn.
const FRAMES_PER_TURN: usize = 64;
/// Connections that are being closed or refused, beside the clients; more are dropped without a reason.
const CLOSING_MAX: usize = 64;
/// Bytes handed to the kernel in one write while its send buffer is small, and the number of frames in them.
const PORTION_BYTES: usize = 2048;
const SLICES_MAX: usize = 64;
/// A larger send buffer belongs to a fast connection, on which a few segments more or less do not matter, bytes.
const BOUNDED_BUFFER_MAX: usize = 64 << 10;

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
    let serve = |stream, peer| run_client(bridge.clone(), stream, peer, clock);
    accept_connections(&bridge, listener, CLOSING_MAX, stop, serve).await;
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
struct ClientGuard<'a> {
    bridge: &'a Bridge,
    id: ClientId,
    stream: &'a TcpStream,
    wake: &'a Notify,
    clock: fn() -> Monotonic,
}

impl Drop for ClientGuard<'_> {
    fn drop(&mut self) {
        self.bridge.disconnect(self.id);
    }
}

async fn run_client(bridge: Rc<Bridge>, stream: TcpStream, peer: SocketAddr, clock: fn() -> Monotonic) {
    let stream = Rc::new(stream);
    let wake = Rc::new(Notify::new());
    let socket = Box::new(TcpSocket::new(stream.clone(), wake.clone(), clock));
    let id = match bridge.connect_socket(peer, socket) {
        Ok(id) => id,
        Err(error) => {
            return drain_and_close(&stream, refusal(bridge.dialect(), &error)).await;
        }
    };
    let connection = ClientGuard { bridge: &bridge, id, stream: &stream, wake: &wake, clock };
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
async fn serve_client(connection: &ClientGuard<'_>) -> ConnectionEnd {
    let ClientGuard { bridge, id, stream, wake, .. } = *connection;
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
async fn read_frames(connection: &ClientGuard<'_>, parser: &mut Parser) -> Option<ConnectionEnd> {
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
fn check_large_frame(connection: &ClientGuard<'_>, parser: &mut Parser) {
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
        close_gently(stream).await;
        Ok::<(), io::Error>(())
    };
    // The connection is closed in any case.
    let _ = timeout(CLOSE_TIMEOUT, drain).await;
}
