//! Printing of results and progress. A reader that has gone (`mr-slam status --json | head`) is no error.

use link_transport::ConnectionLog;
use serde::Serialize;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::format;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// Messages that are logged without `RUST_LOG`: a person at a terminal wants to know what went wrong, and, on a link between
/// machines, who connects, as `connection_log` describes it. RustDDS warns of each message to a node that it cannot reach yet.
const LOG_DEFAULT: &str = "warn,rustdds=error,zenoh=error,zenoh::net::routing::interceptor=info,zenoh_link_tls::unicast=debug,\
     zenoh_link_quic::unicast=debug,zenoh_link_commons=error,zenoh_link_commons::quic::unicast=warn,quinn=error,\
     quinn_udp=error";

/// Starts logging to standard error: one compact line for each message that `RUST_LOG` lets pass. It lists levels, or parts of
/// the program with a level each: `warn,bridge=debug`.
pub fn start_log() {
    let given = std::env::var("RUST_LOG").ok().and_then(|text| text.parse::<Targets>().ok());
    let filter = given.or_else(|| LOG_DEFAULT.parse().ok()).unwrap_or_default();
    let line = ConnectionLog::new(format().compact().with_target(false).without_time().with_ansi(false));
    let log = tracing_subscriber::fmt::layer()
        .with_ansi(false)
        // A closed standard error is no reason to end a process.
        .log_internal_errors(false)
        .event_format(line)
        .with_writer(io::stderr);
    // Only a second call fails, and then the first one's log is in use.
    let _ = tracing_subscriber::registry().with(filter).with(log).try_init();
}

/// Whether something was printed to standard output.
static HAS_PRINTED: AtomicBool = AtomicBool::new(false);

/// Prints text as it is, without a line break of its own, to standard output.
///
/// Errors: whatever the system says, such as a full disk, but for a closed pipe.
pub fn print(text: &str) -> io::Result<()> {
    HAS_PRINTED.fetch_or(!text.is_empty(), Ordering::Relaxed);
    let mut stdout = io::stdout().lock();
    let written = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
    match written {
        // The reader closed the pipe, as `head` does: no error.
        Err(why) if why.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        // Every command says alike what cannot be written.
        written => written
            .map_err(|why| io::Error::new(why.kind(), format!("cannot write to standard output: {why}"))),
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

/// Prints `{"error": ...}` to standard output for a program that asked for JSON, unless it has a result already: a goal that
/// was not reached has one. Errors are ignored, as the exit code says the rest.
pub fn print_failure(why: &str) {
    if !HAS_PRINTED.load(Ordering::Relaxed) {
        let _ = print_json(&serde_json::json!({ "error": why }));
    }
}

/// Prints a line for people to standard error. Nobody has to read it: errors are ignored.
pub fn note(line: &str) {
    note_text(&format!("{line}\n"));
}

/// Prints text for people to standard error, without a line break of its own. Errors are ignored.
pub fn note_text(text: &str) {
    let _ = io::stderr().write_all(text.as_bytes());
}
