//! A fleet to test: the real binary, in a folder and on a port of its own.

use mr_slam::observer::Observer;
use mr_slam::run::Run;
use mr_slam::view::{FleetView, ProcessView};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// No step of a test takes this long unless it hangs.
pub const WATCHDOG: Duration = Duration::from_secs(120);

/// The binary under test.
pub fn mr_slam() -> Command {
    Command::new(env!("CARGO_BIN_EXE_mr-slam"))
}

/// A folder of this test's own, removed with it.
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

/// A launcher that does not outlive its test.
struct Launcher(Child);

impl Drop for Launcher {
    fn drop(&mut self) {
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

/// What a fleet left behind.
pub struct Ended {
    pub success: bool,
    pub took: Duration,
    pub run: Run,
    pub folder: Folder,
}

impl Fleet {
    /// `mr-slam COMMAND --port 0 ARGS`, up and known to be.
    pub fn start(command: &str, args: &[&str]) -> Self {
        let folder = Folder::new();
        let mut child = mr_slam()
            .args([command, "--port", "0", "--run-dir"])
            .arg(folder.path())
            .args(args)
            // Whom these fleets let in is not for the person's own to remember.
            .env("XDG_STATE_HOME", folder.path().join("state"))
            .stdin(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        let launcher = Launcher(child);
        // The launcher's first line comes when the run's folder is complete.
        let mut line = String::new();
        said.read_line(&mut line).unwrap();
        assert!(line.starts_with("fleet of"), "the launcher said: {line}");
        std::thread::spawn(move || said.lines().map_while(Result::ok).for_each(|line| eprintln!("{line}")));
        let run = Run::open(folder.path()).unwrap();
        let observer = Observer::attach(&run, "test").unwrap();
        Self { launcher, run, observer, folder }
    }

    /// Watches the fleet's figures, second by second, until they are as wished.
    pub fn until(&mut self, what: &str, mut wish: impl FnMut(&FleetView) -> bool) -> FleetView {
        let begun = Instant::now();
        let mut newest = None;
        while begun.elapsed() < WATCHDOG {
            if self.observer.wait(Duration::from_secs(1)) {
                let view = FleetView::new(self.observer.stats().unwrap());
                if wish(&view) {
                    return view;
                }
                newest = Some(view);
            }
            let lives = matches!(self.launcher.0.try_wait(), Ok(None));
            assert!(lives, "the launcher ended while waiting for {what}");
        }
        panic!("no {what} within {WATCHDOG:?}; newest figures: {newest:#?}");
    }

    /// Asks the launcher to end, as Ctrl-C or `kill` would.
    pub fn end(self, signal: Signal) -> Ended {
        send(self.launcher.0.id(), signal);
        self.wait()
    }

    /// Waits for the launcher to end.
    pub fn wait(self) -> Ended {
        let begun = Instant::now();
        let Self { mut launcher, run, observer, folder } = self;
        drop(observer);
        let status = launcher.0.wait().unwrap();
        Ended { success: status.success(), took: begun.elapsed(), run, folder }
    }
}

/// A process of a fleet, by the name that figures give it.
pub fn process<'a>(view: &'a FleetView, name: &str) -> Option<&'a ProcessView> {
    view.processes.iter().find(|process| process.process == name)
}

/// What one run of the binary said.
pub fn output(args: &[&str]) -> Output {
    mr_slam().args(args).stdin(Stdio::null()).output().unwrap()
}

/// Sends a signal to a process, if it lives.
pub fn send(pid: u32, signal: Signal) {
    if let Some(pid) = Pid::from_raw(pid as i32) {
        let _ = kill_process(pid, signal);
    }
}
