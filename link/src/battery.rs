//! State of a battery in a message: its numbers in the order of ROS's message, without a header.

use crate::error::WireError;
use crate::reader::Reader;
use msg::{Battery, Monotonic};
use std::time::Duration;

/// A state that has waited longer for a base is not sent: it would look like the battery's state of now.
const WAIT_MAX: Duration = Duration::from_secs(5);

/// The newest state of the robot's battery, until it is sent.
#[derive(Debug, Default)]
pub struct WaitingBattery(Option<(Battery, Monotonic)>);

impl WaitingBattery {
    /// Takes a newer state.
    pub fn put(&mut self, battery: &Battery, now: Monotonic) {
        self.0 = Some((*battery, now));
    }

    /// Takes the state that is to be sent now, if there is one that is not too old.
    pub fn take(&mut self, now: Monotonic) -> Option<Battery> {
        let (battery, since) = self.0.take()?;
        (now <= since + WAIT_MAX).then_some(battery)
    }
}

pub fn write_battery(to: &mut Vec<u8>, battery: &Battery) {
    let power = [battery.voltage_v, battery.temperature_c, battery.current_a];
    let charge = [battery.charge_ah, battery.capacity_ah, battery.design_capacity_ah, battery.percentage];
    power.iter().chain(&charge).for_each(|value| to.extend(value.to_le_bytes()));
    to.extend([battery.power_supply_status, battery.health, battery.technology, battery.is_present]);
}

pub fn read_battery(from: &mut Reader<'_>) -> Result<Battery, WireError> {
    let mut battery = Battery {
        voltage_v: from.f32()?,
        temperature_c: from.f32()?,
        current_a: from.f32()?,
        charge_ah: from.f32()?,
        capacity_ah: from.f32()?,
        design_capacity_ah: from.f32()?,
        percentage: from.f32()?,
        ..Battery::default()
    };
    [battery.power_supply_status, battery.health, battery.technology, battery.is_present] = from.array()?;
    Ok(battery)
}
