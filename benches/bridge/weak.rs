//! A client with the fleet's real mix behind a weak link, and how old its transforms are, the first maps included.
//!
//! The link is a TCP proxy that passes bytes at a constant rate and holds little itself: a router on the way acknowledges
//! nothing, so that what waits there waits in the bridge's kernel. The age of a transform is the time between its
//! arrival at a client without the link and at the one behind it.

use crate::client::{Client, EVERYTHING};
use bridge::ros::{TfMessage, decode};
use rustix::net::sockopt::set_socket_recv_buffer_size;
use rustix::net::{AddressFamily, SocketType, connect, socket};
use std::collections::BTreeMap;
use std::error::Error;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddrV4, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Bytes that the proxy's kernel holds in each direction; Linux doubles them.
const PROXY_BUFFER_BYTES: usize = 2048;
/// Period in which the proxy passes on what the rate allows.
const STEP: Duration = Duration::from_millis(5);

/// What the client behind the link got.
pub struct Outcome {
    /// Ages of the newest transform when the next one comes, milliseconds, sorted.
    pub ages_ms: Vec<f64>,
    /// Maps that arrived.
    pub maps: usize,
}

/// Connects a client over a link of so many bytes per second, and another one without; both read for `length`.
pub fn measure(port: u16, bytes_per_s: f64, length: Duration) -> Result<Outcome, Box<dyn Error>> {
    let direct = Client::connect(port, &EVERYTHING[..1])?;
    let behind = Client::connect_only(start_proxy(port, bytes_per_s)?, &EVERYTHING)?;
    behind.stream.set_read_timeout(Some(length))?;
    let reader = std::thread::spawn(move || read(direct, length).map_err(|why| why.to_string()));
    let (late, maps) = read(behind, length)?;
    let (early, _) = reader.join().map_err(|_| "the direct client failed")??;
    let early: BTreeMap<(i64, String), Instant> = early.into_iter().map(|(at, key)| (key, at)).collect();
    // Each message makes the one before it as old as it ever is.
    let before = late.iter().map(|(_, key)| key);
    let pairs = late.iter().skip(1).zip(before);
    let mut ages_ms: Vec<f64> = pairs
        .filter_map(|((at, _), key)| Some(at.saturating_duration_since(*early.get(key)?).as_secs_f64() * 1e3))
        .collect();
    ages_ms.sort_by(f64::total_cmp);
    Ok(Outcome { ages_ms, maps })
}

/// Stamp and child frame of a message's first transform.
type Key = (i64, String);

/// Arrivals of messages with transforms.
type Arrivals = Vec<(Instant, Key)>;

/// Reads for so long; returns the arrivals of transforms, and the number of maps.
fn read(mut client: Client, length: Duration) -> Result<(Arrivals, usize), Box<dyn Error>> {
    let (begun, mut arrivals, mut maps) = (Instant::now(), Vec::new(), 0);
    while begun.elapsed() < length {
        let key = client.next(|name, payload| match name {
            b"/tf" => decode::<TfMessage>(payload).ok().map(|message| {
                message.transforms.first().map(|first| (first.stamp.0, first.child_frame_id.clone()))
            }),
            name if name.ends_with(b"map") => Some(None),
            _ => None,
        })?;
        match key.ok_or("the connection ended")? {
            Some(Some(key)) => arrivals.push((Instant::now(), key)),
            Some(None) => maps += 1,
            None => {}
        }
    }
    Ok((arrivals, maps))
}

/// Starts a proxy that serves one connection; returns its port.
fn start_proxy(port: u16, bytes_per_s: f64) -> Result<u16, Box<dyn Error>> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let own = listener.local_addr()?.port();
    // The window that the bridge's kernel sees follows from the buffer at the time of connecting.
    let server = socket(AddressFamily::INET, SocketType::STREAM, None)?;
    set_socket_recv_buffer_size(&server, PROXY_BUFFER_BYTES)?;
    connect(&server, &SocketAddrV4::new(Ipv4Addr::LOCALHOST, port))?;
    let server = TcpStream::from(server);
    std::thread::spawn(move || -> std::io::Result<()> {
        let (mut client, _) = listener.accept()?;
        client.set_nodelay(true)?;
        let mut up = (client.try_clone()?, server.try_clone()?);
        std::thread::spawn(move || std::io::copy(&mut up.0, &mut up.1));
        let mut server = server;
        let mut part = vec![0; (bytes_per_s * STEP.as_secs_f64()) as usize];
        let mut due = Instant::now();
        loop {
            let count = server.read(&mut part)?;
            if count == 0 {
                return client.shutdown(Shutdown::Both);
            }
            // What was read is under way for as long as the link needs for it.
            due = due.max(Instant::now()) + Duration::from_secs_f64(count as f64 / bytes_per_s);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            client.write_all(&part[..count])?;
        }
    });
    Ok(own)
}
