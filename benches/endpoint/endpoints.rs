//! The two endpoints as processes.

use crate::fleet::Fleet;
use crate::peer::set_ros_environment;
use std::error::Error;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// An endpoint that does not listen after this time has failed.
const START_MAX: Duration = Duration::from_secs(20);
const POLL: Duration = Duration::from_millis(50);

/// Which endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Unity's ROS-TCP-Endpoint.
    Python,
    /// The bridge of `mr-slam`.
    Ours,
}

impl Kind {
    /// Returns the name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Python => "ROS-TCP-Endpoint",
            Self::Ours => "mr-slam",
        }
    }
}

/// A running endpoint.
pub struct Endpoint {
    /// Its TCP port.
    pub port: u16,
    /// The process that serves the port.
    pid: u32,
    /// Ends with the endpoint.
    _process: Process,
}

/// What has to be ended.
enum Process {
    Python { _process: KilledAtEnd },
    Ours { _fleet: Box<Fleet> },
}

/// A process that is killed when nobody needs it any more.
struct KilledAtEnd(Child);

impl Drop for KilledAtEnd {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Endpoint {
    /// Starts an endpoint; returns when its port is open.
    pub fn start(kind: Kind, domain: u16, checkout: &Path, python: &Path) -> Result<Self, Box<dyn Error>> {
        match kind {
            Kind::Python => Self::start_python(domain, checkout, python),
            Kind::Ours => Self::start_ours(domain),
        }
    }

    fn start_python(domain: u16, checkout: &Path, python: &Path) -> Result<Self, Box<dyn Error>> {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let mut command = Command::new(python);
        set_ros_environment(&mut command, domain);
        let process = command
            .args(["-c", "from ros_tcp_endpoint.default_server_endpoint import main; main()", "--ros-args"])
            .args(["-p", "ROS_IP:=127.0.0.1", "-p", &format!("ROS_TCP_PORT:={port}")])
            .env("PYTHONPATH", checkout)
            .stdout(Stdio::null())
            .stderr(Stdio::inherit())
            .spawn()?;
        let pid = process.id();
        let endpoint = Self { port, pid, _process: Process::Python { _process: KilledAtEnd(process) } };
        let begun = Instant::now();
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            if begun.elapsed() > START_MAX {
                return Err(
                    "ROS-TCP-Endpoint does not listen: is --checkout right, and does --python have rclpy?"
                        .into(),
                );
            }
            std::thread::sleep(POLL);
        }
        Ok(endpoint)
    }

    /// Starts a fleet of one robot that is simulated nowhere, so that little but the bridge runs.
    fn start_ours(domain: u16) -> Result<Self, Box<dyn Error>> {
        let mut fleet = Fleet::start_with(1, &["--world", "ros", "--ros-domain", &domain.to_string()])?;
        let begun = Instant::now();
        let pid = loop {
            if let Some(pid) = fleet.pid("bridge") {
                break pid;
            }
            if begun.elapsed() > START_MAX {
                return Err("the bridge of mr-slam did not start".into());
            }
        };
        let port = fleet.run().port;
        Ok(Self { port, pid, _process: Process::Ours { _fleet: Box::new(fleet) } })
    }

    /// Returns the processor time that the endpoint's process has used, seconds.
    pub fn cpu_s(&self) -> Result<f64, Box<dyn Error>> {
        let text = std::fs::read_to_string(format!("/proc/{}/stat", self.pid))?;
        // After the name in parentheses, the 12th and 13th fields are the ticks in user and system mode (proc(5)).
        let fields: Vec<&str> = text.rsplit(')').next().unwrap_or("").split_whitespace().collect();
        let ticks = |index: usize| fields.get(index).and_then(|field| field.parse::<f64>().ok());
        let ticks = ticks(11).zip(ticks(12)).map(|(user, system)| user + system);
        Ok(ticks.ok_or("no times in /proc")? / rustix::param::clock_ticks_per_second() as f64)
    }
}
