//! State of a robot's battery, as the robot reports it.

use crate::Header;
use bytemuck::{Pod, Zeroable};

/// Whether a battery is being charged (sensor_msgs/BatteryState, `power_supply_status`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PowerSupplyStatus {
    /// It is being charged.
    Charging = 1,
    /// It supplies the robot.
    Discharging = 2,
    /// It is neither charged nor drained.
    NotCharging = 3,
    /// It is full, and not charged any more.
    Full = 4,
}

/// State of a battery (sensor_msgs/BatteryState without cells and texts). Values are as the robot sends them; NaN is not measured.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Battery {
    /// Header whose `stamp` is the time at which the message arrived, on the run's clock.
    pub header: Header,
    /// Voltage at its terminals, V.
    pub voltage_v: f32,
    /// Temperature, degrees Celsius.
    pub temperature_c: f32,
    /// Current, A; negative while the battery is drained.
    pub current_a: f32,
    /// Charge that is left, Ah.
    pub charge_ah: f32,
    /// Charge of the full battery when it was last full, Ah.
    pub capacity_ah: f32,
    /// Charge of the full battery when it was new, Ah.
    pub design_capacity_ah: f32,
    /// Charge over capacity: 0 to 1 by ROS's definition, 0 to 100 by some drivers.
    pub percentage: f32,
    /// Code of [`PowerSupplyStatus`]; 0: not known.
    pub power_supply_status: u8,
    /// Code of the battery's health in ROS; 0: not known.
    pub health: u8,
    /// Code of the battery's chemistry in ROS; 0: not known.
    pub technology: u8,
    /// Whether there is a battery: 0 or 1.
    pub is_present: u8,
}

impl Battery {
    /// Returns whether the battery is being charged; `None`: the robot does not say.
    pub fn status(&self) -> Option<PowerSupplyStatus> {
        use PowerSupplyStatus::{Charging, Discharging, Full, NotCharging};
        [Charging, Discharging, NotCharging, Full]
            .into_iter()
            .find(|status| *status as u8 == self.power_supply_status)
    }
}
