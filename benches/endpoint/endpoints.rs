//! The two endpoints as processes.

use crate::peer::set_ros_environment;
use mr_slam::observer::Observer;
use mr_slam::run::Run;
use mr_slam::view::FleetView;
use std::error::Error;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
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
    /// The process to stop.
    process: Child,
    /// The process that serves the port.
    pid: u32,
    folder: Option<PathBuf>,
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
        let endpoint = Self { port, process, pid, folder: None };
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
        let folder = std::env::temp_dir().join(format!("mr-slam-endpoint-{}", std::process::id()));
        let mut command = Command::new(env!("CARGO_BIN_EXE_mr-slam"));
        set_ros_environment(&mut command, domain);
        let process = command
            .args(["up", "--world", "ros", "--robots", "1", "--port", "0"])
            .args(["--ros-domain", &domain.to_string(), "--run-dir"])
            .arg(&folder)
            .stderr(Stdio::null())
            .spawn()?;
        let mut endpoint = Self { port: 0, process, pid: 0, folder: Some(folder.clone()) };
        let begun = Instant::now();
        while begun.elapsed() < START_MAX {
            std::thread::sleep(POLL);
            let Ok(run) = Run::open(&folder) else { continue };
            endpoint.port = run.port;
            let mut observer = Observer::attach(&run, "endpoint")?;
            observer.wait(Duration::from_secs(3));
            observer.poll();
            let view = observer.stats().map(FleetView::new);
            let bridge =
                view.and_then(|view| view.processes.into_iter().find(|known| known.process == "bridge"));
            if let Some(bridge) = bridge {
                endpoint.pid = bridge.pid;
                return Ok(endpoint);
            }
        }
        Err("the bridge of mr-slam did not start".into())
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

impl Drop for Endpoint {
    fn drop(&mut self) {
        if let Some(pid) = rustix::process::Pid::from_raw(self.process.id() as i32) {
            let signal = match self.folder {
                Some(_) => rustix::process::Signal::TERM,
                None => rustix::process::Signal::KILL,
            };
            let _ = rustix::process::kill_process(pid, signal);
        }
        let _ = self.process.wait();
        if let Some(folder) = &self.folder {
            let _ = std::fs::remove_dir_all(folder);
        }
    }
}
