//! The robots' batteries in a fleet's figures.

use super::{FleetView, RobotView};
use crate::BridgeState;
use ::bridge::{BatteryLevel, BatteryStatus};

impl FleetView {
    /// Adds the bridge's state, and what it knows of the robots' batteries.
    #[must_use]
    pub fn with_bridge(mut self, bridge: Option<BridgeState>) -> Self {
        let batteries = bridge.iter().flat_map(|bridge| &bridge.batteries);
        for (robot, battery) in self.robots.iter_mut().zip(batteries) {
            robot.battery = *battery;
        }
        self.bridge = bridge;
        self
    }

    /// Says how full the batteries are of the robots that tell it; `None`: none does.
    pub(super) fn battery_note(&self) -> Option<String> {
        let reported = |robot: &RobotView| Some(format!("{} {}", robot.robot, describe(&robot.battery?)));
        let reported: Vec<String> = self.robots.iter().filter_map(reported).collect();
        (!reported.is_empty()).then(|| format!("battery  {}", reported.join("   ")))
    }
}

impl RobotView {
    /// Says that the battery is low, if it is.
    pub(super) fn battery_alarm(&self) -> Option<String> {
        let battery = self.battery?;
        let left = percent(battery.charge?);
        Some(match battery.level? {
            BatteryLevel::Low => format!("{}'s battery is low: {left}", self.robot),
            BatteryLevel::Critical => format!("{}'s battery is almost empty: {left}", self.robot),
        })
    }
}

/// Returns the state of a battery in a few words.
fn describe(battery: &BatteryStatus) -> String {
    let BatteryStatus { charge, voltage_v, is_charging, last_charge, age_s, .. } = *battery;
    let mut words: Vec<String> = charge.map(percent).into_iter().collect();
    words.extend(voltage_v.map(|volts| format!("{volts:.1} V")));
    if words.is_empty() {
        let before = last_charge.map(|charge| format!(", was {}", percent(charge))).unwrap_or_default();
        return format!("not known{before}, {age_s:.0} s ago");
    }
    if is_charging == Some(true) {
        words.push("charging".into());
    }
    words.join(", ")
}

/// Returns a share in percent: rounded down, so that no warning contradicts it.
fn percent(share: f64) -> String {
    format!("{:.0} %", (100.0 * share + 1e-9).floor())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Style;
    use msg::FleetStats;

    fn battery(charge: f64) -> BatteryStatus {
        let charge = Some(charge);
        BatteryStatus {
            charge,
            voltage_v: Some(11.26),
            is_charging: None,
            level: None,
            last_charge: charge,
            age_s: 0.0,
        }
    }

    fn fleet(batteries: &[Option<BatteryStatus>]) -> FleetView {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        stats.robot_count = batteries.len() as u32;
        let bridge = BridgeState { batteries: batteries.to_vec(), ..BridgeState::default() };
        FleetView::new(&stats).with_bridge(Some(bridge))
    }

    #[test]
    fn a_battery_is_shown_where_a_robot_tells_it() {
        let style = Style { width: 200, is_coloured: false };
        for text in [fleet(&[None, None]).table(&style), fleet(&[None, None]).live_table(&style)] {
            assert!(!text.contains("battery"), "{text}");
        }
        let stale = BatteryStatus {
            charge: None,
            voltage_v: None,
            last_charge: Some(0.08),
            age_s: 45.0,
            ..battery(0.08)
        };
        let unknown = BatteryStatus { last_charge: None, ..stale };
        let charging = BatteryStatus { is_charging: Some(true), ..battery(0.129) };
        let all = fleet(&[Some(battery(0.42)), None, Some(charging), Some(stale), Some(unknown)]);
        for text in [all.table(&style), all.live_table(&style)] {
            let line = "battery  robot1 42 %, 11.3 V   robot3 12 %, 11.3 V, charging   robot4 not known, was 8 %, 45 s ago   \
                        robot5 not known, 45 s ago\n";
            assert!(text.contains(line), "{text}");
        }
        let json = serde_json::to_value(&all.robots).unwrap();
        assert_eq!(
            (&json[0]["battery"]["charge"], &json[1]["battery"]),
            (&0.42.into(), &serde_json::Value::Null)
        );
        assert!(json[3]["battery"]["charge"].is_null() && json[3]["battery"]["age_s"] == 45.0);
    }

    #[test]
    fn a_low_battery_is_an_alarm() {
        let low = BatteryStatus { level: Some(BatteryLevel::Low), ..battery(0.199) };
        let critical = BatteryStatus { level: Some(BatteryLevel::Critical), ..battery(0.08) };
        let alarms = fleet(&[Some(low), Some(critical), Some(battery(0.9))]).alarms();
        assert_eq!(alarms, ["robot1's battery is low: 19 %", "robot2's battery is almost empty: 8 %"]);
    }
}
