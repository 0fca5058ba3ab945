//! A fleet of one robot in one of the worlds.

#[path = "../launcher.rs"]
mod launcher;

use crate::link::operator_address;
use mr_slam::process::control::saved_state::stop_file;
use rustix::process::{Pid, Signal, kill_process};
use std::error::Error;
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// How long the fleet may take to end.
const END_WITHIN: Duration = Duration::from_secs(20);

/// A launcher with its processes, which end with it.
pub struct Fleet {
    launcher: Child,
    dir: PathBuf,
    /// Whether its robot is one of ROS.
    pub is_ros: bool,
    /// Number of the ROS domain.
    pub domain: u16,
    /// TCP port for clients.
    pub port: u16,
}

impl Fleet {
    /// Starts a fleet in a world.
    pub fn start(world: &str) -> Result<Self, Box<dyn Error>> {
        let dir = std::env::temp_dir().join(format!("mr-slam-safety-{}-{world}", std::process::id()));
        // Domains whose ports lie below those that the system gives to anybody.
        let domain = 2 + (std::process::id() % 98) as u16;
        let mut launcher = launcher::command("up")
            .args(["--port", "0", "--robots", "1", "--world", world])
            .args(["--ros-domain", &domain.to_string(), "--allow", &operator_address(), "--run-dir"])
            .arg(&dir)
            .stdin(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()?;
        launcher::wait_until_ready(&mut launcher)?;
        let mut fleet = Self { launcher, dir, is_ros: world == "ros", domain, port: 0 };
        let run = std::fs::read(fleet.dir.join("run.json"))?;
        let run: serde_json::Value = serde_json::from_slice(&run)?;
        fleet.port = run["port"].as_u64().ok_or("no port in run.json")? as u16;
        crate::wait("a bridge", || fleet.bridge().is_ok())?;
        Ok(fleet)
    }

    /// Returns where clients on this machine connect.
    pub fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// Returns whether the run's folder says that the emergency stop is set: what a bridge that starts again sets.
    pub fn is_stopped(&self) -> bool {
        stop_file(&self.dir).exists()
    }

    /// Returns the process id of the bridge.
    pub fn bridge(&self) -> Result<u32, Box<dyn Error>> {
        let launcher = self.launcher.id();
        let children = std::fs::read_to_string(format!("/proc/{launcher}/task/{launcher}/children"))?;
        let is_bridge = |pid: &u32| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            line.split(|byte| *byte == 0).any(|word| word == b"bridge")
        };
        let pids = children.split_whitespace().filter_map(|pid| pid.parse().ok());
        Ok(pids.into_iter().find(is_bridge).ok_or("the fleet has no bridge")?)
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        launcher::terminate(&self.launcher);
        let begun = Instant::now();
        while matches!(self.launcher.try_wait(), Ok(None)) && begun.elapsed() < END_WITHIN {
            std::thread::sleep(Duration::from_millis(20));
        }
        // It has ended, unless it hangs.
        let _ = self.launcher.kill();
        let _ = self.launcher.wait();
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

/// Sends a signal to a process if it exists.
pub fn send(pid: u32, signal: Signal) {
    if let Some(pid) = Pid::from_raw(pid as i32) {
        let _ = kill_process(pid, signal);
    }
}
