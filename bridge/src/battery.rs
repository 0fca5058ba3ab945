//! What is known of the robots' batteries, as the operator sees it.
//!
//! ROS defines `percentage` as 0 to 1. Some drivers count to 100: ROBOTIS's for the TurtleBot3 passes on the OpenCR's percent,
//! 0 at 10.5 V, 100 at 12.3 V and 117 for a full battery (`update_battery_status_to_table` in OpenCR's `turtlebot3_ros2`).
//! A robot counts in percent once it has sent more than [`FRACTION_MAX`], until it has been silent for [`STALE`].

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
    /// Whether the robot counts in percent.
    is_percent: bool,
    /// When the state was first seen; `None` until the first tick after it came.
    since: Option<Monotonic>,
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
        let counts_in_percent = newest.percentage > FRACTION_MAX && newest.percentage <= PERCENT_MAX;
        let is_percent = counts_in_percent || record.is_some_and(|before| before.is_percent);
        let charge = charge(newest, is_percent);
        *record = Some(Record { newest: *newest, charge, is_percent, since: None });
    }

    /// Lets states grow old. Call it often: their age is counted from the first call after they came.
    pub(crate) fn tick(&mut self, now: Monotonic) {
        for record in self.0.iter_mut().flatten() {
            record.since.get_or_insert(now);
            // What it sends after a silence may be another driver's.
            record.is_percent &= !record.is_stale(now);
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

/// Returns the charge over the capacity, 0 to 1. `None`: it is not measured, no battery is there, or the number is no charge.
fn charge(battery: &Battery, is_percent: bool) -> Option<f64> {
    // A driver that leaves both fields unset says nothing; one that leaves `present` alone unset does.
    if battery.percentage == 0.0 && battery.is_present == 0 {
        return None;
    }
    let share = match battery.percentage {
        percent if is_percent && (0.0..=PERCENT_MAX).contains(&percent) => percent / 100.0,
        share if !is_percent && (0.0..=1.0).contains(&share) => share,
        // Above 1 it may be a full battery by its voltage, or an empty one in percent.
        _ => return None,
    };
    Some(rounded(share.min(1.0), 1000.0))
}

/// Returns how urgent a charge is, 0 to 1.
fn level(config: &BatteryConfig, charge: f64) -> Option<BatteryLevel> {
    if charge < config.critical {
        Some(BatteryLevel::Critical)
    } else {
        (charge < config.low).then_some(BatteryLevel::Low)
    }
}

/// Returns a number with so many parts of one: what it was before it became an `f32`.
fn rounded(value: f32, parts: f64) -> f64 {
    (f64::from(value) * parts).round() / parts
}

#[cfg(test)]
mod tests;
