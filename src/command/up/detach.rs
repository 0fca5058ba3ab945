//! Start of a fleet in the background: option `--detach` of `mr-slam up` and `mr-slam demo`.

use super::{UpError, page};
use crate::child_process::own_program;
use crate::command::output;
use crate::progress::{ProgressBoard, WatchedThread};
use crate::run::{self, Run};
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Longest wait until the fleet in the background works: a slow disk may take its time.
const START_WAIT_MAX: Duration = Duration::from_secs(60);
/// Period at which its start is polled.
const START_POLL: Duration = Duration::from_millis(50);
/// Part of the log that is shown if it does not start, bytes.
const WORDS_MAX: u64 = 2000;

/// Starts this program again in the background with the same options, and says how to end it.
pub(super) fn start(dir: &Path) -> Result<(), UpError> {
    let dir = run::create_folder(dir)?;
    let log_path = dir.join("launcher.log");
    let mut options = OpenOptions::new();
    options.create(true).append(true).mode(0o600).custom_flags(rustix::fs::OFlags::NOFOLLOW.bits() as i32);
    let log = options.open(&log_path)?;
    let log_begin = log.metadata()?.len();
    let mut child = own_program()
        .args(std::env::args_os().skip(1))
        .arg("--in-background")
        .arg("--run-dir")
        .arg(&dir)
        .stdin(Stdio::null())
        .stdout(log.try_clone()?)
        .stderr(log)
        .spawn()?;
    let begun = Instant::now();
    loop {
        match Run::open_running(&dir) {
            Ok(run) if run.pid == child.id() && is_working(&run) => {
                let text = format!(
                    "fleet of {} robots in the background, process {}; headsets connect to port {}\n\
                     folder {}, log {}\nend it, with maps and report: kill {}\n",
                    run.config.fleet.robots,
                    run.pid,
                    run.port,
                    dir.display(),
                    log_path.display(),
                    run.pid
                );
                let page = page::describe(&run.config, None, false)
                    .iter()
                    .map(|line| format!("{line}\n"))
                    .collect::<String>();
                return Ok(output::print(&(text + &page))?);
            }
            _ => {}
        }
        match child.try_wait()? {
            Some(status) => {
                let words = end_of(&log_path, log_begin);
                return Err(UpError::Background { words, log: log_path, code: status.code() });
            }
            None if begun.elapsed() >= START_WAIT_MAX => {
                return Err(UpError::SlowStart { pid: child.id(), dir: dir.display().to_string() });
            }
            None => std::thread::sleep(START_POLL),
        }
    }
}

/// Returns whether a process of the fleet works.
fn is_working(run: &Run) -> bool {
    let slots = run.progress_slots();
    let read = |mut board: ProgressBoard| board.read().map(|()| board);
    let board = ProgressBoard::open(&run.domain, slots).and_then(read);
    board.is_ok_and(|board| (0..slots).any(|process| board.entry(process, WatchedThread::Main).count > 0))
}

/// Returns the end of a log from `begin` on.
fn end_of(log: &Path, begin: u64) -> String {
    let read = || -> std::io::Result<String> {
        let mut file = File::open(log)?;
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(begin.max(length.saturating_sub(WORDS_MAX))))?;
        let mut words = Vec::new();
        file.take(WORDS_MAX).read_to_end(&mut words)?;
        Ok(String::from_utf8_lossy(&words).trim_end().to_owned())
    };
    read().unwrap_or_default()
}
