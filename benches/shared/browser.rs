//! A browser with the operator's page, beside a fleet that is measured.

use mr_slam::control::{self, Request};
use mr_slam::run::Run;
use std::error::Error;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Environment variable that names the browser's program, such as `chromium`. Without it none is started.
const BROWSER: &str = "MR_SLAM_BENCH_BROWSER";
/// Longest time until the bridge knows of a client that came, at the lowest priority, or went.
const PATIENCE: Duration = Duration::from_secs(60);

/// A browser, which is killed when this is dropped.
pub struct Browser(Child);

impl Browser {
    /// Opens the page of a run in the browser that [`BROWSER`] names, if it does.
    pub fn open_if_named(run: &Run, folder: &Path) -> Result<Option<Self>, Box<dyn Error>> {
        let program = std::env::var_os(BROWSER).filter(|name| !name.is_empty());
        program.map(|program| Self::open(&program, run, folder)).transpose()
    }

    /// Opens the page of a run in a browser, and waits until it is connected.
    ///
    /// It runs at the lowest priority (`SCHED_IDLE`), so that it draws with what the fleet leaves: an operator's browser draws on
    /// another machine. What the bridge does for it is the same.
    pub fn open(program: &OsStr, run: &Run, folder: &Path) -> Result<Self, Box<dyn Error>> {
        let clients_before = readers(run);
        let url = format!("http://localhost:{}/", run.config.bridge.page.port);
        let mut profile = OsString::from("--user-data-dir=");
        profile.push(folder.join("browser"));
        let child = Command::new("chrt")
            .args(["--idle", "0"])
            .arg(program)
            .args(["--headless=new", "--no-sandbox", "--window-size=1280,800"])
            .args([profile, url.into()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|why| format!("{}: {why}", program.to_string_lossy()))?;
        let browser = Self(child);
        wait_for_readers(run, clients_before + 1)
            .map_err(|why| format!("{} has not opened the page: {why}", program.to_string_lossy()))?;
        Ok(browser)
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns the number of clients that read from the bridge.
fn readers(run: &Run) -> usize {
    let state = control::ask(run, Request::State, Duration::from_secs(1));
    state.map_or(0, |state| state.clients.iter().filter(|client| client.subscriptions > 0).count())
}

/// Waits until this many clients read from the bridge.
pub fn wait_for_readers(run: &Run, count: usize) -> Result<(), Box<dyn Error>> {
    let begun = Instant::now();
    while readers(run) != count {
        if begun.elapsed() > PATIENCE {
            return Err(format!("{} clients read from the bridge, expected {count}", readers(run)).into());
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    Ok(())
}
