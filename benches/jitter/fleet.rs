//! The fleet under measurement, and a client that reads it as a headset does.

use crate::measure::{Figures, Streams};
use bridge::command::{Registration, name};
use bridge::frame::{Frame, Parser, Side};
use bridge::ros;
use mr_slam::clock::now;
use mr_slam::observer::Observer;
use mr_slam::run::Run;
use mr_slam::view::FleetView;
use serde::Serialize;
use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Larger than any frame of a fleet in the laboratory.
const FRAME_MAX: usize = 16 << 20;

/// One process's share of the machine.
#[derive(Clone, Debug, Serialize)]
pub struct Cpu {
    /// `bridge`, `sim of robot1` ...
    pub process: String,
    /// Of one core, over the measurement.
    pub percent: f64,
    /// How late its ticks began, median of the last second.
    pub late_p50_ms: f32,
    /// The latest of the last second.
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
}

impl Fleet {
    /// Launches it.
    pub fn start(robots: usize) -> Result<Self, Box<dyn Error>> {
        Self::start_with(robots, &[])
    }

    /// The same with further words on the command line.
    pub fn start_with(robots: usize, words: &[&str]) -> Result<Self, Box<dyn Error>> {
        let dir = std::env::temp_dir().join(format!("mr-slam-bench-{}", std::process::id()));
        let mut launcher = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
            .args(["up", "--port", "0", "--robots", &robots.to_string(), "--run-dir"])
            .arg(&dir)
            .args(words)
            .stderr(Stdio::piped())
            .spawn()?;
        let mut said = BufReader::new(launcher.stderr.take().ok_or("no stderr")?);
        let mut line = String::new();
        said.read_line(&mut line)?;
        // Nobody reads the rest; the pipe must not fill.
        std::thread::spawn(move || said.lines().for_each(drop));
        let run = Run::open(&dir).map_err(|why| format!("{why}; the launcher said: {line}"))?;
        let observer = Observer::attach(&run, "jitter")?;
        Ok(Self { launcher, dir, observer, run, before: None, after: None })
    }

    /// Attaches, subscribes, and reads.
    pub fn measure(&mut self, warm_up: Duration, length: Duration) -> Result<Figures, Box<dyn Error>> {
        (self.before, self.after) = (None, None);
        let mut stream = TcpStream::connect(("127.0.0.1", self.run.port))?;
        stream.set_nodelay(true)?;
        stream.write_all(&registrations(&self.run))?;
        let mut parser = Parser::new(FRAME_MAX);
        let mut ears = Ears::new();
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
                    ears.hear(&frame, received);
                }
            }
            self.observe(begun.elapsed() >= warm_up);
        }
        Ok(Figures { tf: ears.tf.spread(), clock: ears.clock.spread(), scans: ears.scans.spread() })
    }

    /// The run.
    #[allow(dead_code, reason = "other benches attach to it")]
    pub fn run(&self) -> &Run {
        &self.run
    }

    /// A process's id, by the newest figures.
    #[allow(dead_code, reason = "other benches look at its memory")]
    pub fn pid(&mut self, process: &str) -> Option<u32> {
        self.observer.wait(Duration::from_secs(3));
        let view = FleetView::new(self.observer.stats()?);
        view.processes.iter().find(|known| known.process == process).map(|known| known.pid)
    }

    /// Resident megabytes of the bridge, and of all other processes together.
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

    /// What each process took of the machine while measuring.
    pub fn processes(&self) -> Vec<Cpu> {
        let (Some(before), Some(after)) = (&self.before, &self.after) else { return Vec::new() };
        let seconds = (after.time_s - before.time_s).max(1e-9);
        let pairs = before.processes.iter().zip(&after.processes);
        let cpu = |(then, now): (&mr_slam::view::ProcessView, &mr_slam::view::ProcessView)| Cpu {
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
        if let Some(pid) = rustix::process::Pid::from_raw(self.launcher.id() as i32) {
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
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

/// What the client hears.
struct Ears {
    tf: Streams,
    clock: Streams,
    scans: Streams,
}

impl Ears {
    fn new() -> Self {
        let ms = 1_000_000;
        Self { tf: Streams::new(50 * ms), clock: Streams::new(10 * ms), scans: Streams::new(100 * ms) }
    }

    fn hear(&mut self, frame: &Frame<'_>, received_ns: u64) {
        match frame.name {
            b"/tf" => {
                let Ok(message) = ros::decode::<ros::TfMessage>(frame.payload) else { return };
                for transform in &message.transforms {
                    // What SLAM and merging say has other rates than the robots' links.
                    if !transform.child_frame_id.starts_with("odom")
                        && !transform.child_frame_id.starts_with("map")
                    {
                        self.tf.note(&transform.child_frame_id, transform.stamp.0, received_ns);
                    }
                }
            }
            b"/clock" => {
                let Ok(message) = ros::decode::<ros::Clock>(frame.payload) else { return };
                self.clock.note("clock", message.clock.0, received_ns);
            }
            topic if topic.ends_with(b"/scan") => {
                let Ok(message) = ros::decode::<ros::LaserScan>(frame.payload) else { return };
                self.scans.note(&String::from_utf8_lossy(topic), message.stamp.0, received_ns);
            }
            _ => {}
        }
    }
}
