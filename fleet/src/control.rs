//! Local protocol between the person at the laptop and the bridge: who may drive, and the emergency stop.
//!
//! One line of JSON each way on a Unix socket in the run's own runtime folder. Only the owner may write to it, and
//! it answers however many clients use the TCP port. `mr-slam allow`, `deny`, `stop`, `release`, `clients`,
//! `room`, `status` and the keys of the live table use it.

use crate::run::Run;
use bridge::ClientSelector;
use reports::BridgeState;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::IpAddr;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest line that either side reads, bytes: the state of 1024 clients.
pub const LINE_MAX: u64 = 1 << 20;
/// Longest time that the bridge may take to say whether the emergency stop is set.
const STOP_PATIENCE: Duration = Duration::from_secs(1);
/// Pause between two attempts to reach a bridge that is being started, a small part of its start.
pub const RETRY_PERIOD: Duration = Duration::from_millis(20);

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

impl Request {
    /// Returns whether a bridge that gets the request twice does the same as one that gets it once. A release that is repeated
    /// could release a stop that somebody has set meanwhile, and a number of a client names another one after a restart.
    fn may_repeat(self) -> bool {
        match self {
            Self::State | Self::Allow(_) | Self::Deny(_) | Self::Stop => true,
            Self::Release | Self::AnswerRoom | Self::Drop(_) => false,
        }
    }
}

/// Answer: the state after the request was done, or the reason why it was not.
pub type Reply = Result<BridgeState, String>;

/// Returns the path of the socket on which a run's bridge listens.
pub fn socket(run: &Run) -> PathBuf {
    socket_in(run.domain.root())
}

fn socket_in(runtime: &Path) -> PathBuf {
    runtime.join("bridge.sock")
}

/// Why a request has no good answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// Nobody listens, or the bridge did not answer in time.
    #[error("the bridge does not answer ({source}); it may be restarting, see `mr-slam status`")]
    NoAnswer {
        /// Error of the socket.
        source: std::io::Error,
        /// Whether a process listens on the socket, or did: a bridge that is frozen or overloaded, or ended meanwhile.
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
    ask_socket(&socket(run), request, patience)
}

/// Returns whether a run's emergency stop is set, as far as its bridge says so: one that does not answer in time pauses later what was
/// sent, if it has to.
pub fn is_stop_set(run: &Run) -> bool {
    ask(run, Request::State, STOP_PATIENCE).is_ok_and(|bridge| bridge.stopped)
}

/// Sends a request as [`ask`] does, and again for `patience` while no bridge listens: one that was killed is back by then.
/// A request that may be repeated is sent again to a bridge that has ended, or was replaced, before it answered.
pub fn ask_again(run: &Run, request: Request, patience: Duration) -> Result<BridgeState, AskError> {
    ask_socket_again(&socket(run), request, patience)
}

/// Sends a request as [`ask_again`] does to the bridge of the fleet with this runtime folder, whose run cannot be read.
pub fn ask_again_in(runtime: &Path, request: Request, patience: Duration) -> Result<BridgeState, AskError> {
    ask_socket_again(&socket_in(runtime), request, patience)
}

fn ask_socket_again(socket: &Path, request: Request, patience: Duration) -> Result<BridgeState, AskError> {
    let begun = Instant::now();
    loop {
        let left = patience.saturating_sub(begun.elapsed()).max(RETRY_PERIOD);
        match ask_socket(socket, request, left) {
            Err(AskError::NoAnswer { is_listening, .. })
                if (!is_listening || request.may_repeat()) && begun.elapsed() < patience =>
            {
                std::thread::sleep(RETRY_PERIOD);
            }
            answer => return answer,
        }
    }
}

fn ask_socket(socket: &Path, request: Request, patience: Duration) -> Result<BridgeState, AskError> {
    let line = serde_json::to_string(&request)? + "\n";
    let no_answer = |is_listening| move |source| AskError::NoAnswer { source, is_listening };
    let stream = UnixStream::connect(socket).map_err(no_answer(false))?;
    let exchange = |mut stream: UnixStream| -> std::io::Result<String> {
        stream.set_read_timeout(Some(patience))?;
        stream.set_write_timeout(Some(patience))?;
        stream.write_all(line.as_bytes())?;
        let mut answer = String::new();
        BufReader::new(stream.take(LINE_MAX)).read_line(&mut answer)?;
        if !answer.ends_with('\n') && (answer.len() as u64) < LINE_MAX {
            return Err(std::io::Error::new(ErrorKind::UnexpectedEof, "it ended before its answer"));
        }
        Ok(answer)
    };
    let answer = exchange(stream).map_err(no_answer(true))?;
    serde_json::from_str::<Reply>(&answer)?.map_err(AskError::Refused)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixListener;
    use std::thread;

    /// Longest wait of a test whose bridge answers.
    const WATCHDOG: Duration = Duration::from_secs(60);
    /// Wait for a bridge that never answers.
    const SHORT: Duration = Duration::from_millis(60);

    fn all_requests() -> [Request; 7] {
        let address = IpAddr::from([10, 0, 0, 7]);
        let drop = Request::Drop(ClientSelector::Number(1));
        let [allow, deny] = [Request::Allow(address), Request::Deny(address)];
        [Request::State, allow, deny, Request::Stop, Request::Release, Request::AnswerRoom, drop]
    }

    fn read_request(stream: &UnixStream) -> Request {
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    #[test]
    fn no_answer_is_an_error_for_each_request() {
        let folder = tempfile::tempdir().unwrap();
        for request in all_requests() {
            for ask in [ask_socket, ask_socket_again] {
                let path = folder.path().join("none");
                let error = ask(&path, request, SHORT).unwrap_err();
                assert!(
                    matches!(error, AskError::NoAnswer { is_listening: false, .. }),
                    "{request:?}: {error}"
                );

                let path = folder.path().join("frozen");
                let _ = std::fs::remove_file(&path);
                let _frozen = UnixListener::bind(&path).unwrap();
                let error = ask(&path, request, SHORT).unwrap_err();
                assert!(
                    matches!(error, AskError::NoAnswer { is_listening: true, .. }),
                    "{request:?}: {error}"
                );
            }
        }
    }

    #[test]
    fn half_an_answer_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ends");
        let listener = UnixListener::bind(&path).unwrap();
        let answer = serde_json::to_string(&Reply::Ok(BridgeState::default())).unwrap();
        for length in [0, 1, answer.len() / 2, answer.len()] {
            thread::scope(|scope| {
                scope.spawn(|| {
                    let (mut stream, _) = listener.accept().unwrap();
                    read_request(&stream);
                    stream.write_all(&answer.as_bytes()[..length]).unwrap();
                });
                let error = ask_socket(&path, Request::Release, WATCHDOG).unwrap_err();
                assert!(matches!(error, AskError::NoAnswer { is_listening: true, .. }), "{length}: {error}");
            });
        }
    }

    #[test]
    fn a_stop_reaches_the_next_bridge_and_a_release_is_sent_once() {
        let folder = tempfile::tempdir().unwrap();
        for (request, times) in [(Request::Stop, 2), (Request::State, 2), (Request::Release, 1)] {
            let path = folder.path().join("bridge");
            let _ = std::fs::remove_file(&path);
            thread::scope(|scope| {
                let asked = scope.spawn(|| ask_socket_again(&path, request, WATCHDOG));
                // It listens after the command has begun, and the first bridge ends without an answer.
                let listener = UnixListener::bind(&path).unwrap();
                assert_eq!(read_request(&listener.accept().unwrap().0), request);
                if times == 2 {
                    let (mut stream, _) = listener.accept().unwrap();
                    assert_eq!(read_request(&stream), request);
                    let state = BridgeState { stopped: true, ..BridgeState::default() };
                    let answer = serde_json::to_string(&Reply::Ok(state)).unwrap() + "\n";
                    stream.write_all(answer.as_bytes()).unwrap();
                    assert!(asked.join().unwrap().unwrap().stopped);
                } else {
                    assert!(matches!(asked.join().unwrap(), Err(AskError::NoAnswer { .. })));
                }
            });
        }
    }
}
