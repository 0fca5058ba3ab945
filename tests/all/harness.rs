//! A fleet under test: the real binary, with a folder and a port of its own.

use mr_slam::observer::Observer;
use mr_slam::run::Run;
use reports::{FleetView, ProcessView};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Time limit of every wait of a test. A step that takes longer hangs.
pub const WATCHDOG: Duration = Duration::from_secs(120);

/// Returns a command that runs the binary under test.
pub fn mr_slam() -> Command {
    Command::new(env!("CARGO_BIN_EXE_mr-slam"))
}

/// A folder of one test, removed at its end.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("mr-slam-test-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    pub fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, content).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Time limit of one command. Some simulate minutes, which takes long on a busy machine.
const COMMAND_LIMIT: Duration = Duration::from_secs(600);

/// Kills a process after a time limit unless it is dropped before, so that no wait for the process can hang.
struct KillAfter(Option<std::sync::mpsc::Sender<()>>);

impl KillAfter {
    fn new(pid: u32, limit: Duration) -> Self {
        let (ended, wait) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            if wait.recv_timeout(limit) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
                send(pid, Signal::KILL);
            }
        });
        Self(Some(ended))
    }
}

impl Drop for KillAfter {
    fn drop(&mut self) {
        drop(self.0.take());
    }
}

/// The launcher's process, which ends with its test.
struct Launcher(Child);

impl Drop for Launcher {
    fn drop(&mut self) {
        let _limit = KillAfter::new(self.0.id(), WATCHDOG);
        send(self.0.id(), Signal::TERM);
        let _ = self.0.wait();
    }
}

/// A running fleet.
pub struct Fleet {
    launcher: Launcher,
    pub run: Run,
    pub observer: Observer,
    pub folder: Folder,
}

/// The end of a fleet, with the run and the folder that it leaves.
pub struct Ended {
    pub success: bool,
    pub took: Duration,
    pub run: Run,
    pub folder: Folder,
}

impl Fleet {
    /// Starts `mr-slam COMMAND --port 0 ARGS` and waits until its run folder is complete.
    pub fn start(command: &str, args: &[&str]) -> Self {
        Self::start_program(Path::new(env!("CARGO_BIN_EXE_mr-slam")), command, args)
    }

    /// The same with the program of another file.
    pub fn start_program(program: &Path, command: &str, args: &[&str]) -> Self {
        let folder = Folder::new();
        let mut child = Command::new(program)
            .args([command, "--port", "0", "--run-dir"])
            .arg(folder.path())
            .args(args)
            // The clients that these fleets allow must not enter the user's own list.
            .env("XDG_STATE_HOME", folder.path().join("state"))
            .stdin(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut messages = BufReader::new(child.stderr.take().unwrap());
        let launcher = Launcher(child);
        // The launcher prints this line when the run's folder is complete. It may first remove what killed fleets left.
        let mut line = String::new();
        let limit = KillAfter::new(launcher.0.id(), WATCHDOG);
        while messages.read_line(&mut line).unwrap() > 0 && line.contains("removed what a fleet had left") {
            line.clear();
        }
        drop(limit);
        assert!(line.starts_with("fleet of"), "the launcher printed: {line}");
        std::thread::spawn(move || {
            messages.lines().map_while(Result::ok).for_each(|line| eprintln!("{line}"))
        });
        let run = Run::open(folder.path()).unwrap();
        let observer = Observer::attach(&run, "test").unwrap();
        Self { launcher, run, observer, folder }
    }

    /// Waits until the fleet's statistics meet a condition, and returns them.
    pub fn until(&mut self, what: &str, mut condition: impl FnMut(&FleetView) -> bool) -> FleetView {
        let begun = Instant::now();
        let mut newest = None;
        while begun.elapsed() < WATCHDOG {
            if self.observer.wait(Duration::from_secs(1)) {
                let view = FleetView::new(self.observer.stats().unwrap());
                if condition(&view) {
                    return view;
                }
                newest = Some(view);
            }
            let lives = matches!(self.launcher.0.try_wait(), Ok(None));
            assert!(lives, "the launcher ended during the wait for {what}");
        }
        panic!("no {what} within {WATCHDOG:?}; newest statistics: {newest:#?}");
    }

    /// Ends the launcher with a signal, as Ctrl-C or `kill` does, and waits for it.
    pub fn end(self, signal: Signal) -> Ended {
        send(self.launcher.0.id(), signal);
        self.wait()
    }

    /// Kills the launcher, which then leaves its files behind, and waits until its processes have ended.
    pub fn kill(mut self) -> Ended {
        let view = self.until("processes", |view| !view.processes.is_empty());
        send(self.launcher.0.id(), Signal::KILL);
        let begun = Instant::now();
        let lives = |pid: u32| Path::new(&format!("/proc/{pid}")).exists();
        while view.processes.iter().any(|process| lives(process.pid)) {
            assert!(begun.elapsed() < WATCHDOG, "processes outlive their launcher: {view:#?}");
            std::thread::sleep(Duration::from_millis(20));
        }
        self.wait()
    }

    /// Waits until the launcher ends.
    pub fn wait(self) -> Ended {
        let begun = Instant::now();
        let Self { mut launcher, run, observer, folder } = self;
        drop(observer);
        let limit = KillAfter::new(launcher.0.id(), WATCHDOG);
        let status = launcher.0.wait().unwrap();
        drop(limit);
        Ended { success: status.success(), took: begun.elapsed(), run, folder }
    }
}

/// Finds a process of a fleet that has reported by its name in the statistics.
pub fn process<'a>(view: &'a FleetView, name: &str) -> Option<&'a ProcessView> {
    view.processes.iter().find(|process| process.process == name && process.pid != 0)
}

/// Runs the binary and returns its output.
pub fn output(args: &[&str]) -> Output {
    output_of(mr_slam().args(args))
}

/// Runs a command and returns its output. A command that hangs is killed.
pub fn output_of(command: &mut Command) -> Output {
    let command = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    let _limit = KillAfter::new(child.id(), COMMAND_LIMIT);
    child.wait_with_output().unwrap()
}

/// Sends a signal to a process if it exists.
pub fn send(pid: u32, signal: Signal) {
    if let Some(pid) = Pid::from_raw(pid as i32) {
        let _ = kill_process(pid, signal);
    }
}
