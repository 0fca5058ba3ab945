//! ros_tcp on a listening socket: one task a client, all on one thread.

use crate::bridge::Bridge;
use crate::client::ClientId;
use crate::command::{handshake, name};
use crate::frame::{Parser, Side};
use crate::outbox::{Flushed, Outbox};
use crate::pool::Pool;
use socket2::{SockRef, TcpKeepalive};
use std::future::Future;
use std::io;
use std::net::{Shutdown, SocketAddr};
use std::rc::Rc;
use std::time::{Duration, Instant};
use tokio::io::Interest;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::task::{JoinSet, yield_now};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

/// Frames of one client handled before others get their turn.
const FRAMES_PER_TURN: usize = 64;
/// How often overdue service calls and map transforms are looked at.
const TICK: Duration = Duration::from_millis(250);
/// A client that is silent so long is asked whether it is there, and then again and again. One that has gone without a
/// word (battery, Wi-Fi) is let go after [`UNACKNOWLEDGED_MAX`] on Linux, which does not count probes where that is
/// set; elsewhere after the probes.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(5);
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(2);
const KEEPALIVE_RETRIES: u32 = 3;
/// A peer that takes nothing for so long is gone. A headset that is put down for a moment is not.
const UNACKNOWLEDGED_MAX: Duration = Duration::from_secs(60);
/// How long a connection that is being closed may take to read why.
const FAREWELL: Duration = Duration::from_secs(1);
/// Bytes read and thrown away meanwhile, so that the close does not look like a reset.
const FAREWELL_BYTES_MAX: usize = 1 << 20;
/// Connections that are being closed or refused beside the clients; more are dropped without a word.
const FAREWELLS_MAX: usize = 64;
/// Pause after accept(2) failed, as it does when descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Accepts clients until `stop` is ready, then lets them all go. Runs inside a [`tokio::task::LocalSet`] on a
/// current-thread runtime with io and time enabled.
pub async fn serve(bridge: Rc<Bridge>, listener: TcpListener, stop: impl Future<Output = ()>) {
    let clients_max = bridge.clients_max();
    let mut tasks = JoinSet::new();
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut stop = std::pin::pin!(stop);
    loop {
        tokio::select! {
            biased;
            () = &mut stop => break,
            _ = tick.tick() => bridge.tick(Instant::now()),
            Some(_) = tasks.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok((stream, peer)) if tasks.len() < clients_max + FAREWELLS_MAX => {
                    tasks.spawn_local(client(bridge.clone(), stream, peer));
                }
                Ok(_) => {}
                Err(_) => sleep(ACCEPT_PAUSE).await,
            },
        }
    }
    tasks.shutdown().await;
}

/// Takes the client out of the bridge however its task ends.
struct Attached<'a> {
    bridge: &'a Bridge,
    id: ClientId,
}

impl Drop for Attached<'_> {
    fn drop(&mut self) {
        self.bridge.detach(self.id);
    }
}

async fn client(bridge: Rc<Bridge>, stream: TcpStream, peer: SocketAddr) {
    if tune(&stream, bridge.unsent_bytes_max()).is_err() {
        return;
    }
    let stream = Rc::new(stream);
    let wake = Rc::new(Notify::new());
    let Some(id) = bridge.attach(&stream, peer, &wake) else {
        return farewell(&stream, &mut Pool::default(), refusal(&bridge)).await;
    };
    let attached = Attached { bridge: &bridge, id };
    let end = converse(&bridge, id, &stream, &wake).await;
    if let End::LostTrack(why) = end
        && let Some(rest) = bridge.lost_track(id, why)
    {
        drop(attached);
        farewell(&stream, &mut Pool::default(), rest).await;
    }
}

/// Why a conversation is over.
enum End {
    /// The peer has gone, or does not take what it asked for.
    Gone,
    /// Its stream cannot be cut into frames any more.
    LostTrack(String),
}

/// Reads and writes until the connection ends.
async fn converse(bridge: &Bridge, id: ClientId, stream: &TcpStream, wake: &Notify) -> End {
    let mut parser = Parser::new(bridge.frame_bytes_max());
    // Ends when there is no such client any more, or it takes nothing that it asked for.
    while let Ok(waiting) = bridge.waits(id) {
        let interest = if waiting { Interest::READABLE | Interest::WRITABLE } else { Interest::READABLE };
        let ready = tokio::select! {
            biased;
            ready = stream.ready(interest) => ready,
            () = wake.notified() => continue,
        };
        let Ok(ready) = ready else { break };
        if (ready.is_readable() || ready.is_read_closed())
            && let Some(end) = read_turn(bridge, id, stream, &mut parser).await
        {
            return end;
        }
        if ready.is_writable() && waiting && bridge.flush_one(id) {
            yield_now().await;
        }
    }
    End::Gone
}

/// One read and the frames it has brought. `Some` at the end of the connection.
async fn read_turn(bridge: &Bridge, id: ClientId, stream: &TcpStream, parser: &mut Parser) -> Option<End> {
    match read(stream, parser.space()) {
        Ok(0) => return Some(End::Gone),
        Ok(count) => parser.filled(count),
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => return None,
        Err(error) if error.kind() == io::ErrorKind::Interrupted => return None,
        Err(_) => return Some(End::Gone),
    }
    let mut frames = 0;
    loop {
        match parser.next_frame() {
            Ok(Some(frame)) => bridge.receive(id, frame),
            Ok(None) => break,
            Err(error) => return Some(End::LostTrack(error.to_string())),
        }
        frames += 1;
        if frames % FRAMES_PER_TURN == 0 {
            bridge.flush();
            yield_now().await;
        }
    }
    bridge.flush();
    None
}

/// Reads with quick acknowledgement on both sides of it: Unity's connector writes field by field with Nagle's
/// algorithm on, so that each of its writes waits for our acknowledgement of the one before, which Linux would
/// otherwise delay by 40 ms. The option does not last, so it is set again each time.
fn read(stream: &TcpStream, space: &mut [u8]) -> io::Result<usize> {
    quick_ack(stream);
    let count = stream.try_read(space)?;
    quick_ack(stream);
    Ok(count)
}

#[cfg(target_os = "linux")]
fn quick_ack(stream: &TcpStream) {
    // Best effort: it fails only on a connection that is gone, which the read tells.
    let _ = stream.set_quickack(true);
}

#[cfg(not(target_os = "linux"))]
fn quick_ack(_: &TcpStream) {}

fn tune(stream: &TcpStream, unsent_bytes_max: u32) -> io::Result<()> {
    stream.set_nodelay(true)?;
    quick_ack(stream);
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

/// What one client too many is told.
fn refusal(bridge: &Bridge) -> Outbox {
    let mut frames = Vec::new();
    let text = format!("the bridge has {} clients, its limit (clients_max)", bridge.clients_max());
    Side::Server.write(&mut frames, name::HANDSHAKE, handshake(bridge.dialect()));
    Side::Server.write_command(&mut frames, name::ERROR, &crate::command::Notice { text });
    Outbox::holding(Rc::new(frames))
}

/// Sends what is left, closes our side, and reads to the end, for a while: closing with unread bytes would reset
/// the connection and lose what was sent.
async fn farewell(stream: &TcpStream, pool: &mut Pool, mut rest: Outbox) {
    let talk = async {
        loop {
            stream.writable().await?;
            match rest.flush(|slices| stream.try_write_vectored(slices), pool)? {
                Flushed::All => break,
                Flushed::Blocked => {}
                Flushed::TurnOver => yield_now().await,
            }
        }
        SockRef::from(stream).shutdown(Shutdown::Write)?;
        let (mut sink, mut total) = ([0; 4096], 0);
        while total < FAREWELL_BYTES_MAX {
            stream.readable().await?;
            match stream.try_read(&mut sink) {
                Ok(0) => break,
                Ok(count) => total += count,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
        Ok::<(), io::Error>(())
    };
    // Whether it listened to the end changes nothing.
    let _ = timeout(FAREWELL, talk).await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "current_thread")]
    async fn a_clients_socket_is_watched_and_waits_for_nothing() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let _client = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let (stream, _) = listener.accept().await.unwrap();
        tune(&stream, 1 << 17).unwrap();
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
