//! Exclusion zones of the fleet: commands, the zones that hold, and the state that goes out.

use super::state_file::SavedZones;
use crate::channel;
use crate::config::LABORATORY;
use crate::ports::{ChannelError, Ports, ReadPort, WritePort};
use crate::run::Run;
use crate::world;
use crate::world::WorldError;
use msg::{
    ExclusionZone, ExclusionZones, Stamp, ZONE_ANSWERS_MAX, ZONES_MAX, ZoneAction, ZoneAnswer, ZoneCommand,
    ZoneRefusal,
};
use sim::{Furniture, Room};
use std::collections::VecDeque;

/// Most zones that furniture makes: the others are for people.
const FURNITURE_MAX: usize = ZONES_MAX * 3 / 4;
/// Distance from a robot's start within which furniture makes no zone, metres: body and margin. The robot could not leave.
const START_MARGIN_M: f64 = 0.2;

/// Exclusion zones, with their channels.
pub(super) struct Zones<P: Ports> {
    commands: P::Reader<ZoneCommand>,
    state: P::Writer<ExclusionZones>,
    zones: Vec<ExclusionZone>,
    /// Number of the zone that was added last: no number is given twice.
    last_number: u32,
    /// Answers to the newest commands, oldest first: a command that comes again is known by its number. Commands of several
    /// programs need not come in the order of their numbers.
    answers: VecDeque<ZoneAnswer>,
    /// Number up to which no command is carried out.
    ignored_until: u64,
    has_changed: bool,
}

impl<P: Ports> Zones<P> {
    pub(super) fn open(ports: &P) -> Result<Self, ChannelError> {
        Ok(Self {
            commands: ports.reader(&channel::zone_command())?,
            state: ports.writer(&channel::exclusion_zones())?,
            zones: Vec::new(),
            last_number: 0,
            answers: VecDeque::with_capacity(ZONE_ANSWERS_MAX),
            ignored_until: 0,
            // The first state says that there are none.
            has_changed: true,
        })
    }

    /// Adds the furniture that the room's file names, largest first, where no robot starts.
    ///
    /// Robots whose starts are unknown do not know where the room lies in their map, nor do those that begin with the session of
    /// another run: its map is where that run's robots started.
    pub(super) fn add_furniture(&mut self, run: &Run) -> Result<(), WorldError> {
        let config = &run.config;
        let fleet = &config.fleet;
        let is_file = fleet.room != LABORATORY && Room::parse_generated(&fleet.room).is_none();
        let is_placed =
            fleet.starts_known && !config.world.is_external() && config.sessions.folder().is_none();
        if !fleet.furniture_zones || !is_placed || !is_file {
            return Ok(());
        }
        let room = world::room(config)?;
        let starts = world::starts(config, &room)?;
        let is_clear = |piece: &&Furniture| {
            starts.iter().all(|start| !piece.is_near([start.x_m, start.y_m], START_MARGIN_M))
        };
        let clear: Vec<&Furniture> = room.furniture().iter().filter(is_clear).collect();
        let mut made = 0;
        for piece in clear.iter().take(FURNITURE_MAX) {
            let Ok(zone) = ExclusionZone::new(&piece.outline_m) else { continue };
            made += 1;
            self.last_number += 1;
            self.zones.push(ExclusionZone { number: self.last_number, ..zone.with_source(&piece.label) });
        }
        let left_out = room.furniture().len() - made;
        if left_out > 0 {
            tracing::warn!(
                "{left_out} of {} pieces of furniture make no exclusion zone: at most {FURNITURE_MAX} do, none \
                 where a robot starts, and none whose outline has no area",
                room.furniture().len()
            );
        }
        Ok(())
    }

    /// The zones that hold, oldest first.
    pub(super) fn zones(&self) -> &[ExclusionZone] {
        &self.zones
    }

    /// Applies the commands that wait; returns how many were refused, `None` without any.
    pub(super) fn receive(&mut self) -> Option<u64> {
        let mut refused = None;
        while let Some(command) = self.commands.receive() {
            if !self.is_answered(command.number) {
                let refusal = self.apply(&command).err();
                self.keep_answer(ZoneAnswer::new(command.number, refusal));
                self.has_changed = true;
                *refused.get_or_insert(0) += u64::from(refusal.is_some());
            }
        }
        refused
    }

    /// Carries out no command up to a number.
    pub(super) fn ignore_commands_until(&mut self, number: u64) {
        self.ignored_until = number;
    }

    /// Whether a command was answered before. One that is older than all whose answers are kept counts as answered.
    fn is_answered(&self, number: u64) -> bool {
        let oldest = self.answers.iter().map(|answer| answer.number).min().unwrap_or(0);
        let is_forgotten = self.answers.len() == ZONE_ANSWERS_MAX && number < oldest;
        is_forgotten
            || number <= self.ignored_until
            || self.answers.iter().any(|answer| answer.number == number)
    }

    fn keep_answer(&mut self, answer: ZoneAnswer) {
        if self.answers.len() == ZONE_ANSWERS_MAX {
            self.answers.pop_front();
        }
        self.answers.push_back(answer);
    }

    fn apply(&mut self, command: &ZoneCommand) -> Result<(), ZoneRefusal> {
        match command.action().ok_or(ZoneRefusal::Broken)? {
            ZoneAction::Add if self.zones.len() >= ZONES_MAX => return Err(ZoneRefusal::Full),
            ZoneAction::Add => {
                let zone = ExclusionZone::new(command.zone.corners_m()).map_err(|_| ZoneRefusal::Broken)?;
                self.last_number = self.last_number.saturating_add(1);
                self.zones.push(ExclusionZone { number: self.last_number, ..zone });
            }
            ZoneAction::Remove => {
                let index = self.zones.iter().position(|zone| zone.number == command.zone.number);
                self.zones.remove(index.ok_or(ZoneRefusal::Unknown)?);
            }
            ZoneAction::Clear => self.zones.clear(),
        }
        Ok(())
    }

    /// Publishes the zones if they have changed or a command was answered.
    pub(super) fn publish(&mut self, stamp: Stamp) {
        if !std::mem::take(&mut self.has_changed) {
            return;
        }
        let mut zones = ExclusionZones::default();
        zones.header.stamp = stamp;
        zones.set_answers(self.answers.iter().copied());
        zones.set_zones(&self.zones);
        self.state.send(&zones);
    }

    /// Sends the newest state to readers that came late.
    pub(super) fn refresh(&self) {
        self.state.refresh();
    }

    pub(super) fn saved(&self) -> SavedZones {
        let zone = |zone: &ExclusionZone| (zone.number, zone.source().to_owned(), zone.corners_m().to_vec());
        SavedZones {
            answers: self.answers.iter().map(|answer| (answer.number, answer.refusal)).collect(),
            last_number: self.last_number,
            zones: self.zones.iter().map(zone).collect(),
        }
    }

    /// Goes on with the zones of an earlier process of this run.
    pub(super) fn restore(&mut self, saved: &SavedZones) {
        let zone = |(number, source, corners_m): &(u32, String, Vec<[f64; 2]>)| {
            let zone = ExclusionZone::new(corners_m).ok()?.with_source(source);
            Some(ExclusionZone { number: *number, ..zone })
        };
        self.zones = saved.zones.iter().filter_map(zone).take(ZONES_MAX).collect();
        self.last_number = saved.last_number;
        let answer =
            |(number, refusal): &(u64, u32)| ZoneAnswer { number: *number, refusal: *refusal, reserved: 0 };
        self.answers = saved.answers.iter().map(answer).take(ZONE_ANSWERS_MAX).collect();
        self.has_changed = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channel::{Opener, Program};
    use crate::lockstep::faults::FaultPlan;
    use crate::lockstep::queues::{MemoryPorts, Network};
    use msg::Role;

    fn square() -> ExclusionZone {
        ExclusionZone::new(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]).unwrap()
    }

    /// A person's command may be numbered before that of a page, and arrive after it.
    #[test]
    fn commands_of_two_programs_are_carried_out_in_any_order_and_none_twice() {
        let network = Network::new(FaultPlan::none());
        let ports = MemoryPorts::attach(&network, Opener::of_fleet(Role::Nav.into()));
        let tool = MemoryPorts::attach(&network, Opener::of_fleet(Program::ZoneTool));
        let mut zones = Zones::open(&ports).unwrap();
        let mut commands = tool.writer(&channel::zone_command()).unwrap();
        let mut states = tool.reader(&channel::exclusion_zones()).unwrap();
        for number in [20, 10, 20, 10] {
            commands.send(&ZoneCommand::add(number, square()));
        }
        commands.send(&ZoneCommand::remove(15, 9));
        assert_eq!(zones.receive(), Some(1));
        assert_eq!(zones.zones().len(), 2);
        zones.publish(Stamp(0));
        let state = *states.newest().unwrap();
        assert_eq!(state.answer(10).unwrap().refusal(), None);
        assert_eq!(state.answer(20).unwrap().refusal(), None);
        assert_eq!(state.answer(15).unwrap().refusal(), Some(ZoneRefusal::Unknown));
        assert_eq!(state.answer(30), None, "not sent yet");

        // The process that takes this one's place does not carry them out again.
        let mut restored = Zones::open(&ports).unwrap();
        restored.restore(&zones.saved());
        commands.send(&ZoneCommand::add(10, square()));
        assert_eq!((restored.receive(), restored.zones().len()), (None, 2));
    }
}
