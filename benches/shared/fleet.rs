//! A fleet that a bench starts and looks at: its processes, figures and maps.

use crate::launcher;
use crate::map_cells::{Cells, known_cells};
use mr_slam::channel::{self, Channel, Opener, Program};
use mr_slam::observer::Observer;
use mr_slam::ports::ReadMapPort;
use mr_slam::progress::{ProgressBoard, WatchedThread};
use mr_slam::run::Run;
use mr_slam::shared_memory::Participant;
use msg::{DenseMap, PatchHeader, RobotId};
use reports::FleetView;
use rustix::process::{Pid, Signal, kill_process};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for a fleet, for a process, and for a map.
pub const PATIENCE: Duration = Duration::from_secs(20);
/// Time between two looks at processes and maps.
pub const LOOK_PERIOD: Duration = Duration::from_millis(20);

/// A process of the fleet, or its operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Process {
    /// Name, such as `slam of robot1`.
    pub name: String,
    /// Its robot, if it has one.
    pub robot: Option<RobotId>,
    /// Id of the operating system.
    pub pid: u32,
}

/// A fleet, which ends with the bench.
pub struct Fleet {
    launcher: Child,
    /// Folder of the run.
    pub dir: PathBuf,
    /// The run.
    pub run: Run,
    /// TCP port for clients.
    pub port: u16,
    /// Reader of figures and maps.
    pub observer: Observer,
}

impl Fleet {
    /// Starts `mr-slam COMMAND --robots N WORDS` with a folder of its own, which is removed at its end.
    pub fn start(command: &str, robots: usize, words: &[&str]) -> Result<Self, Box<dyn Error>> {
        let dir = std::env::temp_dir().join(format!("mr-slam-bench-{}", std::process::id()));
        Self::start_in(&dir, command, robots, words)
    }

    /// Starts a fleet in this folder.
    pub fn start_in(
        dir: &Path,
        command: &str,
        robots: usize,
        words: &[&str],
    ) -> Result<Self, Box<dyn Error>> {
        let mut launcher = launcher::command(command)
            .args(["--port", "0", "--page", "0", "--robots", &robots.to_string(), "--run-dir"])
            .arg(dir)
            .args(words)
            .env("XDG_STATE_HOME", dir.join("state"))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()?;
        if let Err(why) = launcher::wait_until_ready(&mut launcher) {
            launcher.wait()?;
            return Err(why.into());
        }
        let run = Run::open(dir)?;
        let observer = Observer::attach(&run, "bench")?;
        Ok(Self { launcher, dir: dir.to_owned(), port: run.port, run, observer })
    }

    /// Returns the newest figures; waits for the first ones.
    pub fn view(&mut self) -> Result<FleetView, Box<dyn Error>> {
        let begun = Instant::now();
        loop {
            self.observer.wait(Duration::from_secs(2));
            match self.observer.stats() {
                Some(stats) => return Ok(FleetView::new(stats)),
                None if begun.elapsed() > PATIENCE => return Err("telemetry sent no figures".into()),
                None => {}
            }
        }
    }

    /// Returns the id of the launcher.
    pub fn launcher(&self) -> u32 {
        self.launcher.id()
    }

    /// Returns every process whose main loop has run, and the operator of `demo`.
    pub fn processes(&self) -> Vec<Process> {
        let rows: Vec<_> = self.run.config.processes().collect();
        let Ok(mut board) = ProgressBoard::open(&self.run.domain, rows.len()) else { return Vec::new() };
        if board.read().is_err() {
            return Vec::new();
        }
        let process = |(index, (row, robot)): (usize, _)| {
            let (row, robot): (&mr_slam::processes::ProcessRow, Option<RobotId>) = (row, robot);
            // The main thread's id is the process's.
            let pid = board.entry(index, WatchedThread::Main).thread;
            (pid != 0).then(|| Process { name: row.title(robot), robot, pid })
        };
        let workers: Vec<Process> = rows.into_iter().enumerate().filter_map(process).collect();
        let operator = children(self.launcher())
            .into_iter()
            .find(|pid| words_of(*pid).iter().any(|word| word == "operator"))
            .map(|pid| Process { name: "operator".into(), robot: None, pid });
        workers.into_iter().chain(operator).collect()
    }

    /// Returns the process of this name; `None` while it is not working.
    pub fn process(&self, name: &str) -> Option<Process> {
        self.processes().into_iter().find(|process| process.name == name)
    }

    /// Waits until a process of this name works that is not `before`.
    pub fn wait_for_other(&self, name: &str, before: Option<u32>) -> Result<u32, Box<dyn Error>> {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            if let Some(process) = self.process(name).filter(|process| Some(process.pid) != before) {
                return Ok(process.pid);
            }
            std::thread::sleep(LOOK_PERIOD);
        }
        Err(format!("no {name} within {PATIENCE:?}").into())
    }

    /// Reads a robot's map, or the merged map, from the process that writes it now, until `is_enough`.
    pub fn cells(
        &self,
        robot: Option<RobotId>,
        is_enough: impl Fn(&Cells) -> bool,
    ) -> Result<Cells, Box<dyn Error>> {
        let channel: Channel<PatchHeader> = robot.map_or_else(channel::merged_map, channel::map);
        let participant =
            Participant::open(&self.run.domain, Opener::of_fleet(Program::Launcher), "bench-map")?;
        let mut reader = participant.map_reader(&channel)?;
        let begun = Instant::now();
        loop {
            reader.poll();
            let mut map = DenseMap::default();
            let cells = match reader.map().tiles().next() {
                Some(_) => known_cells(&map.update(reader.map())),
                None => Cells::new(),
            };
            if is_enough(&cells) || begun.elapsed() > PATIENCE {
                return Ok(cells);
            }
            std::thread::sleep(LOOK_PERIOD);
        }
    }

    /// Asks the fleet to end and waits for it; returns whether it succeeded.
    pub fn end(&mut self) -> bool {
        launcher::terminate(&self.launcher);
        let begun = Instant::now();
        while matches!(self.launcher.try_wait(), Ok(None)) && begun.elapsed() < PATIENCE {
            std::thread::sleep(LOOK_PERIOD);
        }
        // It has ended, unless it hangs.
        let _ = self.launcher.kill();
        self.launcher.wait().is_ok_and(|status| status.success())
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.end();
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

/// Returns the children of a process.
pub fn children(pid: u32) -> Vec<u32> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap_or_default();
    text.split_whitespace().filter_map(|pid| pid.parse().ok()).collect()
}

/// Returns the words of a process's command line.
pub fn words_of(pid: u32) -> Vec<String> {
    let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    line.split(|byte| *byte == 0).map(|word| String::from_utf8_lossy(word).into_owned()).collect()
}

/// Sends a signal to a process if it exists.
pub fn send(pid: u32, signal: Signal) {
    if let Some(pid) = Pid::from_raw(pid as i32) {
        let _ = kill_process(pid, signal);
    }
}
