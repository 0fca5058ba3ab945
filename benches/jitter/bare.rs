//! The bare hops: a timer, a relay it wakes, TCP. No fleet, no messages, no maps; as many wake-ups.

use crate::measure::{Spread, Streams};
use mr_slam::clock::now;
use mr_slam::shared_memory::wait;
use msg::Monotonic;
use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// As /tf: 20 Hz.
const PERIOD_NS: u64 = 50_000_000;
/// As a robot's part of /tf: six links.
const MESSAGE_BYTES: usize = 640;

/// The two processes, and the client's end.
pub struct Bare {
    children: Vec<Child>,
    socket: PathBuf,
    client: TcpStream,
}

impl Bare {
    /// Starts them.
    pub fn start(robots: usize) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let port = listener.local_addr()?.port().to_string();
        let socket = std::env::temp_dir().join(format!("mr-slam-bare-{}", std::process::id()));
        let program = std::env::current_exe()?;
        let relay = Command::new(&program).arg("bare-relay").arg(&socket).arg(&port).spawn()?;
        // The relay binds its socket, then connects.
        let (client, _) = listener.accept()?;
        let timer = Command::new(&program).arg("bare-timer").arg(&socket).arg(robots.to_string()).spawn()?;
        Ok(Self { children: vec![relay, timer], socket, client })
    }

    /// Reads what comes.
    pub fn measure(mut self, warm_up: Duration, length: Duration) -> io::Result<Spread> {
        let mut streams = Streams::new(PERIOD_NS as i64);
        let mut message = [0; MESSAGE_BYTES];
        let begun = Instant::now();
        while begun.elapsed() < warm_up + length {
            self.client.read_exact(&mut message)?;
            let received = now();
            let stamp = u64::from_le_bytes(message[..8].try_into().unwrap_or_default());
            if begun.elapsed() >= warm_up {
                streams.note(&message[8].to_string(), stamp as i64, received.0);
            }
        }
        Ok(streams.spread())
    }
}

impl Drop for Bare {
    fn drop(&mut self) {
        for child in &mut self.children {
            let _ = child.kill();
            let _ = child.wait();
        }
        let _ = std::fs::remove_file(&self.socket);
    }
}

/// Sends each robot's message on time, the robots 10 ms apart.
pub fn timer(socket: &str, robots: u64) -> io::Result<()> {
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
    let sender = UnixDatagram::unbound()?;
    sender.connect(socket)?;
    let mut message = [0; MESSAGE_BYTES];
    let start = now().0;
    for round in 1.. {
        for robot in 0..robots {
            let due = start + round * PERIOD_NS + robot * 10_000_000;
            wait([], Monotonic(due));
            message[..8].copy_from_slice(&due.to_le_bytes());
            message[8] = robot as u8;
            sender.send(&message)?;
        }
    }
    Ok(())
}

/// Passes messages on.
pub fn relay(socket: &str, port: u16) -> io::Result<()> {
    let receiver = UnixDatagram::bind(socket)?;
    let mut client = TcpStream::connect(("127.0.0.1", port))?;
    client.set_nodelay(true)?;
    let mut message = [0; MESSAGE_BYTES];
    loop {
        receiver.recv(&mut message)?;
        client.write_all(&message)?;
    }
}

/// Milliseconds that `size` bytes take over a plain socket to another thread, `count` times, sorted.
#[allow(dead_code, reason = "the jitter bench has no bulk")]
pub fn bulk(size: usize, count: usize) -> io::Result<Vec<f64>> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let port = listener.local_addr()?.port();
    let writer = std::thread::spawn(move || -> io::Result<()> {
        let (mut stream, _) = listener.accept()?;
        let (data, mut go) = (vec![1; size], [0]);
        while stream.read_exact(&mut go).is_ok() {
            stream.write_all(&data)?;
        }
        Ok(())
    });
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    let (mut data, mut times) = (vec![0; size], Vec::new());
    for _ in 0..count {
        let begun = now();
        stream.write_all(&[1])?;
        stream.read_exact(&mut data)?;
        times.push(now().since(begun) as f64 * 1e-6);
    }
    drop(stream);
    let _ = writer.join();
    times.sort_by(f64::total_cmp);
    Ok(times)
}
