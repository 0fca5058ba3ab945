//! What is known of the robots' batteries, as the operator sees it.
//!
//! ROS defines `percentage` as 0 to 1. Some drivers count to 100: ROBOTIS's for the TurtleBot3 passes on the OpenCR's percent,
//! 0 at 10.5 V, 100 at 12.3 V and 117 for a full battery (`update_battery_status_to_table` in OpenCR's `turtlebot3_ros2`).
//! Its first number tells how a robot counts: in percent, if it is more than [`FRACTION_MAX`]. Numbers that contradict that, such as 42 from
//! a robot that counts to 1, say nothing, until [`CONTRADICTIONS`] have come in a row: then the robot counts the other way. So one
//! wrong number makes no battery empty or full. After a silence of [`STALE`] a robot's number is its first one again.

use crate::config::BatteryConfig;
use msg::{Battery, Monotonic, PowerSupplyStatus, RobotId};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A state that is older says nothing of now. States come once a second.
pub const STALE: Duration = Duration::from_secs(30);
/// Largest share that a driver that counts from 0 to 1 sends: by the voltage over the nominal one, a full battery has 1.14.
const FRACTION_MAX: f32 = 1.2;
/// Largest number that a driver sends that counts in percent.
const PERCENT_MAX: f32 = 125.0;
/// Numbers in a row that show that a robot counts otherwise than it seemed.
const CONTRADICTIONS: u8 = 3;
/// Largest step from one number to the next in which a battery may lose charge, percent. A smaller number than [`FRACTION_MAX`] after a larger
/// step is a share.
const DROP_MAX_PERCENT: f32 = 5.0;
/// Largest voltage that is shown, V: more is another unit.
const VOLTAGE_MAX_V: f32 = 1000.0;

/// How urgent the charge of a battery is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BatteryLevel {
    /// The charge is below [`BatteryConfig::low`].
    Low,
    /// The charge is below [`BatteryConfig::critical`].
    Critical,
}

/// State of a robot's battery. What is not known is `None`, and so is all but the age and `last_charge` of a state older than
/// 30 s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BatteryStatus {
    /// Charge over capacity, 0 to 1.
    pub charge: Option<f64>,
    /// Voltage at its terminals, V.
    pub voltage_v: Option<f64>,
    /// Whether it is being charged.
    pub is_charging: Option<bool>,
    /// How urgent the charge is, unless the battery is being charged.
    pub level: Option<BatteryLevel>,
    /// Charge in the newest message, however old that is, 0 to 1.
    pub last_charge: Option<f64>,
    /// Age of the newest message, whole seconds.
    pub age_s: f64,
}

/// The newest state of one battery.
#[derive(Clone, Copy, Debug)]
struct Record {
    newest: Battery,
    /// Charge over capacity in it, 0 to 1, if that is known.
    charge: Option<f64>,
    /// How the robot counts; `None` if it has not said.
    scale: Option<Scale>,
    /// When the state was first seen; `None` until the first tick after it came.
    since: Option<Monotonic>,
}

/// How a robot counts the charge of its battery.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Scale {
    unit: Unit,
    /// The newest number that agrees with the unit.
    number: f32,
    /// How many numbers since then contradict it.
    contradictions: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    /// 0 to 1, as ROS defines it.
    Share,
    /// 0 to 100.
    Percent,
}

impl Scale {
    /// Returns how a robot counts that has sent `number` first, from 0 to [`PERCENT_MAX`].
    fn of_first(number: f32) -> Self {
        let unit = if number > FRACTION_MAX { Unit::Percent } else { Unit::Share };
        Self { unit, number, contradictions: 0 }
    }

    /// Returns how the robot counts as far as is known after one more number, from 0 to [`PERCENT_MAX`].
    fn after(self, number: f32) -> Self {
        let is_contradiction = match self.unit {
            Unit::Share => number > FRACTION_MAX,
            // An empty battery is 0 in both.
            Unit::Percent => {
                (f32::MIN_POSITIVE..=FRACTION_MAX).contains(&number)
                    && self.number - number > DROP_MAX_PERCENT
            }
        };
        let contradictions = self.contradictions + 1;
        match is_contradiction {
            false => Self { number, contradictions: 0, ..self },
            true if contradictions < CONTRADICTIONS => Self { contradictions, ..self },
            true => Self::of_first(number),
        }
    }

    /// Returns the share of the capacity that a number is; `None` if it contradicts the unit, or is between both units.
    fn share(self, number: f32) -> Option<f32> {
        match self.unit {
            _ if self.contradictions > 0 => None,
            Unit::Percent => Some(number / 100.0),
            // Above 1 it may be a full battery by its voltage, or an empty one in percent.
            Unit::Share => Some(number).filter(|share| *share <= 1.0),
        }
    }
}

/// The newest states of the batteries of all robots that have sent one.
#[derive(Debug)]
pub(crate) struct Batteries(Vec<Option<Record>>);

impl Batteries {
    /// Creates the batteries of a fleet, of which nothing is known.
    pub(crate) fn new(robot_count: usize) -> Self {
        Self(vec![None; robot_count])
    }

    /// Takes a newer state of a robot's battery.
    pub(crate) fn set(&mut self, robot: RobotId, newest: &Battery) {
        let Some(record) = self.0.get_mut(robot.index()) else { return };
        let mut scale = record.and_then(|before| before.scale);
        let charge = charge(newest, &mut scale);
        *record = Some(Record { newest: *newest, charge, scale, since: None });
    }

    /// Lets states grow old. Call it often: their age is counted from the first call after they came.
    pub(crate) fn tick(&mut self, now: Monotonic) {
        for record in self.0.iter_mut().flatten() {
            record.since.get_or_insert(now);
            // What it sends after a silence may be another driver's.
            record.scale = record.scale.filter(|_| !record.is_stale(now));
        }
    }

    /// Returns what is known of a robot's battery; `None`: it has sent nothing.
    pub(crate) fn status(
        &self,
        robot: RobotId,
        config: &BatteryConfig,
        now: Monotonic,
    ) -> Option<BatteryStatus> {
        self.0.get(robot.index())?.as_ref().map(|record| record.status(config, now))
    }
}

impl Record {
    fn age(&self, now: Monotonic) -> Duration {
        Duration::from_nanos(self.since.map_or(0, |since| now.since(since)))
    }

    fn is_stale(&self, now: Monotonic) -> bool {
        self.age(now) > STALE
    }

    fn status(&self, config: &BatteryConfig, now: Monotonic) -> BatteryStatus {
        let (last_charge, age_s) = (self.charge, self.age(now).as_secs() as f64);
        if self.is_stale(now) {
            return BatteryStatus {
                charge: None,
                voltage_v: None,
                is_charging: None,
                level: None,
                last_charge,
                age_s,
            };
        }
        let voltage_v = self.newest.voltage_v;
        let has_voltage = voltage_v > 0.0 && voltage_v <= VOLTAGE_MAX_V;
        let is_charging = self.newest.status().map(|status| status == PowerSupplyStatus::Charging);
        let level =
            last_charge.filter(|_| is_charging != Some(true)).and_then(|charge| level(config, charge));
        let voltage_v = has_voltage.then(|| rounded(voltage_v, 100.0));
        BatteryStatus { charge: last_charge, voltage_v, is_charging, level, last_charge, age_s }
    }
}

/// Returns the charge over the capacity, 0 to 1, and what its number says of the robot's scale. `None`: it is not measured, no battery is
/// there, or the number is no charge.
fn charge(battery: &Battery, scale: &mut Option<Scale>) -> Option<f64> {
    let number = battery.percentage;
    // A driver that leaves both fields unset says nothing; one that leaves `present` alone unset does.
    if !(0.0..=PERCENT_MAX).contains(&number) || number == 0.0 && battery.is_present == 0 {
        return None;
    }
    let scale = scale.insert(scale.map_or_else(|| Scale::of_first(number), |before| before.after(number)));
    scale.share(number).map(|share| rounded(share.min(1.0), 1000.0))
}

/// Returns how urgent a charge is, 0 to 1.
fn level(config: &BatteryConfig, charge: f64) -> Option<BatteryLevel> {
    if charge < config.critical {
        Some(BatteryLevel::Critical)
    } else {
        (charge < config.low).then_some(BatteryLevel::Low)
    }
}

/// Returns a number with so many parts of one: what it was before it became an `f32`. Zero has no sign.
fn rounded(value: f32, parts: f64) -> f64 {
    (f64::from(value) * parts).round() / parts + 0.0
}

#[cfg(test)]
mod tests;
