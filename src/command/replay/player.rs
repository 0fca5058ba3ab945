//! Plays a fleet's recording in lockstep and passes its messages on to transports, at the speed that is asked for.

use super::ReplayError;
use crate::config::FleetConfig;
use crate::lockstep::Lockstep;
use crate::process::ProcessLoop;
use bridge::Bridge;
use bridge::dds::DdsEndpoint;
use recording::fleet::FleetRecording;
use recording::playback::{Playback, SeekError, Speed};
use sim::Simulator;
use std::ops::Range;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// Longest time of one call: clients are served between two of them.
const TURN_MAX: Duration = Duration::from_millis(20);
/// Change of the place by a key, seconds.
const JUMP_S: f64 = 10.0;

/// Who receives the messages of a replay.
pub struct Transports {
    /// Clients on TCP and in browsers.
    pub bridge: Rc<Bridge>,
    /// ROS 2 nodes, where they are served.
    pub dds: Option<Rc<DdsEndpoint>>,
}

/// Plays one recording.
pub struct Player {
    config: FleetConfig,
    recording: Rc<FleetRecording>,
    transports: Transports,
    fleet: Lockstep,
    feeds: Vec<Box<dyn ProcessLoop>>,
    playback: Playback,
    /// Moment of the last turn.
    turned: Instant,
}

fn failed(why: Box<dyn std::error::Error>) -> ReplayError {
    ReplayError::Replay(why.to_string())
}

impl Player {
    /// Begins at the beginning. `config` is the recorded fleet's.
    ///
    /// # Errors
    /// The configuration's room or starts cannot be used.
    pub fn new(
        config: FleetConfig,
        recording: FleetRecording,
        transports: Transports,
        speed: Speed,
    ) -> Result<Self, ReplayError> {
        let recording = Rc::new(recording);
        let (fleet, feeds) = begin(&config, &recording, &transports)?;
        let playback = Playback::new(ticks(&recording), Simulator::TICK, speed);
        Ok(Self { config, recording, transports, fleet, feeds, playback, turned: Instant::now() })
    }

    /// Returns how far the replay has come.
    pub fn playback(&self) -> &Playback {
        &self.playback
    }

    /// Returns the fleet as it is now.
    pub fn fleet(&mut self) -> &mut Lockstep {
        &mut self.fleet
    }

    /// Takes the endpoint of ROS 2, which is to leave the graph.
    pub fn take_ros2_endpoint(&mut self) -> Option<Rc<DdsEndpoint>> {
        self.transports.dds.take()
    }

    /// Plays what is due, for a short time. Returns whether more is due already.
    pub fn turn(&mut self) -> bool {
        let begun = Instant::now();
        self.playback.pass_time(begun - self.turned);
        self.turned = begun;
        while begun.elapsed() < TURN_MAX {
            let was_seeking = self.playback.is_seeking();
            if self.playback.take_tick().is_none() {
                if was_seeking {
                    self.pass();
                }
                return false;
            }
            self.fleet.tick(&mut |_, _| {});
            // On the way to another place nothing is shown.
            if !self.playback.is_seeking() {
                self.pass();
            }
        }
        true
    }

    /// Passes the newest messages on.
    fn pass(&mut self) {
        for feed in &mut self.feeds {
            feed.step();
        }
    }

    /// Pauses or goes on. Like the others, returns what changed, for people.
    pub fn set_paused(&mut self, is_paused: bool) -> String {
        self.playback.set_paused(is_paused);
        let at_s = self.playback.position_s();
        format!("{} at {at_s:.2} s", if is_paused { "paused" } else { "goes on" })
    }

    /// Changes the speed.
    pub fn set_speed(&mut self, speed: Speed) -> String {
        self.playback.set_speed(speed);
        format!("speed: {speed}")
    }

    /// Goes to another place. To go back, all before is played anew, as fast as the machine can.
    ///
    /// # Errors
    /// The recording does not reach there, or cannot be begun anew.
    pub fn seek(&mut self, to_s: f64) -> Result<String, PlayerError> {
        if self.playback.seek(to_s)? {
            let (fleet, feeds) = begin(&self.config, &self.recording, &self.transports)?;
            (self.fleet, self.feeds) = (fleet, feeds);
        }
        Ok(format!("goes to {to_s:.2} s"))
    }

    /// Does what a key asks for; `None`: the key is unknown.
    pub fn apply_key(&mut self, key: char) -> Option<String> {
        let (at_s, begins_s, ends_s) =
            (self.playback.position_s(), self.playback.begins_s(), self.playback.ends_s());
        let faster = |player: &mut Self, factor: f64| {
            let Speed::Times(times) = player.playback.speed() else {
                return "speed: as fast as possible".into();
            };
            Speed::times(times * factor).map_or_else(|why| why.to_string(), |speed| player.set_speed(speed))
        };
        Some(match key {
            ' ' => self.set_paused(!self.playback.is_paused()),
            '+' => faster(self, 2.0),
            '-' => faster(self, 0.5),
            '.' => self.seek((at_s + JUMP_S).min(ends_s)).unwrap_or_else(|why| why.to_string()),
            ',' => self.seek((at_s - JUMP_S).max(begins_s)).unwrap_or_else(|why| why.to_string()),
            _ => return None,
        })
    }
}

/// Reason why a replay does not go to another place.
#[derive(Debug, thiserror::Error)]
pub enum PlayerError {
    /// The recording does not reach there.
    #[error(transparent)]
    Seek(#[from] SeekError),
    /// It cannot be begun anew.
    #[error(transparent)]
    Replay(#[from] ReplayError),
}

/// Returns the ticks of the run that a recording has.
pub fn ticks(recording: &FleetRecording) -> Range<u64> {
    let tick_ns = Simulator::TICK.as_nanos() as u64;
    recording.begins().0 as u64 / tick_ns..(recording.ends().0 as u64).div_ceil(tick_ns)
}

/// A fleet at the beginning of its recording, and the feeds of its transports.
type Begun = (Lockstep, Vec<Box<dyn ProcessLoop>>);

fn begin(
    config: &FleetConfig,
    recording: &Rc<FleetRecording>,
    transports: &Transports,
) -> Result<Begun, ReplayError> {
    let fleet = Lockstep::replay_for_transports(config, recording.clone()).map_err(failed)?;
    let mut feeds = fleet.feeds(&transports.bridge).map_err(failed)?;
    if let Some(dds) = &transports.dds {
        feeds.extend(fleet.feeds(dds).map_err(failed)?);
    }
    Ok((fleet, feeds))
}
