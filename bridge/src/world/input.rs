//! The external world as a part of the bridge: it keeps a clock for each source and converts their time.

use super::{ClockEstimate, ClockOffset, ExternalWorld, Incoming, Sender, SourceClock, SourceId, WorldError};
use msg::{Monotonic, RobotId, Stamp};
use std::collections::BTreeMap;

/// The source of everything from DDS. Clients count from 1 and never reach it.
pub const DDS_SOURCE: SourceId = 1 << 48;

/// Receives sensor data of an external world from several sources.
pub struct WorldInput {
    world: ExternalWorld,
    /// Converts the bridge's monotonic time into the run's.
    stamp_at: Box<dyn Fn(Monotonic) -> Stamp>,
    /// How the clocks of clients are treated.
    clock_offset: ClockOffset,
    clocks: BTreeMap<SourceId, SourceClock>,
}

impl WorldInput {
    /// Creates the input of a world without sources.
    pub fn new(
        world: ExternalWorld,
        clock_offset: ClockOffset,
        stamp_at: Box<dyn Fn(Monotonic) -> Stamp>,
    ) -> Self {
        // ROS's stamps are taken as they are: all of ROS goes by one clock.
        let dds_clock = SourceClock::new(ClockOffset::Fixed(0.0));
        Self { world, stamp_at, clock_offset, clocks: BTreeMap::from([(DDS_SOURCE, dds_clock)]) }
    }

    /// Takes a message of a source.
    pub fn receive(
        &mut self,
        sender: Sender,
        message: Incoming<'_>,
        now: Monotonic,
    ) -> Result<(), WorldError> {
        let clock_offset = self.clock_offset;
        let clock = self.clocks.entry(sender.source).or_insert_with(|| SourceClock::new(clock_offset));
        self.world.receive(sender, clock, message, (self.stamp_at)(now))
    }

    /// Passes on what waited for its time. Call it often.
    pub fn tick(&mut self, now: Monotonic) {
        self.world.send_batteries((self.stamp_at)(now));
    }

    /// Returns by how many seconds a source's clock was found to be set since the last call, and the robot whose scans show it, if it
    /// is known.
    pub fn take_clock_step(&mut self, source: SourceId) -> Option<(Option<RobotId>, f64)> {
        let step_s = self.clocks.get_mut(&source).and_then(SourceClock::take_step);
        let of_robot = || self.world.take_step().map(|(robot, step_s)| (Some(robot), step_s));
        step_s.map(|step_s| (None, step_s)).or_else(of_robot)
    }

    /// Takes the next notice for the operator's log.
    pub fn take_notice(&mut self) -> Option<String> {
        self.world.take_notice()
    }

    /// Forgets a source that has left, so that another may take its robots at once.
    pub fn disconnect(&mut self, source: SourceId) {
        self.world.disconnect(source);
        self.clocks.remove(&source);
    }

    /// Converts a source's stamp into the run's time.
    pub fn translate(&self, source: SourceId, stamp: Stamp) -> Stamp {
        self.clocks.get(&source).map_or(stamp, |clock| clock.translate(stamp))
    }

    /// Returns what is known of a source's clock.
    pub fn clock_estimate(&self, source: SourceId) -> Option<ClockEstimate> {
        self.clocks.get(&source).and_then(SourceClock::estimate)
    }
}
