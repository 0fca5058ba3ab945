//! What the person at the laptop may tell the bridge, and ask it: who drives, the emergency stop.
//!
//! One line of JSON each way on a socket in the run's own folder below /tmp, which only its owner may write to; it
//! works however many clients crowd the TCP port. `mr-slam allow`, `deny`, `stop`, `release`, `status` and the live
//! table's keys speak it.

use crate::run::{Run, RunError};
use bridge::world::ClockEstimate;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{IpAddr, SocketAddr};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The longest line either side reads, bytes: the state of 1024 clients.
pub const LINE_MAX: u64 = 1 << 20;
/// How long a person's command waits for the bridge.
const PATIENCE: Duration = Duration::from_secs(2);

/// What the bridge is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// Nothing but the state.
    State,
    /// This address may drive, now and in later runs.
    Allow(IpAddr),
    /// This one may not, any more.
    Deny(IpAddr),
    /// The emergency stop.
    Stop,
    /// Its release.
    Release,
}

/// Either what was asked for has been done, and this is how things are now; or why not.
pub type Reply = Result<Doors, String>;

/// The bridge's doors: who is there, and who may what.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Doors {
    /// Whether the emergency stop is set.
    pub stopped: bool,
    /// The number of the robot that `/cmd_vel` goes to.
    pub selected: usize,
    /// Addresses that asked to drive and wait for an answer, first come first.
    pub waiting: Vec<IpAddr>,
    /// Addresses that may drive.
    pub allowed: Vec<IpAddr>,
    /// Every connection.
    pub clients: Vec<ClientView>,
}

/// One connection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClientView {
    /// Where from.
    pub address: SocketAddr,
    /// Topics it is sent.
    pub subscriptions: usize,
    /// Topics it may send.
    pub publications: usize,
    /// Bytes that wait for it.
    pub waiting_bytes: usize,
    /// Messages dropped because it was slow.
    pub dropped: u64,
    /// Numbers of the robots it drives now.
    pub drives: Vec<usize>,
    /// Its clock, if it tells of a world of its own.
    pub clock: Option<ClockEstimate>,
}

impl Doors {
    /// A few lines for a terminal; nothing if there is nothing to say.
    pub fn table(&self) -> String {
        let mut text = String::new();
        if self.stopped {
            text += "EMERGENCY STOP is set: robots stand until it is released\n";
        }
        for client in &self.clients {
            let ClientView { address, subscriptions, publications, waiting_bytes, dropped, .. } = client;
            text += &format!(
                "client {address}: hears {subscriptions} topics, sends {publications}, {:.0} kB wait, {dropped} dropped",
                *waiting_bytes as f64 / 1e3
            );
            for robot in &client.drives {
                text += &format!(", drives robot{robot}");
            }
            if let Some(clock) = &client.clock {
                text += &format!(
                    "; its clock is {:+.4} s from ours, {:+.0} ppm, journeys {:.1} / {:.1} ms (p50 / p95) above the shortest",
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

/// Where a run's bridge listens.
pub fn socket(run: &Run) -> PathBuf {
    run.domain.root().join("bridge.sock")
}

/// Asks a run's bridge, and waits for its answer, `patience` at most at each step.
pub fn ask(run: &Run, request: Request, patience: Duration) -> Reply {
    let exchange = || -> std::io::Result<String> {
        let mut stream = UnixStream::connect(socket(run))?;
        stream.set_read_timeout(Some(patience))?;
        stream.set_write_timeout(Some(patience))?;
        let line = serde_json::to_string(&request)? + "\n";
        stream.write_all(line.as_bytes())?;
        let mut answer = String::new();
        BufReader::new(stream.take(LINE_MAX)).read_line(&mut answer)?;
        Ok(answer)
    };
    let answer = exchange().map_err(|why| format!("the bridge does not answer ({why}); is it starting?"))?;
    serde_json::from_str(&answer).map_err(|why| format!("the bridge's answer is unsound: {why}"))?
}

/// Which fleet.
#[derive(Clone, Debug, clap::Args)]
pub struct RunArgs {
    /// The run's folder; without it, the fleet started last
    #[arg(long, value_name = "DIR")]
    pub run_dir: Option<PathBuf>,
}

/// Let an address drive, now and in later runs; without one, show who may and who waits
#[derive(Clone, Debug, clap::Args)]
pub struct AllowArgs {
    /// Such as the headset's
    #[arg(value_name = "ADDRESS")]
    pub address: Option<IpAddr>,
    /// Which fleet.
    #[command(flatten)]
    pub run: RunArgs,
}

/// Let an address drive no longer
#[derive(Clone, Debug, clap::Args)]
pub struct DenyArgs {
    /// Which
    #[arg(value_name = "ADDRESS")]
    pub address: IpAddr,
    /// Which fleet.
    #[command(flatten)]
    pub run: RunArgs,
}

impl RunArgs {
    /// The running fleet that is meant.
    pub fn open(&self) -> Result<Run, RunError> {
        let dir = match &self.run_dir {
            Some(dir) => dir.clone(),
            None => Run::living().pop().ok_or(RunError::NoneRunning)?,
        };
        let run = Run::open(&dir)?;
        let lives = Path::new(&format!("/proc/{}", run.pid)).exists();
        if lives { Ok(run) } else { Err(RunError::NoneRunning) }
    }

    /// Tells the fleet's bridge, and says how things are then.
    pub fn tell(&self, request: Request) -> Result<(), Box<dyn std::error::Error>> {
        let doors = ask(&self.open()?, request, PATIENCE)?;
        match request {
            Request::Allow(address) => println!("{address} may drive"),
            Request::Deny(address) => println!("{address} may not drive"),
            Request::Stop => println!("every robot stands until `mr-slam release`"),
            Request::Release => println!("the robots may be driven again"),
            Request::State => {
                doors.allowed.iter().for_each(|address| println!("{address} may drive"));
                doors.waiting.iter().for_each(|address| println!("{address} waits for an answer"));
                if doors.allowed.is_empty() && doors.waiting.is_empty() {
                    println!("nobody has asked; loopback may drive");
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_says_who_is_slow_and_who_waits() {
        let client = ClientView {
            address: "10.0.0.7:4321".parse().unwrap(),
            subscriptions: 12,
            publications: 1,
            waiting_bytes: 2_000_000,
            dropped: 345,
            drives: vec![2],
            clock: None,
        };
        let waiting = vec!["10.0.0.8".parse().unwrap()];
        let doors = Doors { clients: vec![client], waiting, ..Doors::default() };
        let lines = doors.table();
        assert!(
            lines.contains(
                "10.0.0.7:4321: hears 12 topics, sends 1, 2000 kB wait, 345 dropped, drives robot2\n"
            )
        );
        assert!(lines.contains("10.0.0.8 asks to drive: mr-slam allow 10.0.0.8\n"));
        assert!(!lines.contains("EMERGENCY"));
        assert!(Doors { stopped: true, ..Doors::default() }.table().contains("EMERGENCY STOP is set"));
    }
}
