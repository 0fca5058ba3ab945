//! Zenoh's log of connections between machines, in the words of `mr-slam`.

use std::fmt::{self, Debug};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use tracing::Event;
use tracing::Subscriber;
use tracing::field::{Field, Visit};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

/// Time for which a line is not written again: a machine that is refused tries again once a second.
const REPEAT_PERIOD: Duration = Duration::from_secs(60);
/// Part of a warning of no consequence: the access lists do not ask for network interfaces.
const WITHOUT_CONSEQUENCE: &str = "Transport returned multiple network interfaces";
/// Lines that are remembered.
const LINES_MAX: usize = 64;

/// Formats events: those of Zenoh's connections in words of its own, all others as `F` does.
pub struct ConnectionLog<F> {
    format: F,
    /// Lines that were written lately.
    written: Mutex<Vec<(String, Instant)>>,
}

impl<F> ConnectionLog<F> {
    /// Wraps a format.
    pub fn new(format: F) -> Self {
        Self { format, written: Mutex::default() }
    }

    fn is_new(&self, line: &str) -> bool {
        let mut written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        written.retain(|(_, at)| at.elapsed() < REPEAT_PERIOD);
        let is_new = written.len() < LINES_MAX && written.iter().all(|(other, _)| other != line);
        if is_new {
            written.push((line.to_owned(), Instant::now()));
        }
        is_new
    }
}

impl<S, N, F> FormatEvent<S, N> for ConnectionLog<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let target = event.metadata().target();
        if !target.starts_with("zenoh") {
            return self.format.format_event(context, writer, event);
        }
        let mut message = Message::default();
        event.record(&mut message);
        if message.0.contains(WITHOUT_CONSEQUENCE) {
            return Ok(());
        }
        match describe(&message.0) {
            Some(line) if self.is_new(&line) => writeln!(writer, " WARN {line}"),
            Some(_) => Ok(()),
            None => self.format.format_event(context, writer, event),
        }
    }
}

/// Text of an event.
#[derive(Default)]
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}

/// Returns what a message of Zenoh about a connection means here; `None` for all others.
fn describe(message: &str) -> Option<String> {
    let accepted = ["TLS", "QUIC"].map(|protocol| format!("Accepted {protocol} connection on "));
    if let Some(accepted) = accepted.iter().find_map(|start| message.strip_prefix(start.as_str())) {
        let (_, from) = accepted.split_once(": ")?;
        let (address, owner) = from.split_once(". ")?;
        let owner = owner.trim_end_matches('.').trim_start_matches("Common Name: ");
        return Some(format!("{address} has connected with the key of `{owner}`"));
    }
    if message.contains("did not match any configured ACL subject") {
        return Some(
            "a machine that has connected is refused: its key is of this fleet, but of no robot in --names (the line before \
             this one says whose); add the robot to --names, or use its own key"
                .into(),
        );
    }
    // What the other side's certificate lacks, in the words of TLS.
    let why = message.split_once(". Hint: increase the system open file limit").map(|(why, _)| why)?;
    // Without the place in Zenoh's source.
    let why = why.split_once(" at /").map_or(why, |(why, _)| why);
    let what = match why {
        // The other side has ended it, over TLS and over QUIC.
        _ if why.contains("fatal alert")
            || (why.contains("ConnectionClosed(") && why.contains("Code::crypto(")) =>
        {
            "it does not accept this machine's key, as when it has one of another authority"
        }
        _ if why.contains("no certificates") => "it showed no key",
        _ if why.contains("invalid peer certificate") => "its key was signed by another authority",
        _ if why.contains("os error 24") => return None,
        _ => "it does not speak TLS, or has gone",
    };
    Some(format!(
        "a stranger is refused: {what} ({why}). If it is one of your robots, create its key where your authority is with \
         `mr-slam keys robot NAME`, and copy it there"
    ))
}

/// Returns what Zenoh says without places in its source, such as ` at /root/.../orchestrator.rs:388.`.
#[cfg(feature = "zenoh")]
pub(crate) fn plain_reason(why: &str) -> String {
    let is_place = |word: &str| word.contains(".rs:");
    let mut words: Vec<&str> = Vec::new();
    for word in why.split_whitespace() {
        if !is_place(word) {
            words.push(word);
        } else if words.last() == Some(&"at") {
            words.pop();
        }
    }
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strangers_are_described_with_what_to_do() {
        let hint = "Hint: increase the system open file limit.";
        for (why, expected) in [
            ("peer sent no certificates", "it showed no key"),
            ("invalid peer certificate: UnknownIssuer", "another authority"),
            ("received fatal alert: DecryptError", "does not accept this machine's key"),
            ("received corrupt message of type InvalidContentType", "does not speak TLS"),
            (
                "QUIC acceptor failed: ConnectionClosed(ConnectionClose { error_code: Code::crypto(30) })",
                "does not accept this machine's key",
            ),
            (
                "QUIC acceptor failed: ConnectionClosed(ConnectionClose { error_code: APPLICATION_ERROR })",
                "or has gone",
            ),
        ] {
            let line = describe(&format!("{why}. {hint}")).unwrap();
            assert!(
                line.contains(expected) && line.contains(why) && line.contains("mr-slam keys robot"),
                "{line}"
            );
        }
        assert_eq!(describe(&format!("Too many open files (os error 24). {hint}")), None);
        assert_eq!(describe("Session closed"), None);
        for protocol in ["TLS", "QUIC"] {
            let accepted = format!(
                "Accepted {protocol} connection on 10.0.0.1:7447: 10.0.0.2:4242. Common Name: robot alice."
            );
            let line = describe(&accepted).unwrap();
            assert_eq!(line, "10.0.0.2:4242 has connected with the key of `robot alice`");
        }
    }

    #[test]
    fn a_stranger_who_tries_again_is_shown_once() {
        let log = ConnectionLog::new(());
        assert!(log.is_new("a stranger") && !log.is_new("a stranger") && log.is_new("another"));
        for number in 0..2 * LINES_MAX {
            let _ = log.is_new(&number.to_string());
        }
        assert!(log.written.lock().unwrap().len() <= LINES_MAX);
    }
}
