//! A TCP proxy that passes bytes as a wireless link does.
//!
//! TCP hides loss: what a lost segment costs is a stall until it is sent again. So loss is drawn as stalls.

use super::{Link, LinkModel, SEGMENT_BYTES};
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Most connections at a time; more are closed at once.
const CONNECTIONS_MAX: usize = 16;
/// Most segments under way in one direction: a sender beyond it waits, as at a full socket.
const UNDER_WAY_MAX: usize = 256;

/// A segment under way: when it arrives, and its bytes.
type Segment = (Instant, Vec<u8>);

/// Starts a proxy to a port of this machine; returns its own port. It serves until the program ends.
///
/// All connections have their outages at the same moments, and draw their delays from `seed` in the order in which they
/// were opened.
///
/// # Errors
/// No port can be listened on.
pub fn start(link: Link, port: u16, seed: u64) -> std::io::Result<u16> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let own = listener.local_addr()?.port();
    std::thread::spawn(move || {
        let (begun, open) = (Instant::now(), Arc::new(AtomicUsize::new(0)));
        for (number, client) in (0_u64..).zip(listener.incoming()) {
            // Where the bridge is restarting, the client's connection ends, as it would without the proxy.
            let (Ok(client), Ok(server)) = (client, TcpStream::connect(("127.0.0.1", port))) else {
                continue;
            };
            if open.fetch_add(1, Ordering::Relaxed) >= CONNECTIONS_MAX {
                open.fetch_sub(1, Ordering::Relaxed);
                continue;
            }
            let open = open.clone();
            std::thread::spawn(move || {
                // Where a thread cannot be started the connection ends.
                let _ = connect(link, begun, (seed, number), client, server);
                open.fetch_sub(1, Ordering::Relaxed);
            });
        }
    });
    Ok(own)
}

/// Passes bytes both ways until both ends have closed.
fn connect(
    link: Link,
    begun: Instant,
    (seed, number): (u64, u64),
    client: TcpStream,
    server: TcpStream,
) -> std::io::Result<()> {
    let (from_server, to_client) = (server.try_clone()?, client.try_clone()?);
    std::thread::scope(|scope| {
        scope.spawn(move || pass(LinkModel::new(link, seed, 2 * number), begun, client, server));
        scope.spawn(move || pass(LinkModel::new(link, seed, 2 * number + 1), begun, from_server, to_client));
    });
    Ok(())
}

/// Passes bytes one way until either end closes.
fn pass(mut model: LinkModel, begun: Instant, mut from: TcpStream, to: TcpStream) {
    let _ = to.set_nodelay(true);
    let (under_way, arriving) = sync_channel(UNDER_WAY_MAX);
    std::thread::scope(|scope| {
        let source = from.try_clone();
        scope.spawn(move || deliver(arriving, to, source.ok()));
        send(&mut model, begun, &mut from, under_way);
    });
}

/// Reads segments and draws when they arrive.
fn send(model: &mut LinkModel, begun: Instant, from: &mut TcpStream, under_way: SyncSender<Segment>) {
    let mut space = [0; SEGMENT_BYTES];
    loop {
        match from.read(&mut space) {
            Ok(0) => return,
            Ok(count) => {
                let arrival = begun + model.arrival(begun.elapsed(), count);
                if under_way.send((arrival, space[..count].to_vec())).is_err() {
                    return;
                }
            }
            Err(why) if why.kind() == ErrorKind::Interrupted => {}
            Err(_) => return,
        }
    }
}

/// Writes segments when they arrive. Ends the source when nobody reads them any more.
fn deliver(arriving: Receiver<Segment>, mut to: TcpStream, source: Option<TcpStream>) {
    for (arrival, bytes) in arriving {
        let left = arrival.saturating_duration_since(Instant::now());
        if left > Duration::ZERO {
            std::thread::sleep(left);
        }
        if to.write_all(&bytes).is_err() {
            if let Some(source) = source {
                let _ = source.shutdown(Shutdown::Both);
            }
            return;
        }
    }
    let _ = to.shutdown(Shutdown::Write);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    /// Time after which a test fails instead of waiting.
    const WATCHDOG: Duration = Duration::from_secs(30);

    #[test]
    fn bytes_pass_both_ways_in_order_on_two_connections_and_take_the_links_delay() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let link = Link { delay_ms: 20.0, ..Link::QUIET_WIFI };
        let port = start(link, listener.local_addr().unwrap().port(), 1).unwrap();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let mut from = stream.unwrap();
                std::thread::spawn(move || {
                    let mut to = from.try_clone().unwrap();
                    let _ = std::io::copy(&mut from, &mut to);
                    let _ = to.shutdown(Shutdown::Write);
                });
            }
        });
        let open = || {
            let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
            stream.set_read_timeout(Some(WATCHDOG)).unwrap();
            stream
        };
        let sent: Vec<u8> = (0..50_000_u32).flat_map(u32::to_le_bytes).collect();
        let (mut one, mut other) = (open(), open());
        for stream in [&mut one, &mut other] {
            let begun = Instant::now();
            let mut to = stream.try_clone().unwrap();
            let bytes = sent.clone();
            let writer = std::thread::spawn(move || {
                to.write_all(&bytes).unwrap();
                to.shutdown(Shutdown::Write).unwrap();
            });
            let mut echo = Vec::new();
            stream.read_to_end(&mut echo).unwrap();
            writer.join().unwrap();
            assert!(echo == sent, "{} bytes of {} came back", echo.len(), sent.len());
            assert!(begun.elapsed() >= Duration::from_millis(40), "20 ms each way at least");
        }
    }
}
