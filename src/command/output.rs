//! Printing of results and progress. A reader that has gone (`mr-slam status --json | head`) is no error.

use super::connection_log::ConnectionLog;
use serde::Serialize;
use std::io::{self, Write};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format;

/// Messages that are logged without `RUST_LOG`: a person at a terminal wants to know what went wrong, and, on a link between
/// machines, who connects, as `connection_log` describes it.
const LOG_DEFAULT: &str =
    "warn,zenoh=error,zenoh::net::routing::interceptor=info,zenoh_link_tls::unicast=debug";

/// Starts logging to standard error: one compact line for each message that `RUST_LOG` lets pass.
pub fn start_log() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(LOG_DEFAULT));
    let started = tracing_subscriber::fmt()
        .with_ansi(false)
        // A closed standard error is no reason to end a process.
        .log_internal_errors(false)
        .event_format(ConnectionLog::new(
            format().compact().with_target(false).without_time().with_ansi(false),
        ))
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .try_init();
    // Only a second call fails, and then the first one's log is in use.
    drop(started);
}

/// Prints text as it is, without a line break of its own, to standard output.
///
/// Errors: whatever the system says, such as a full disk, but for a closed pipe.
pub fn print(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    let written = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
    match written {
        // The reader closed the pipe, as `head` does: no error.
        Err(why) if why.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        written => written,
    }
}

/// Prints a value as indented JSON to standard output.
pub fn print_json(value: &impl Serialize) -> io::Result<()> {
    print(&(serde_json::to_string_pretty(value)? + "\n"))
}

/// Prints a value as JSON if `json`, otherwise the text that `text` returns.
pub fn print_either(json: bool, value: &impl Serialize, text: impl FnOnce() -> String) -> io::Result<()> {
    if json { print_json(value) } else { print(&text()) }
}

/// Prints a line for people to standard error. Nobody has to read it: errors are ignored.
pub fn note(line: &str) {
    note_text(&format!("{line}\n"));
}

/// Prints text for people to standard error, without a line break of its own. Errors are ignored.
pub fn note_text(text: &str) {
    let _ = io::stderr().write_all(text.as_bytes());
}
