//! The fleet under measurement, and a ros_tcp client that reads from it as a headset does.

#[path = "../shared/browser.rs"]
pub mod browser;

use crate::launcher;
use crate::measure::{Figures, Punctual, Streams};
use bridge::command::{Registration, name};
use bridge::frame::{Parser, RosTcpFrame, Side};
use bridge::ros;
use mr_slam::clock::now;
use mr_slam::observer::Observer;
use mr_slam::run::Run;
use reports::FleetView;
use serde::Serialize;
use std::error::Error;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Largest frame that the client accepts, bytes. Frames of a fleet in the laboratory are smaller.
const FRAME_MAX: usize = 16 << 20;

/// Processor time and punctuality of one process.
#[derive(Clone, Debug, Serialize)]
pub struct Cpu {
    /// Name of the process, such as `bridge` or `sim of robot1`.
    pub process: String,
    /// Processor time over the measurement, percent of one core.
    pub percent: f64,
    /// Median delay of its ticks over the last second, milliseconds.
    pub late_p50_ms: f32,
    /// Longest delay of its ticks over the last second, milliseconds.
    pub late_max_ms: f32,
}

/// A fleet of real processes.
pub struct Fleet {
    launcher: Child,
    dir: PathBuf,
    observer: Observer,
    run: Run,
    before: Option<FleetView>,
    after: Option<FleetView>,
    browser: Option<browser::Browser>,
}

impl Fleet {
    /// Starts a fleet with the default configuration.
    pub fn start(robots: usize) -> Result<Self, Box<dyn Error>> {
        Self::start_with(robots, &[])
    }

    /// Starts a fleet with further arguments on the command line.
    pub fn start_with(robots: usize, words: &[&str]) -> Result<Self, Box<dyn Error>> {
        Self::start_command("up", robots, words)
    }

    /// Starts a fleet with another command, such as `demo`.
    pub fn start_command(command: &str, robots: usize, words: &[&str]) -> Result<Self, Box<dyn Error>> {
        let dir = std::env::temp_dir().join(format!("mr-slam-bench-{}", std::process::id()));
        let mut launcher = launcher::command(command)
            .args(["--port", "0", "--robots", &robots.to_string(), "--run-dir"])
            .arg(&dir)
            .args(words)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()?;
        launcher::wait_until_ready(&mut launcher)?;
        let run = Run::open(&dir)?;
        let observer = Observer::attach(&run, "jitter")?;
        let mut fleet = Self { launcher, dir, observer, run, before: None, after: None, browser: None };
        fleet.browser = browser::Browser::open_if_named(&fleet.run, &fleet.dir)?;
        Ok(fleet)
    }

    /// Connects a client, subscribes, and measures for `length` after `warm_up`.
    pub fn measure(&mut self, warm_up: Duration, length: Duration) -> Result<Figures, Box<dyn Error>> {
        (self.before, self.after) = (None, None);
        let _punctual = Punctual::begin();
        let mut stream = TcpStream::connect(("127.0.0.1", self.run.port))?;
        stream.set_nodelay(true)?;
        stream.write_all(&registrations(&self.run))?;
        let mut parser = Parser::new(FRAME_MAX);
        let mut received_streams = ReceivedStreams::new();
        let begun = Instant::now();
        while begun.elapsed() < warm_up + length {
            let count = stream.read(parser.space())?;
            let received = now().0;
            if count == 0 {
                return Err("the bridge closed the connection".into());
            }
            parser.filled(count);
            while let Some(frame) = parser.next_frame()? {
                if begun.elapsed() >= warm_up {
                    received_streams.record(&frame, received);
                }
            }
            self.observe(begun.elapsed() >= warm_up);
        }
        let ReceivedStreams { tf, clock, scans } = &received_streams;
        Ok(Figures { tf: tf.spread(), clock: clock.spread(), scans: scans.spread() })
    }

    /// Returns the run of the fleet.
    #[allow(dead_code, reason = "other benches attach to it")]
    pub fn run(&self) -> &Run {
        &self.run
    }

    /// Returns the id of a process by the newest statistics.
    #[allow(dead_code, reason = "other benches look at its memory")]
    pub fn pid(&mut self, process: &str) -> Option<u32> {
        self.observer.wait(Duration::from_secs(3));
        let view = FleetView::new(self.observer.stats()?);
        view.processes.iter().find(|known| known.process == process).map(|known| known.pid)
    }

    /// Returns the resident memory of the bridge and of all other processes together, MB.
    #[allow(dead_code, reason = "the soak looks at it")]
    pub fn memory_mb(&mut self) -> (f64, f64) {
        self.observer.wait(Duration::from_secs(3));
        let view = self.observer.stats().map(FleetView::new);
        let (mut bridge, mut others) = (0.0, 0.0);
        for process in view.iter().flat_map(|view| &view.processes) {
            *if process.process == "bridge" { &mut bridge } else { &mut others } += process.memory_mb;
        }
        (bridge, others)
    }

    /// Returns a process by the newest statistics.
    #[allow(dead_code, reason = "the soak looks at the recorder")]
    pub fn process(&mut self, process: &str) -> Option<reports::ProcessView> {
        self.observer.wait(Duration::from_secs(3));
        let view = FleetView::new(self.observer.stats()?);
        view.processes.into_iter().find(|known| known.process == process)
    }

    fn observe(&mut self, measuring: bool) {
        if self.observer.poll()
            && let Some(stats) = self.observer.stats()
        {
            let view = FleetView::new(stats);
            if measuring && self.before.is_none() {
                self.before = Some(view);
            } else if measuring {
                self.after = Some(view);
            }
        }
    }

    /// Returns the figures at the begin and at the end of the measurement.
    #[allow(dead_code, reason = "the fleet bench looks at more than jitter")]
    pub fn views(&self) -> Option<(&FleetView, &FleetView)> {
        Some((self.before.as_ref()?, self.after.as_ref()?))
    }

    /// Returns the processor time and punctuality of each process during the measurement.
    pub fn processes(&self) -> Vec<Cpu> {
        let (Some(before), Some(after)) = (&self.before, &self.after) else { return Vec::new() };
        let seconds = (after.time_s - before.time_s).max(1e-9);
        let pairs = before.processes.iter().zip(&after.processes);
        let cpu = |(then, now): (&reports::ProcessView, &reports::ProcessView)| Cpu {
            process: now.process.clone(),
            percent: 100.0 * (now.cpu_s - then.cpu_s) / seconds,
            late_p50_ms: now.late_p50_us * 1e-3,
            late_max_ms: now.late_max_us * 1e-3,
        };
        pairs.map(cpu).collect()
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        drop(self.browser.take());
        launcher::terminate(&self.launcher);
        let _ = self.launcher.wait();
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

fn registrations(run: &Run) -> Vec<u8> {
    let mut out = bridge::frame::KEEPALIVE.to_vec();
    let mut subscribe = |topic: String, message_name: &str| {
        let body = Registration { topic, message_name: message_name.into(), ..Registration::default() };
        Side::Client.write_command(&mut out, name::SUBSCRIBE, &body);
    };
    subscribe("/tf".into(), "tf2_msgs/TFMessage");
    subscribe("/clock".into(), "rosgraph_msgs/Clock");
    for robot in run.robots() {
        subscribe(format!("/{robot}/scan"), "sensor_msgs/LaserScan");
        subscribe(format!("/{robot}/map"), "nav_msgs/OccupancyGrid");
    }
    subscribe("/merged_map".into(), "nav_msgs/OccupancyGrid");
    out
}

/// Jitter of the streams that the client receives.
struct ReceivedStreams {
    tf: Streams,
    clock: Streams,
    scans: Streams,
}

impl ReceivedStreams {
    fn new() -> Self {
        let ms = 1_000_000;
        Self { tf: Streams::new(50 * ms), clock: Streams::new(10 * ms), scans: Streams::new(100 * ms) }
    }

    fn record(&mut self, frame: &RosTcpFrame<'_>, received_ns: u64) {
        match frame.name {
            b"/tf" => {
                let Ok(message) = ros::decode::<ros::TfMessage>(frame.payload) else { return };
                for transform in &message.transforms {
                    // The transforms of SLAM and merging have other rates than the robots' links.
                    if !transform.child_frame_id.starts_with("odom")
                        && !transform.child_frame_id.starts_with("map")
                    {
                        self.tf.record(&transform.child_frame_id, transform.stamp.0, received_ns);
                    }
                }
            }
            b"/clock" => {
                let Ok(message) = ros::decode::<ros::Clock>(frame.payload) else { return };
                self.clock.record("clock", message.clock.0, received_ns);
            }
            topic if topic.ends_with(b"/scan") => {
                let Ok(message) = ros::decode::<ros::LaserScan>(frame.payload) else { return };
                self.scans.record(&String::from_utf8_lossy(topic), message.stamp.0, received_ns);
            }
            _ => {}
        }
    }
}
