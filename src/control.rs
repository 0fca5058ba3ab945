//! Local protocol between the person at the laptop and the bridge: who may drive, and the emergency stop.
//!
//! One line of JSON each way on a Unix socket in the run's own folder below /tmp. Only the owner may write to it, and
//! it answers however many clients use the TCP port. `mr-slam allow`, `deny`, `stop`, `release`, `status` and the keys
//! of the live table use it.

use crate::run::Run;
use bridge::{ClientSelector, ClientStatus};
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
    /// Closes connections of clients.
    Drop(ClientSelector),
}

/// Answer: the state after the request was done, or the reason why it was not.
pub type Reply = Result<BridgeState, String>;

/// State of the bridge: its clients and their permissions.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BridgeState {
    /// Whether the emergency stop is set.
    pub stopped: bool,
    /// Number of the robot that `/cmd_vel` drives.
    pub selected: usize,
    /// Addresses that asked to drive and wait for an answer, in the order in which they asked.
    pub waiting: Vec<IpAddr>,
    /// Addresses that may drive.
    pub allowed: Vec<IpAddr>,
    /// State of every connection of a ros_tcp client.
    pub clients: Vec<ClientStatus>,
}

impl BridgeState {
    /// Formats the clients as a table; a line of text without any.
    pub fn client_table(&self) -> String {
        if self.clients.is_empty() {
            return "no client is connected\n".into();
        }
        let mut text = String::from(
            "  no  address                 since s  silent s  receives  sends  waiting kB  held kB  link kB/s  TF late s  dropped  drives\n",
        );
        for client in &self.clients {
            let drives: Vec<String> = client.drives.iter().map(|robot| format!("robot{robot}")).collect();
            text += format!(
                "{:4}  {:22}  {:7.0}  {:8.1}  {:8}  {:5}  {:10.0}  {:7.0}  {:>9}  {:9.2}  {:7}  {}",
                client.number,
                client.address.to_string(),
                client.connected_s,
                client.silent_s,
                client.subscriptions,
                client.publications,
                client.waiting_bytes as f64 / 1e3,
                client.held_back_bytes as f64 / 1e3,
                client.link_bytes_per_s.map_or("-".into(), |rate| format!("{:.0}", rate / 1e3)),
                client.live_delay_s,
                client.dropped,
                drives.join(" ")
            )
            .trim_end();
            text += "\n";
        }
        text
    }

    /// Formats clients, requests and the emergency stop for a terminal; empty without clients.
    pub fn table(&self) -> String {
        let mut text = String::new();
        if self.stopped {
            text += "EMERGENCY STOP is set: robots do not move until `mr-slam release`\n";
        }
        for client in &self.clients {
            let ClientStatus { address, subscriptions, publications, waiting_bytes, dropped, .. } = client;
            text += &format!(
                "client {address}: receives {subscriptions} topics, sends {publications}; {:.0} kB waiting, {dropped} messages dropped",
                *waiting_bytes as f64 / 1e3
            );
            if let (Some(rate), true) = (client.link_bytes_per_s, client.held_back_bytes > 0) {
                text += &format!(
                    "; slow link of {:.0} kB/s: transforms are {:.2} s late; {} maps have larger cells, {:.0} kB are held back",
                    rate / 1e3,
                    client.live_delay_s,
                    client.reduced_maps,
                    client.held_back_bytes as f64 / 1e3
                );
            }
            for robot in &client.drives {
                text += &format!(", drives robot{robot}");
            }
            if let Some(clock) = &client.clock {
                text += &format!(
                    "; clock offset {:+.4} s, drift {:+.0} ppm, network delay p50/p95 {:.1}/{:.1} ms above the shortest",
                    clock.offset_s, clock.drift_ppm, clock.spread_p50_ms, clock.spread_p95_ms
                );
            }
            text += "\n";
        }
        for address in &self.waiting {
            text += &format!("{address} asks to drive: mr-slam allow {address}\n");
        }
        text
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_shows_slow_and_waiting_clients() {
        let client = ClientStatus {
            number: 3,
            connected_s: 75.0,
            silent_s: 0.25,
            address: "10.0.0.7:4321".parse().unwrap(),
            subscriptions: 12,
            publications: 1,
            waiting_bytes: 2_000_000,
            link_bytes_per_s: Some(61_000.0),
            held_back_bytes: 150_000,
            reduced_maps: 1,
            live_delay_s: 0.31,
            dropped: 345,
            drives: vec![2],
            clock: None,
        };
        let waiting = vec!["10.0.0.8".parse().unwrap()];
        let state = BridgeState { clients: vec![client], waiting, ..BridgeState::default() };
        let row = "   3  10.0.0.7:4321                75       0.2        12      1        2000      150         61       0.31      345  robot2\n";
        assert!(state.client_table().ends_with(row), "{}", state.client_table());
        let lines = state.table();
        assert!(
            lines.contains(
                "10.0.0.7:4321: receives 12 topics, sends 1; 2000 kB waiting, 345 messages dropped; slow link of 61 kB/s: transforms are 0.31 s late; 1 maps have larger cells, 150 kB are held back, drives robot2\n"
            )
        );
        assert!(lines.contains("10.0.0.8 asks to drive: mr-slam allow 10.0.0.8\n"));
        assert!(!lines.contains("EMERGENCY"));
        assert!(
            BridgeState { stopped: true, ..BridgeState::default() }.table().contains("EMERGENCY STOP is set")
        );
    }
}
