//! The bare hops: a timer process that wakes a relay process, and TCP to a client.
//!
//! There are as many wake-ups as in a fleet, but no fleet, messages or maps.

use crate::measure::{Punctual, Spread, Streams};
use mr_slam::clock::now;
use mr_slam::shared_memory::wait;
use msg::Monotonic;
use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// Period of the messages, nanoseconds: 20 Hz, as /tf.
const PERIOD_NS: u64 = 50_000_000;
/// Time between the messages of two robots, nanoseconds, as between the simulators' ticks.
const ROBOT_OFFSET_NS: u64 = 10_000_000;
/// Size of a message, bytes: that of a robot's six links on /tf.
const MESSAGE_BYTES: usize = 640;

/// The two processes of the bare hops and the client's connection.
pub struct Bare {
    children: Vec<Child>,
    socket: PathBuf,
    client: TcpStream,
}

impl Bare {
    /// Starts the two processes and connects to the relay.
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

    /// Reads messages for `length` after `warm_up`, and measures their jitter.
    pub fn measure(mut self, warm_up: Duration, length: Duration) -> io::Result<Spread> {
        let _punctual = Punctual::begin();
        let mut streams = Streams::new(PERIOD_NS as i64);
        let mut message = [0; MESSAGE_BYTES];
        let begun = Instant::now();
        while begun.elapsed() < warm_up + length {
            self.client.read_exact(&mut message)?;
            let received = now();
            let stamp = u64::from_le_bytes(message[..8].try_into().unwrap_or_default());
            if begun.elapsed() >= warm_up {
                streams.record(&message[8].to_string(), stamp as i64, received.0);
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

/// Runs the timer process: sends each robot's message on time.
pub fn timer(socket: &str, robots: u64) -> io::Result<()> {
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
    let _punctual = Punctual::begin();
    let sender = UnixDatagram::unbound()?;
    sender.connect(socket)?;
    let mut message = [0; MESSAGE_BYTES];
    let start = now().0;
    for round in 1.. {
        for robot in 0..robots {
            let due = start + round * PERIOD_NS + robot * ROBOT_OFFSET_NS;
            wait([], Monotonic(due));
            message[..8].copy_from_slice(&due.to_le_bytes());
            message[8] = robot as u8;
            sender.send(&message)?;
        }
    }
    Ok(())
}

/// Runs the relay process: forwards each message to the client.
pub fn relay(socket: &str, port: u16) -> io::Result<()> {
    let _punctual = Punctual::begin();
    let receiver = UnixDatagram::bind(socket)?;
    let mut client = TcpStream::connect(("127.0.0.1", port))?;
    client.set_nodelay(true)?;
    let mut message = [0; MESSAGE_BYTES];
    loop {
        receiver.recv(&mut message)?;
        client.write_all(&message)?;
    }
}

/// Measures the time that `size` bytes take over a plain socket from another thread, `count` times. Returns
/// the times in milliseconds, sorted.
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
