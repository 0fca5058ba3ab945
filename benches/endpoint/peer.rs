//! The ROS 2 peer: an rclpy node in a process of its own.

use serde::Deserialize;
use std::collections::BTreeMap;
use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

/// Domains whose ports lie below those that the system gives to anybody.
pub fn domain() -> u16 {
    2 + (std::process::id() % 98) as u16
}

/// Sets what ROS 2 reads from its environment: this domain, on this machine alone, with Fast DDS.
pub fn set_ros_environment(command: &mut Command, domain: u16) {
    command
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp");
}

/// What the peer counted.
#[derive(Debug, Deserialize)]
pub struct PeerReport {
    /// Number of messages that it published, by topic.
    pub sent: BTreeMap<String, u64>,
    /// Delay of each command that it received, nanoseconds.
    pub command_delays_ns: Vec<i64>,
}

/// The peer's process.
pub struct Peer {
    process: Child,
    output: BufReader<ChildStdout>,
}

impl Peer {
    /// Starts the peer; returns when its node stands.
    pub fn start(python: &Path, domain: u16, length: Duration) -> Result<Self, Box<dyn Error>> {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/endpoint/ros_peer.py");
        let mut command = Command::new(python);
        set_ros_environment(&mut command, domain);
        let mut process = command
            .arg(script)
            .arg(length.as_secs().to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let output = BufReader::new(process.stdout.take().ok_or("the peer has no stdout")?);
        let mut peer = Self { process, output };
        match peer.line()?.trim() {
            "ready" => Ok(peer),
            other => Err(format!("the ROS 2 peer did not start: '{other}'").into()),
        }
    }

    fn line(&mut self) -> Result<String, Box<dyn Error>> {
        let mut line = String::new();
        self.output.read_line(&mut line)?;
        Ok(line)
    }

    fn tell(&mut self) -> Result<(), Box<dyn Error>> {
        let input = self.process.stdin.as_mut().ok_or("the peer has no stdin")?;
        writeln!(input)?;
        Ok(input.flush()?)
    }

    /// Makes the peer publish.
    pub fn begin(&mut self) -> Result<(), Box<dyn Error>> {
        self.tell()
    }

    /// Ends the peer; returns what it counted.
    pub fn end(mut self) -> Result<PeerReport, Box<dyn Error>> {
        self.tell()?;
        let line = self.line()?;
        Ok(serde_json::from_str(&line)
            .map_err(|why| format!("the ROS 2 peer said '{}': {why}", line.trim()))?)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
