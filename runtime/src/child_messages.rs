//! Messages that children print to standard error: the launcher shows them, and appends them to a log of bounded size.
//!
//! They come through a pipe. A child never waits for it: what does not fit, because the launcher is stopped, is lost, and what is
//! written after the launcher's death is an error that a child ignores.

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, PipeReader, PipeWriter, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::process::Command;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Longest line, bytes; a longer one is divided.
const LINE_MAX: u64 = 4096;
/// Lines that wait to be shown; further ones are in the log alone.
const LINES_MAX: usize = 256;
/// Size at which a log becomes the earlier one, bytes: some 40 000 lines.
const LOG_BYTES_MAX: u64 = 4 << 20;
/// Lines that are taken to be shown at once: who shows them has other work too.
const LINES_AT_ONCE: usize = 64;
/// Longest wait for the last lines after the children have ended: a loaded machine may be slow.
const LAST_LINES_WAIT: Duration = Duration::from_secs(5);

/// The end of the pipe that children inherit.
static WRITER: Mutex<Option<PipeWriter>> = Mutex::new(None);

fn set_writer(writer: Option<PipeWriter>) {
    *WRITER.lock().unwrap_or_else(PoisonError::into_inner) = writer;
}

/// Has a child print its messages into the pipe, if they are collected.
pub(crate) fn redirect(command: &mut Command) -> io::Result<()> {
    if let Some(writer) = &*WRITER.lock().unwrap_or_else(PoisonError::into_inner) {
        command.stderr(writer.try_clone()?);
    }
    Ok(())
}

/// The lines that the children of this process print.
pub struct ChildMessages {
    lines: Receiver<String>,
}

impl ChildMessages {
    /// Collects the messages of children that are started from now on, and appends them to a file.
    ///
    /// # Errors
    /// There is no pipe or no thread.
    pub fn collect(log: PathBuf) -> io::Result<Self> {
        let (reader, writer) = io::pipe()?;
        fcntl_setfl(&writer, fcntl_getfl(&writer)? | OFlags::NONBLOCK)?;
        let (sender, lines) = sync_channel(LINES_MAX);
        let read = move || read_lines(reader, Log::new(log), &sender);
        std::thread::Builder::new().name("messages".into()).spawn(read)?;
        set_writer(Some(writer));
        Ok(Self { lines })
    }

    /// Returns lines that have come, at most 64.
    pub fn received(&self) -> Vec<String> {
        self.lines.try_iter().take(LINES_AT_ONCE).collect()
    }

    /// Returns the last lines. Call it when all children have ended.
    pub fn end(self) -> Vec<String> {
        set_writer(None);
        std::iter::from_fn(|| self.lines.recv_timeout(LAST_LINES_WAIT).ok()).collect()
    }
}

impl Drop for ChildMessages {
    fn drop(&mut self) {
        set_writer(None);
    }
}

/// Reads lines until no child has the pipe any more.
fn read_lines(from: PipeReader, mut log: Log, to: &SyncSender<String>) {
    let mut from = BufReader::new(from);
    loop {
        let mut line = Vec::new();
        match from.by_ref().take(LINE_MAX).read_until(b'\n', &mut line) {
            Ok(1..) => {}
            Ok(0) | Err(_) => return,
        }
        let text = String::from_utf8_lossy(&line).trim_end_matches(['\n', '\r']).to_owned();
        log.append(&text);
        // A launcher that does not look has the log.
        let _ = to.try_send(text);
    }
}

/// A log of bounded size, and the one before it.
struct Log {
    path: PathBuf,
    /// `None`: it is not open.
    file: Option<File>,
}

impl Log {
    fn new(path: PathBuf) -> Self {
        Self { path, file: None }
    }

    /// Appends a line. On a full disk it is lost; the next one is tried anew.
    fn append(&mut self, line: &str) {
        if self
            .file
            .as_ref()
            .and_then(|file| file.metadata().ok())
            .is_some_and(|about| about.len() >= LOG_BYTES_MAX)
        {
            let mut earlier = self.path.clone().into_os_string();
            earlier.push(".earlier");
            if std::fs::rename(&self.path, earlier).is_err() {
                return;
            }
            self.file = None;
        }
        if self.file.is_none() {
            let mut options = OpenOptions::new();
            options.create(true).append(true).mode(0o600).custom_flags(OFlags::NOFOLLOW.bits() as i32);
            self.file = options.open(&self.path).ok();
        }
        let written = self.file.as_mut().map(|file| file.write_all(format!("{line}\n").as_bytes()));
        if !matches!(written, Some(Ok(()))) {
            self.file = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::child_process::spawn;

    fn shell(script: &str) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        command
    }

    /// One test, because a process has one pipe.
    #[test]
    fn children_print_into_the_pipe_and_never_wait_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("launcher.log");
        let messages = ChildMessages::collect(path.clone()).unwrap();
        let run = |script: &str| assert!(spawn(&mut shell(script)).unwrap().wait().unwrap().success());
        run("echo first >&2; printf second >&2");
        assert_eq!(messages.end(), ["first", "second"]);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "first\nsecond\n");

        // Nobody reads: the child ends all the same.
        let (_reader, writer) = io::pipe().unwrap();
        fcntl_setfl(&writer, OFlags::NONBLOCK).unwrap();
        set_writer(Some(writer));
        run("trap '' PIPE; head -c 1000000 /dev/zero >&2 2>/dev/null || true");
        drop(_reader);
        run("trap '' PIPE; echo lost >&2 || true");
        set_writer(None);
    }

    #[test]
    fn a_log_is_bounded_and_its_earlier_part_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("launcher.log");
        let mut log = Log::new(path.clone());
        let line = "x".repeat(LINE_MAX as usize);
        let lines = 3 * LOG_BYTES_MAX / LINE_MAX;
        (0..lines).for_each(|_| log.append(&line));
        let sizes =
            std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len());
        let sizes: Vec<u64> = sizes.collect();
        assert_eq!(sizes.len(), 2);
        assert!(sizes.iter().all(|size| *size <= LOG_BYTES_MAX + 2 * LINE_MAX), "{sizes:?}");
    }
}
