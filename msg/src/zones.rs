//! Messages of exclusion zones: areas of the merged map that navigation keeps robots out of.

use crate::Header;
use crate::pose::COORDINATE_MAX_M;
use crate::zone_shape::{self, ShapeError};
use bytemuck::{Pod, Zeroable};
use thiserror::Error;

/// Most zones of a fleet.
pub const ZONES_MAX: usize = 32;
/// Most corners of a zone.
pub const ZONE_CORNERS_MAX: usize = 16;
/// Fewest corners of a zone.
pub const ZONE_CORNERS_MIN: usize = 3;
/// Most bytes of the name of a zone's source.
pub const ZONE_SOURCE_MAX: usize = 24;
/// Most commands whose answers are kept.
pub const ZONE_ANSWERS_MAX: usize = 64;
/// Corners that make no zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ZoneError {
    /// Too few or too many corners.
    #[error("a zone of {0} corners; expected {ZONE_CORNERS_MIN} to {ZONE_CORNERS_MAX}")]
    Corners(usize),
    /// A corner is not a usable point.
    #[error("corner {} of the zone is not a finite point within 100 km of the origin", .0 + 1)]
    NotFinite(usize),
    /// The corners go around no area.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

/// Polygon that navigation keeps robots out of.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ExclusionZone {
    /// Number by which it is removed; 0 before it has one.
    pub number: u32,
    /// Number of `corners_m` in use. Read them by [`ExclusionZone::corners_m`].
    pub corners_len: u32,
    /// Storage of the corners, in order, in the merged map, metres.
    pub corners_m: [[f64; 2]; ZONE_CORNERS_MAX],
    /// Storage of the label of the furniture that it stands for, UTF-8, filled with zeros. All zeros: a person or program
    /// added it. Read it by [`ExclusionZone::source`].
    pub source: [u8; ZONE_SOURCE_MAX],
}

impl ExclusionZone {
    /// A zone with these corners, in order, in the merged map, metres. The last one is joined to the first.
    ///
    /// ```
    /// use msg::{ExclusionZone, ZoneError};
    ///
    /// let stairs = ExclusionZone::new(&[[1.0, 0.0], [2.0, 0.0], [2.0, 3.0], [1.0, 3.0]])?;
    /// assert_eq!(stairs.corners_m().len(), 4);
    /// assert_eq!(ExclusionZone::new(&[[0.0, 0.0]]), Err(ZoneError::Corners(1)));
    /// # Ok::<(), ZoneError>(())
    /// ```
    pub fn new(corners_m: &[[f64; 2]]) -> Result<Self, ZoneError> {
        let count = corners_m.len();
        if !(ZONE_CORNERS_MIN..=ZONE_CORNERS_MAX).contains(&count) {
            return Err(ZoneError::Corners(count));
        }
        let is_usable = |corner: &[f64; 2]| corner.iter().all(|v| v.abs() <= COORDINATE_MAX_M);
        if let Some(index) = corners_m.iter().position(|corner| !is_usable(corner)) {
            return Err(ZoneError::NotFinite(index));
        }
        zone_shape::check(corners_m)?;
        let mut zone = Self { corners_len: count as u32, ..Self::default() };
        zone.corners_m[..count].copy_from_slice(corners_m);
        Ok(zone)
    }

    /// This zone with the label of the furniture that it stands for; what is over 24 bytes is cut off.
    pub fn with_source(mut self, label: &str) -> Self {
        self.source = [0; ZONE_SOURCE_MAX];
        let end = (0..=label.len().min(ZONE_SOURCE_MAX)).rev().find(|end| label.is_char_boundary(*end));
        let bytes = &label.as_bytes()[..end.unwrap_or(0)];
        self.source[..bytes.len()].copy_from_slice(bytes);
        self
    }

    /// Label of the furniture that it stands for; empty for a zone that a person or program added.
    pub fn source(&self) -> &str {
        let len = self.source.iter().position(|byte| *byte == 0).unwrap_or(ZONE_SOURCE_MAX);
        core::str::from_utf8(&self.source[..len]).unwrap_or_default()
    }

    /// The corners in use, in order, in the merged map, metres.
    pub fn corners_m(&self) -> &[[f64; 2]] {
        &self.corners_m[..(self.corners_len as usize).min(ZONE_CORNERS_MAX)]
    }
}

/// What a command about the zones asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ZoneAction {
    /// Add the zone; the navigator numbers it.
    Add = 1,
    /// Remove the zone with this number.
    Remove = 2,
    /// Remove all zones.
    Clear = 3,
}

/// Command to the navigator about the exclusion zones.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ZoneCommand {
    /// Header whose `stamp` is the time of the command.
    pub header: Header,
    /// Number of the command: its time on the machine's clock, nanoseconds, which no other has.
    pub number: u64,
    /// Code of a [`ZoneAction`].
    pub action: u32,
    /// Fills the message to a multiple of 8 bytes; 0.
    pub reserved: u32,
    /// The zone to add, or one with the number of the zone to remove.
    pub zone: ExclusionZone,
}

impl ZoneCommand {
    /// A command that adds a zone.
    pub fn add(number: u64, zone: ExclusionZone) -> Self {
        Self { number, action: ZoneAction::Add as u32, zone, ..Self::default() }
    }

    /// A command that removes the zone with a number.
    pub fn remove(number: u64, zone: u32) -> Self {
        let zone = ExclusionZone { number: zone, ..ExclusionZone::default() };
        Self { number, action: ZoneAction::Remove as u32, zone, ..Self::default() }
    }

    /// A command that removes all zones.
    pub fn clear(number: u64) -> Self {
        Self { number, action: ZoneAction::Clear as u32, ..Self::default() }
    }

    /// Returns what is asked for; `None` for an unknown code.
    pub fn action(&self) -> Option<ZoneAction> {
        use ZoneAction::{Add, Clear, Remove};
        [Add, Remove, Clear].into_iter().find(|action| *action as u32 == self.action)
    }
}

/// Why the newest command about the zones was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[repr(u32)]
pub enum ZoneRefusal {
    /// There are [`ZONES_MAX`] zones already.
    #[error("there are {ZONES_MAX} zones already; remove one first")]
    Full = 1,
    /// No zone has the number.
    #[error("no zone has this number")]
    Unknown = 2,
    /// The polygon or the command is broken.
    #[error(
        "the zone has too few or too many corners, one that is not finite or is repeated, sides that cross each other, or no area"
    )]
    Broken = 3,
}

/// Answer of navigation to a command about the zones.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ZoneAnswer {
    /// Number of the command; 0 in places that are not used.
    pub number: u64,
    /// Code of a [`ZoneRefusal`]; 0 if the command was carried out. Read it by [`ZoneAnswer::refusal`].
    pub refusal: u32,
    /// Fills the answer to a multiple of 8 bytes; 0.
    pub reserved: u32,
}

impl ZoneAnswer {
    /// Answers a command.
    pub fn new(number: u64, refusal: Option<ZoneRefusal>) -> Self {
        Self { number, refusal: refusal.map_or(0, |refusal| refusal as u32), reserved: 0 }
    }

    /// Why the command was not carried out; `None` if it was.
    pub fn refusal(&self) -> Option<ZoneRefusal> {
        use ZoneRefusal::{Broken, Full, Unknown};
        [Full, Unknown, Broken].into_iter().find(|refusal| *refusal as u32 == self.refusal)
    }
}

/// All exclusion zones, as navigation keeps to them.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ExclusionZones {
    /// Header whose `stamp` is the time of the newest change.
    pub header: Header,
    /// Answers to the newest commands, the newest first. Read them by [`ExclusionZones::answer`].
    pub answers: [ZoneAnswer; ZONE_ANSWERS_MAX],
    /// Number of `zones` in use. Read them by [`ExclusionZones::zones`].
    pub zones_len: u32,
    /// Fills the message to a multiple of 8 bytes; 0.
    pub reserved: u32,
    /// Storage of the zones, oldest first.
    pub zones: [ExclusionZone; ZONES_MAX],
}

impl Default for ExclusionZones {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl ExclusionZones {
    /// The zones in use, oldest first.
    pub fn zones(&self) -> &[ExclusionZone] {
        &self.zones[..(self.zones_len as usize).min(ZONES_MAX)]
    }

    /// Sets the zones: the first [`ZONES_MAX`].
    pub fn set_zones(&mut self, zones: &[ExclusionZone]) {
        let len = zones.len().min(ZONES_MAX);
        self.zones[..len].copy_from_slice(&zones[..len]);
        self.zones_len = len as u32;
    }

    /// The answer to the command with a number; `None` if there is none yet.
    pub fn answer(&self, number: u64) -> Option<ZoneAnswer> {
        self.answers.iter().find(|answer| answer.number == number && number != 0).copied()
    }

    /// Sets the answers, given from the oldest to the newest.
    pub fn set_answers(&mut self, answers: impl DoubleEndedIterator<Item = ZoneAnswer>) {
        self.answers = [ZoneAnswer::default(); ZONE_ANSWERS_MAX];
        self.answers.iter_mut().zip(answers.rev()).for_each(|(place, answer)| *place = answer);
    }

    /// Why the newest command was not carried out; `None` if it was.
    pub fn refusal(&self) -> Option<ZoneRefusal> {
        self.answers[0].refusal()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_messages_are_read_within_their_bounds() {
        let zone = ExclusionZone { corners_len: u32::MAX, ..Default::default() };
        assert_eq!(zone.corners_m().len(), ZONE_CORNERS_MAX);
        let mut zones = ExclusionZones { zones_len: u32::MAX, ..Default::default() };
        zones.answers[0].refusal = 99;
        assert_eq!((zones.zones().len(), zones.refusal(), zones.answer(0)), (ZONES_MAX, None, None));
        assert_eq!(ZoneCommand { action: 99, ..Default::default() }.action(), None);
    }

    #[test]
    fn a_long_source_is_cut_at_a_letter() {
        let zone = ExclusionZone::default();
        assert_eq!(zone.source(), "");
        assert_eq!(zone.with_source("TABLE").source(), "TABLE");
        let long = format!("{}é", "a".repeat(ZONE_SOURCE_MAX - 1));
        assert_eq!(zone.with_source(&long).source(), "a".repeat(ZONE_SOURCE_MAX - 1));
        assert_eq!(ExclusionZone { source: [0xff; ZONE_SOURCE_MAX], ..zone }.source(), "");
    }

    #[test]
    fn broken_corners_make_no_zone() {
        let nan = [[0.0, 0.0], [1.0, f64::NAN], [1.0, 1.0]];
        assert_eq!(ExclusionZone::new(&nan), Err(ZoneError::NotFinite(1)));
        assert_eq!(ExclusionZone::new(&[[0.0; 2]; ZONE_CORNERS_MAX + 1]), Err(ZoneError::Corners(17)));
    }
}
