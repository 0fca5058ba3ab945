//! Launchers of robots and bases with their runs, which end with the test.

use mr_slam::control::{self, Request};
use mr_slam::observer::Observer;
use mr_slam::run::Run;
use msg::{GridView, VelocityCommand};
use operator::client::Client;
use ros_messages::Twist;
use rustix::process::{Pid, Signal, kill_process};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest wait for anything that is expected.
pub const LIMIT: Duration = Duration::from_secs(90);
/// Period at which a condition is looked at.
const POLL: Duration = Duration::from_millis(50);

/// Tests that run at once: each has fleets of its own, which wait for one another most of the time.
const AT_ONCE: usize = 2;

/// Folder of a test, and its turn.
pub struct TestFolder {
    folder: tempfile::TempDir,
    _turn: MutexGuard<'static, ()>,
}

impl TestFolder {
    /// Waits for the tests before, and makes a folder.
    pub fn new() -> Self {
        static TURNS: [Mutex<()>; AT_ONCE] = [const { Mutex::new(()) }; AT_ONCE];
        static TESTS: AtomicUsize = AtomicUsize::new(0);
        let test = TESTS.fetch_add(1, Ordering::Relaxed);
        // A test that failed has ended as well.
        let turn = TURNS[test % AT_ONCE].lock().unwrap_or_else(PoisonError::into_inner);
        Self { folder: tempfile::tempdir().unwrap(), _turn: turn }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Waits until `condition` returns a value.
pub fn until<T>(what: &str, limit: Duration, mut condition: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = condition() {
            return found;
        }
        assert!(begun.elapsed() < limit, "{what}: not within {limit:?}");
        std::thread::sleep(POLL);
    }
}

/// Cells of a map by their places on its lattice.
pub type Cells = BTreeMap<(i64, i64), i8>;

/// Returns the known cells of a grid.
pub fn known_cells(map: GridView<'_>) -> Cells {
    let header = map.header;
    let corner = [header.origin.x_m, header.origin.y_m].map(|m| (m / header.resolution_m).round() as i64);
    let width = (header.width as usize).max(1);
    let known = map.cells.iter().enumerate().filter(|(_, cell)| **cell != msg::grid::UNKNOWN);
    let place = |index: usize| (corner[0] + (index % width) as i64, corner[1] + (index / width) as i64);
    known.map(|(index, cell)| (place(index), *cell)).collect()
}

/// A launcher with its run.
pub struct Fleet {
    launcher: Child,
    pub run: Run,
    observer: Observer,
    /// Endpoint of the base.
    pub endpoint: String,
    /// What launcher and link have said.
    said: Arc<Mutex<Vec<String>>>,
}

fn with_args(mut command: Command, folder: &Path, args: &[&str]) -> Command {
    command.args(args).env("XDG_STATE_HOME", folder.join("state"));
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_mr-slam"))
}

/// A process that is killed when it is dropped.
pub struct Ended {
    process: Child,
    log: PathBuf,
}

impl Ended {
    /// Starts a process.
    pub fn start(folder: &Path, args: &[&str]) -> Self {
        let log = folder.join(format!("{}.log", args[0]));
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&log).unwrap();
        Self { process: with_args(program(), folder, args).stderr(file).spawn().unwrap(), log }
    }

    /// Returns how it ended, if it has.
    pub fn exit(&mut self) -> Option<ExitStatus> {
        self.process.try_wait().unwrap()
    }

    /// Returns whether it has said something with this text in it.
    pub fn has_said(&self, text: &str) -> bool {
        std::fs::read_to_string(&self.log).unwrap().contains(text)
    }
}

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Runs a command that must be refused, and returns what it says.
pub fn refused(folder: &Path, args: &[&str]) -> String {
    let output = with_args(program(), folder, args).output().unwrap();
    assert!(!output.status.success(), "{args:?} was accepted");
    String::from_utf8(output.stderr).unwrap()
}

/// Returns an endpoint of a free port of this machine.
pub fn endpoint(protocol: &str) -> String {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    format!("{protocol}/127.0.0.1:{port}")
}

/// Returns the arguments of a base for these robots.
pub fn base_args<'a>(names: &'a str, endpoint: &'a str) -> Vec<&'a str> {
    vec!["base", "--names", names, "--listen", endpoint]
}

/// Returns the arguments of a robot.
pub fn robot_args<'a>(name: &'a str, endpoint: &'a str) -> Vec<&'a str> {
    vec!["robot", "--name", name, "--base", endpoint]
}

/// Starts a base and a robot, `alice`.
pub fn start(folder: &Path) -> (Fleet, Fleet) {
    let endpoint = endpoint("tcp");
    let base = Fleet::start(folder, "base", &endpoint, &base_args("alice", &endpoint));
    let robot = Fleet::start(folder, "robot", &endpoint, &robot_args("alice", &endpoint));
    (base, robot)
}

/// Returns the number of the robot's known cells, if the base has all of them as they are.
pub fn caught_up(base: &mut Fleet, robot: &mut Fleet) -> Option<usize> {
    let (theirs, own) = (base.cells("robot1_map"), robot.cells("robot1_map"));
    (own.len() > 100 && theirs == own).then_some(own.len())
}

impl Fleet {
    /// Starts a launcher and waits until its fleet runs.
    pub fn start(folder: &Path, name: &str, endpoint: &str, args: &[&str]) -> Self {
        Self::start_command(program(), folder, name, endpoint, args)
    }

    /// Starts a launcher with a command that has no arguments yet.
    pub fn start_command(command: Command, folder: &Path, name: &str, endpoint: &str, args: &[&str]) -> Self {
        let dir = folder.join(name);
        let mut command = with_args(command, folder, args);
        command.args(["--port", "0", "--page", "off", "--run-dir"]).arg(&dir);
        let mut launcher = command.spawn().unwrap();
        let mut lines = BufReader::new(launcher.stderr.take().unwrap()).lines().map_while(Result::ok);
        let said: Arc<Mutex<Vec<String>>> = Arc::default();
        let (all, name) = (said.clone(), name.to_owned());
        std::thread::spawn(move || {
            lines.by_ref().for_each(|line| {
                eprintln!("{name}: {line}");
                all.lock().unwrap().push(line);
            });
        });
        let observer = until("the fleet runs", LIMIT, || {
            assert!(matches!(launcher.try_wait(), Ok(None)), "it ended: {:#?}", said.lock().unwrap());
            let run = Run::open_running(&dir).ok()?;
            control::ask(&run, Request::State, Duration::from_secs(2)).ok()?;
            Some((Observer::attach(&run, "test").ok()?, run))
        });
        let (observer, run) = observer;
        Self { launcher, run, observer, endpoint: endpoint.into(), said }
    }

    /// Returns whether launcher or link have said something with this text in it.
    pub fn has_said(&self, text: &str) -> bool {
        self.said.lock().unwrap().iter().any(|line| line.contains(text))
    }

    /// Returns the known cells of a map.
    pub fn cells(&mut self, map_name: &str) -> Cells {
        self.observer.poll();
        let mut cells = Cells::new();
        self.observer.show_maps(|name, map| {
            if name == map_name {
                cells = known_cells(map);
            }
        });
        cells
    }

    /// Returns whether the newest velocity on the channel to the robot is not zero.
    fn is_driven(&self) -> bool {
        let moves = |command: VelocityCommand| command.linear_m_s != 0.0 || command.angular_rad_s != 0.0;
        self.observer.command(0).is_some_and(|(command, _)| moves(command))
    }

    /// Returns whether the robot's bridge has it driving now.
    pub fn is_driving(&mut self) -> bool {
        self.observer.poll();
        self.is_driven()
    }

    /// Returns what has arrived at this fleet, as a launcher sees it. Only the bench needs it.
    #[allow(dead_code)]
    pub fn observer(&mut self) -> &mut Observer {
        self.observer.poll();
        &mut self.observer
    }

    /// Returns the launcher and all processes below it.
    pub fn processes(&self) -> Vec<Pid> {
        let mut found = vec![self.launcher.id()];
        let mut next = 0;
        while let Some(pid) = found.get(next).copied() {
            next += 1;
            let threads = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
            for thread in threads {
                let children = std::fs::read_to_string(thread.path().join("children")).unwrap_or_default();
                found.extend(children.split_whitespace().filter_map(|pid| pid.parse::<u32>().ok()));
            }
        }
        found.into_iter().filter_map(|pid| Pid::from_raw(pid as i32)).collect()
    }

    /// Kills all of its processes at once, as when its machine loses its power.
    pub fn kill(mut self) {
        let processes = self.processes();
        // The launcher first, so that it starts nothing again.
        for pid in processes {
            let _ = kill_process(pid, Signal::KILL);
        }
        let _ = self.launcher.wait();
        self.run.domain.remove();
    }

    /// Returns `Some` when at least 99 % of a robot's occupied cells are occupied in this fleet's merged map.
    pub fn merged_shows_all_of(&mut self, robot: &mut Self) -> Option<()> {
        let occupied = |cells: Cells| cells.into_iter().filter(|(_, cell)| *cell > 50).map(|(at, _)| at);
        let merged: Vec<(i64, i64)> = occupied(self.cells("merged_map")).collect();
        let own: Vec<(i64, i64)> = occupied(robot.cells("robot1_map")).collect();
        let shown = own.iter().filter(|at| merged.binary_search(at).is_ok()).count();
        (own.len() > 50 && shown * 100 >= own.len() * 99).then_some(())
    }

    /// Returns whether the emergency stop is set, if the bridge answers.
    pub fn is_stopped(&self) -> Option<bool> {
        control::ask(&self.run, Request::State, Duration::from_secs(2)).ok().map(|state| state.stopped)
    }

    /// Returns the process id of the link.
    fn link(&self) -> Option<Pid> {
        let launcher = self.launcher.id();
        let children = std::fs::read_to_string(format!("/proc/{launcher}/task/{launcher}/children")).ok()?;
        let is_link = |pid: &i32| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            line.split(|byte| *byte == 0).nth(1) == Some(b"link")
        };
        children.split_whitespace().filter_map(|pid| pid.parse().ok()).find(is_link).and_then(Pid::from_raw)
    }

    /// Stops the link's process, or lets it go on; the launcher, too, which would replace it.
    pub fn freeze_link(&self, is_frozen: bool) {
        let link = until("there is a link", LIMIT, || self.link());
        let signal = if is_frozen { Signal::STOP } else { Signal::CONT };
        let launcher = Pid::from_raw(self.launcher.id() as i32).unwrap();
        for process in if is_frozen { [launcher, link] } else { [link, launcher] } {
            kill_process(process, signal).unwrap();
        }
    }

    /// Kills the link's process, and waits for the next one.
    pub fn kill_link(&self) {
        let link = until("there is a link", LIMIT, || self.link());
        kill_process(link, Signal::KILL).unwrap();
        until("there is another link", LIMIT, || self.link().filter(|pid| *pid != link));
    }

    /// Drives a robot over this fleet's TCP port.
    pub fn drive(&mut self, name: &str, seconds: f64, linear: f64, angular: f64) {
        let begun = Instant::now();
        self.drive_until(name, linear, angular, || begun.elapsed().as_secs_f64() >= seconds);
    }

    /// Drives a robot over this fleet's TCP port, and returns whether its own bridge had it driving meanwhile.
    ///
    /// Afterwards is too late to look: the bridge sends zeros once nobody drives.
    pub fn drive_and_watch(
        &mut self,
        name: &str,
        seconds: f64,
        linear: f64,
        angular: f64,
        robot: &mut Self,
    ) -> bool {
        let begun = Instant::now();
        let mut was_driven = false;
        self.drive_until(name, linear, angular, || {
            was_driven |= robot.is_driving();
            begun.elapsed().as_secs_f64() >= seconds
        });
        was_driven
    }

    /// Drives a robot over this fleet's TCP port until `over` returns true.
    pub fn drive_until(&mut self, name: &str, linear: f64, angular: f64, mut over: impl FnMut() -> bool) {
        let mut client = Client::new(format!("127.0.0.1:{}", self.run.port));
        let topic = format!("/{name}/cmd_vel");
        let handle = client.handle();
        handle.advertise::<Twist>(&topic);
        let twist = Twist { linear: [linear, 0.0, 0.0], angular: [0.0, 0.0, angular] };
        while !over() {
            client.poll(Instant::now() + POLL, &mut |_| {});
            handle.publish(&topic, &twist);
        }
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        let _ = self.link().map(|link| kill_process(link, Signal::CONT));
        if let Some(pid) = Pid::from_raw(self.launcher.id() as i32) {
            let _ = kill_process(pid, Signal::TERM);
        }
        let begun = Instant::now();
        while matches!(self.launcher.try_wait(), Ok(None)) && begun.elapsed() < Duration::from_secs(10) {
            std::thread::sleep(POLL);
        }
        let _ = self.launcher.kill();
        let _ = self.launcher.wait();
    }
}
