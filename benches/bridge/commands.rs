//! A command's way in, written as Unity's connector writes: each field by itself, with Nagle's algorithm on.

use crate::client::{Client, Wish};
use bridge::command::name;
use bridge::frame::Side;
use bridge::ros::{Message, Twist, encode};
use mr_slam::channel::{self, Opener, Program};
use mr_slam::clock::now;
use mr_slam::run::Run;
use mr_slam::shared_memory::{Participant, wait};
use msg::{Monotonic, RobotId, Role};
use std::error::Error;
use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::Duration;

/// A command every so often, as a headset at 50 Hz: one to the fleet, one over the bare hops.
const PERIOD: Duration = Duration::from_millis(10);
/// A command that takes longer is lost.
const PATIENCE_NS: u64 = 1_000_000_000;
/// As long as the real one.
const BARE_BYTES: usize = 72;
const BARE_NAME: usize = 11;

/// Milliseconds, sorted.
pub struct Times {
    /// From a command's first byte written to the moment who listens on the robot's channel, as its simulator does,
    /// has it.
    pub fleet: Vec<f64>,
    /// The same writes over bare hops: a process that reads a socket and acknowledges at once, and a datagram from it.
    pub bare: Vec<f64>,
}

/// Where a frame is cut.
fn fields(length: usize, name_length: usize) -> Vec<usize> {
    let payload = 8 + name_length;
    let mut cuts = vec![0, 4, 4 + name_length, payload, payload + 4];
    cuts.extend((payload + 4..=length).step_by(8).skip(1));
    cuts
}

fn write(stream: &mut TcpStream, frame: &[u8], cuts: &[usize]) -> io::Result<()> {
    cuts.windows(2).try_for_each(|cut| stream.write_all(&frame[cut[0]..cut[1]]))
}

/// Commands to the last robot and over the bare hops in turn, so that both meet the same machine.
pub fn measure(run: &Run, count: usize) -> Result<Times, Box<dyn Error>> {
    let robot = RobotId::first(3).last().ok_or("no robot")?;
    let node = Participant::open(&run.domain, Opener::of_robot(Program::Worker(Role::Sim), robot), "bench")?;
    let channel = channel::command(robot);
    let (mut reader, bell) = (node.reader(&channel)?, node.listener(&channel)?);
    let topic: Wish = (name::PUBLISH, "/cmd_vel_3", Twist::TYPE);
    let mut client = Client::connect(run.port, &[topic])?;
    client.stream.set_nodelay(false)?;
    let mut frame = Vec::new();
    let turning = Twist { linear: [0.0; 3], angular: [0.0, 0.0, 0.01] };
    Side::Client.write_with(&mut frame, topic.1, |out| encode(&turning, out));
    // A name from a client ends in a NUL.
    let cuts = fields(frame.len(), topic.1.len() + 1);
    let mut hops = Hops::start()?;
    let mut times = Times { fleet: Vec::new(), bare: Vec::new() };
    for _ in 0..count {
        std::thread::sleep(PERIOD);
        while reader.receive().is_some() {}
        let begun = now();
        write(&mut client.stream, &frame, &cuts)?;
        let until = Monotonic(begun.0 + PATIENCE_NS);
        while reader.receive().is_none() {
            wait([&bell], until);
            if now() >= until {
                return Err("a command did not arrive".into());
            }
        }
        times.fleet.push(now().since(begun) as f64 * 1e-6);
        std::thread::sleep(PERIOD);
        times.bare.push(hops.once()?);
    }
    times.fleet.sort_by(f64::total_cmp);
    times.bare.sort_by(f64::total_cmp);
    Ok(times)
}

/// The bare hops: our ends, and the process between.
struct Hops {
    process: Child,
    stream: TcpStream,
    arrives: UnixDatagram,
    socket: PathBuf,
}

impl Hops {
    fn start() -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let port = listener.local_addr()?.port().to_string();
        let socket = std::env::temp_dir().join(format!("mr-slam-hops-{}", std::process::id()));
        let arrives = UnixDatagram::bind(&socket)?;
        arrives.set_read_timeout(Some(Duration::from_nanos(PATIENCE_NS)))?;
        let process =
            Command::new(std::env::current_exe()?).arg("bare-command").arg(&socket).arg(port).spawn()?;
        let (stream, _) = listener.accept()?;
        Ok(Self { process, stream, arrives, socket })
    }

    /// Milliseconds of one command.
    fn once(&mut self) -> io::Result<f64> {
        let cuts = fields(BARE_BYTES, BARE_NAME);
        let begun = now();
        write(&mut self.stream, &[0; BARE_BYTES], &cuts)?;
        self.arrives.recv(&mut [0; BARE_BYTES])?;
        Ok(now().since(begun) as f64 * 1e-6)
    }
}

impl Drop for Hops {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
        let _ = std::fs::remove_file(&self.socket);
    }
}

/// The process between: what has come whole goes on as a datagram.
pub fn hop(socket: &str, port: u16) -> io::Result<()> {
    let onward = UnixDatagram::unbound()?;
    onward.connect(Path::new(socket))?;
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    let last = *fields(BARE_BYTES, BARE_NAME).last().unwrap_or(&BARE_BYTES);
    let (mut have, mut space) = (0, [0; 4096]);
    loop {
        rustix::net::sockopt::set_tcp_quickack(&stream, true)?;
        let count = stream.read(&mut space)?;
        if count == 0 {
            return Ok(());
        }
        have += count;
        rustix::net::sockopt::set_tcp_quickack(&stream, true)?;
        if have >= last {
            have -= last;
            onward.send(&space[..1])?;
        }
    }
}
