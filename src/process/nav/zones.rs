//! Exclusion zones of the fleet: commands, the zones that hold, and the state that goes out.

use super::memory::SavedZones;
use crate::channel;
use crate::config::LABORATORY;
use crate::fleet;
use crate::fleet::FleetError;
use crate::ports::{ChannelError, Ports, ReadPort, WritePort};
use crate::run::Run;
use msg::{ExclusionZone, ExclusionZones, Stamp, ZONES_MAX, ZoneAction, ZoneCommand, ZoneRefusal};
use sim::{Furniture, Room};

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
    /// Number of the newest command, and why it was refused.
    newest: (u64, Option<ZoneRefusal>),
    has_changed: bool,
}

impl<P: Ports> Zones<P> {
    pub(super) fn open(ports: &P) -> Result<Self, ChannelError> {
        Ok(Self {
            commands: ports.reader(&channel::zone_command())?,
            state: ports.writer(&channel::exclusion_zones())?,
            zones: Vec::new(),
            last_number: 0,
            newest: (0, None),
            // The first state says that there are none.
            has_changed: true,
        })
    }

    /// Adds the furniture that the room's file names, largest first, where no robot starts.
    ///
    /// Robots whose starts are unknown do not know where the room lies in their map.
    pub(super) fn add_furniture(&mut self, run: &Run) -> Result<(), FleetError> {
        let config = &run.config;
        let fleet = &config.fleet;
        let is_file = fleet.room != LABORATORY && Room::parse_generated(&fleet.room).is_none();
        if !fleet.furniture_zones || !fleet.starts_known || config.world.is_outside() || !is_file {
            return Ok(());
        }
        let room = fleet::room(config)?;
        let starts = fleet::starts(config, &room)?;
        let is_clear = |piece: &&Furniture| {
            starts.iter().all(|start| !piece.is_near([start.x_m, start.y_m], START_MARGIN_M))
        };
        let clear: Vec<&Furniture> = room.furniture().iter().filter(is_clear).collect();
        for piece in clear.iter().take(FURNITURE_MAX) {
            let Ok(zone) = ExclusionZone::new(&piece.outline_m) else { continue };
            self.last_number += 1;
            self.zones.push(ExclusionZone { number: self.last_number, ..zone.with_source(&piece.label) });
        }
        let left_out = room.furniture().len() - clear.len().min(FURNITURE_MAX);
        if left_out > 0 {
            tracing::warn!(
                "{left_out} of {} pieces of furniture make no exclusion zone: at most {FURNITURE_MAX} do, and none \
                 where a robot starts",
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
            if command.number > self.newest.0 {
                let refusal = self.apply(&command).err();
                self.newest = (command.number, refusal);
                self.has_changed = true;
                *refused.get_or_insert(0) += u64::from(refusal.is_some());
            }
        }
        refused
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
        let (number, refusal) = self.newest;
        let mut zones = ExclusionZones {
            number,
            refusal: refusal.map_or(0, |refusal| refusal as u32),
            ..ExclusionZones::default()
        };
        zones.header.stamp = stamp;
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
            number: self.newest.0,
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
        self.newest = (saved.number, None);
        self.has_changed = true;
    }
}
