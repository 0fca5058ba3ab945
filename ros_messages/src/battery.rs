//! sensor_msgs/BatteryState: the whole message, and the part of it that the fleet has.
//!
//! Fields of ROS 2, and of ROS 1 from Noetic on; before, ROS 1 had no temperatures.

use crate::cdr::{DecodeError, Reader, Writer};
use crate::message::Message;
use crate::{read, write};
use msg::{Battery, Stamp};

/// sensor_msgs/BatteryState: the state of a battery. NaN is not measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BatteryState {
    /// Frame in the header; mostly empty.
    pub frame_id: String,
    /// Numbers of the battery. `header.stamp` is the message's.
    pub battery: Battery,
    /// Voltage of each cell, V.
    pub cell_voltage: Vec<f32>,
    /// Temperature of each cell, degrees Celsius.
    pub cell_temperature: Vec<f32>,
    /// Slot or other place of the battery in the robot.
    pub location: String,
    /// Best guess at its serial number.
    pub serial_number: String,
}

impl Message for BatteryState {
    const TYPE: &'static str = "sensor_msgs/BatteryState";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (frame_id, battery) = read_numbers(from)?;
        Ok(Self {
            frame_id: frame_id.to_owned(),
            battery,
            cell_voltage: from.f32_seq("cell_voltage")?,
            cell_temperature: from.f32_seq("cell_temperature")?,
            location: from.string("location")?.to_owned(),
            serial_number: from.string("serial_number")?.to_owned(),
        })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write_numbers(to, &self.frame_id, self.battery.header.stamp, &self.battery);
        to.f32_seq(&self.cell_voltage);
        to.f32_seq(&self.cell_temperature);
        to.string(&self.location);
        to.string(&self.serial_number);
    }
}

/// Reads the numbers of sensor_msgs/BatteryState, and checks what follows them. Of the header `stamp` is the message's.
pub fn read_battery(from: &mut Reader<'_>) -> Result<Battery, DecodeError> {
    let (_, battery) = read_numbers(from)?;
    drop(from.f32s("cell_voltage")?);
    drop(from.f32s("cell_temperature")?);
    from.string("location")?;
    from.string("serial_number")?;
    Ok(battery)
}

/// Writes sensor_msgs/BatteryState with the numbers that the fleet has, without cells and texts.
pub fn write_battery(to: &mut Writer<'_>, battery: &Battery) {
    write_numbers(to, "", battery.header.stamp, battery);
    (0..2).for_each(|_| to.count(0));
    (0..2).for_each(|_| to.string(""));
}

/// Reads the message up to its cells: the frame, and the numbers.
fn read_numbers<'a>(from: &mut Reader<'a>) -> Result<(&'a str, Battery), DecodeError> {
    let (stamp, frame_id) = read::header(from)?;
    let mut battery = Battery {
        voltage_v: from.f32("voltage")?,
        temperature_c: from.f32("temperature")?,
        current_a: from.f32("current")?,
        charge_ah: from.f32("charge")?,
        capacity_ah: from.f32("capacity")?,
        design_capacity_ah: from.f32("design_capacity")?,
        percentage: from.f32("percentage")?,
        power_supply_status: from.u8("power_supply_status")?,
        health: from.u8("power_supply_health")?,
        technology: from.u8("power_supply_technology")?,
        is_present: u8::from(from.bool("present")?),
        ..Battery::default()
    };
    battery.header.stamp = stamp;
    Ok((frame_id, battery))
}

fn write_numbers(to: &mut Writer<'_>, frame_id: &str, stamp: Stamp, battery: &Battery) {
    write::header(to, stamp, frame_id);
    let power = [battery.voltage_v, battery.temperature_c, battery.current_a];
    let charge = [battery.charge_ah, battery.capacity_ah, battery.design_capacity_ah, battery.percentage];
    power.iter().chain(&charge).for_each(|value| to.f32(*value));
    [battery.power_supply_status, battery.health, battery.technology]
        .into_iter()
        .for_each(|code| to.u8(code));
    to.bool(battery.is_present != 0);
}
