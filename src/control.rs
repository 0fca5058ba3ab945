//! Local protocol between the person at the laptop and the bridge: who may drive, and the emergency stop.
//!
//! One line of JSON each way on a Unix socket in the run's own runtime folder. Only the owner may write to it, and
//! it answers however many clients use the TCP port. `mr-slam allow`, `deny`, `stop`, `release`, `clients`,
//! `room`, `status` and the keys of the live table use it.

use crate::run::Run;
use bridge::ClientSelector;
use reports::BridgeState;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::IpAddr;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::Duration;

/// Longest line that either side reads, bytes: the state of 1024 clients.
pub const LINE_MAX: u64 = 1 << 20;

/// Request to the bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// Returns the state and changes nothing.
    State,
    /// Lets an address drive, now and in later runs.
    Allow(IpAddr),
    /// Forbids an address to drive.
    Deny(IpAddr),
    /// Sets the emergency stop.
    Stop,
    /// Releases the emergency stop.
    Release,
    /// Forgets the room that a headset offers: it was accepted or refused.
    AnswerRoom,
    /// Closes connections of clients.
    Drop(ClientSelector),
}

/// Answer: the state after the request was done, or the reason why it was not.
pub type Reply = Result<BridgeState, String>;

/// Returns the path of the socket on which a run's bridge listens.
pub fn socket(run: &Run) -> PathBuf {
    run.domain.root().join("bridge.sock")
}

/// Why a request has no good answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// Nobody listens, or the bridge did not answer in time.
    #[error("the bridge does not answer ({source}); it may be restarting, see `mr-slam status`")]
    NoAnswer {
        /// Error of the socket.
        source: std::io::Error,
        /// Whether a process listens on the socket: a bridge that is frozen or overloaded.
        is_listening: bool,
    },
    /// The answer is not the protocol's.
    #[error("the bridge's answer cannot be read: {0}")]
    Invalid(#[from] serde_json::Error),
    /// The bridge did not do it, or not wholly.
    #[error("{0}")]
    Refused(String),
}

/// Sends a request to a run's bridge and returns its answer; waits at most `patience` at each step.
pub fn ask(run: &Run, request: Request, patience: Duration) -> Result<BridgeState, AskError> {
    let line = serde_json::to_string(&request)? + "\n";
    let no_answer = |is_listening| move |source| AskError::NoAnswer { source, is_listening };
    let stream = UnixStream::connect(socket(run)).map_err(no_answer(false))?;
    let exchange = |mut stream: UnixStream| -> std::io::Result<String> {
        stream.set_read_timeout(Some(patience))?;
        stream.set_write_timeout(Some(patience))?;
        stream.write_all(line.as_bytes())?;
        let mut answer = String::new();
        BufReader::new(stream.take(LINE_MAX)).read_line(&mut answer)?;
        Ok(answer)
    };
    let answer = exchange(stream).map_err(no_answer(true))?;
    serde_json::from_str::<Reply>(&answer)?.map_err(AskError::Refused)
}
