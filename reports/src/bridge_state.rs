//! State of the bridge as the person at the laptop reads it: clients, permissions, emergency stop.

use bridge::{BatteryStatus, ClientStatus, RoomOffer};
use serde::{Deserialize, Serialize};
use std::net::IpAddr;

/// State of the bridge: its clients and their permissions.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BridgeState {
    /// Whether the emergency stop is set.
    pub stopped: bool,
    /// Number of stops, and of times that a client has begun to drive, since the bridge's start.
    pub interruptions: u64,
    /// Whether a client drives a robot now.
    pub driven_by_client: bool,
    /// Number of the robot that `/cmd_vel` drives.
    pub selected: usize,
    /// Addresses that asked to drive and wait for an answer, in the order in which they asked.
    pub waiting: Vec<IpAddr>,
    /// Requests of addresses that are not in `waiting`, because it is full.
    #[serde(default)]
    pub unlisted_requests: u64,
    /// Addresses that may drive.
    pub allowed: Vec<IpAddr>,
    /// Addresses that may not drive, whatever else is allowed.
    pub denied: Vec<IpAddr>,
    /// State of every connection of a ros_tcp client.
    pub clients: Vec<ClientStatus>,
    /// Room that a headset offers as the simulators' world, until the operator answers.
    pub room_offer: Option<RoomOffer>,
    /// What is known of each robot's battery, robot1's first; `None`: the robot has sent nothing.
    pub batteries: Vec<Option<BatteryStatus>>,
    /// Which of this state is not in the run's files, why, and what follows from it at a restart; `None`: all is saved, as far as is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_saved: Option<String>,
}

impl BridgeState {
    /// Returns who drives, waits and may drive, the selected robot and the emergency stop, with the batteries: not the counters, which
    /// change all the time.
    pub fn operator_json(&self) -> serde_json::Value {
        let mut json = self.operators_json();
        json["batteries"] = self.batteries_json();
        json
    }

    /// Returns a line about the requests that are not listed; empty if there are none.
    pub fn unlisted_text(&self) -> String {
        match self.unlisted_requests {
            0 => String::new(),
            requests => format!(
                "{requests} requests of further addresses are not listed: answer those that wait, or run mr-slam allow ADDRESS\n"
            ),
        }
    }

    /// Returns the batteries of the robots that have sent their state, without its age.
    pub fn batteries_json(&self) -> serde_json::Value {
        let state = |(robot, battery): (usize, &Option<BatteryStatus>)| {
            battery.map(|BatteryStatus { charge, voltage_v, is_charging, .. }| {
                serde_json::json!({
                    "robot": robot, "charge": charge, "voltage_v": voltage_v, "is_charging": is_charging,
                })
            })
        };
        (1..).zip(&self.batteries).filter_map(state).collect()
    }

    /// Returns the same as [`Self::operator_json`] without the batteries, whose figures change all the time.
    pub fn operators_json(&self) -> serde_json::Value {
        let driving = self.clients.iter().flat_map(|client| {
            let drives = client.drives.iter();
            drives.map(|robot| serde_json::json!({ "robot": robot, "address": client.address }))
        });
        serde_json::json!({
            "selected_robot": self.selected,
            "emergency_stop": self.stopped,
            "drivers": driving.collect::<Vec<_>>(),
            "clients": self.clients.iter().map(|client| client.address).collect::<Vec<_>>(),
            "allowed": self.allowed,
            "waiting": self.waiting,
        })
    }

    /// Formats the clients as a table; a line of text without any.
    pub fn client_table(&self) -> String {
        if self.clients.is_empty() {
            return "no client is connected\n".into();
        }
        let mut text = String::from(
            "  no  address                 since s  silent s  receives  sends  waiting kB  held kB  link kB/s  TF late s  dropped  drives\n",
        );
        for client in &self.clients {
            let drives: Vec<String> = client.drives.iter().map(|robot| format!("robot{robot}")).collect();
            text += format!(
                "{:4}  {:22}  {:7.0}  {:8.1}  {:8}  {:5}  {:10.0}  {:7.0}  {:>9}  {:9.2}  {:7}  {}",
                client.number,
                client.address.to_string(),
                client.connected_s,
                client.silent_s,
                client.subscriptions,
                client.publications,
                client.waiting_bytes as f64 / 1e3,
                client.held_back_bytes as f64 / 1e3,
                client.link_bytes_per_s.map_or("-".into(), |rate| format!("{:.0}", rate / 1e3)),
                client.live_delay_s,
                client.dropped,
                drives.join(" ")
            )
            .trim_end();
            text += "\n";
        }
        text
    }

    /// Formats clients, requests and the emergency stop for a terminal; empty without clients.
    pub fn table(&self) -> String {
        let mut text = String::new();
        if self.stopped {
            text += "EMERGENCY STOP is set: robots do not move until `mr-slam release`\n";
        }
        if let Some(why) = &self.not_saved {
            text += &format!("NOT SAVED: {why}\n");
        }
        for client in &self.clients {
            let ClientStatus { address, subscriptions, publications, waiting_bytes, dropped, .. } = client;
            text += &format!(
                "client {address}: receives {subscriptions} topics, sends {publications}; {:.0} kB waiting, {dropped} messages dropped",
                *waiting_bytes as f64 / 1e3
            );
            if let (Some(rate), true) = (client.link_bytes_per_s, client.held_back_bytes > 0) {
                text += &format!(
                    "; slow link of {:.0} kB/s: transforms are {:.2} s late; {} maps have larger cells, {:.0} kB are held back",
                    rate / 1e3,
                    client.live_delay_s,
                    client.reduced_maps,
                    client.held_back_bytes as f64 / 1e3
                );
            }
            for robot in &client.drives {
                text += &format!(", drives robot{robot}");
            }
            if let Some(clock) = &client.clock {
                text += &format!(
                    "; clock offset {:+.4} s, drift {:+.0} ppm, network delay p50/p95 {:.1}/{:.1} ms above the shortest",
                    clock.offset_s, clock.drift_ppm, clock.spread_p50_ms, clock.spread_p95_ms
                );
            }
            text += "\n";
        }
        for address in &self.waiting {
            text += &format!("{address} asks to drive: mr-slam allow {address}\n");
        }
        text += &self.unlisted_text();
        if let Some(RoomOffer { address, .. }) = self.room_offer {
            text += &format!("{address} offers its room as the world: mr-slam room accept, or refuse\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_shows_slow_and_waiting_clients() {
        let client = ClientStatus {
            number: 3,
            connected_s: 75.0,
            silent_s: 0.25,
            address: "10.0.0.7:4321".parse().unwrap(),
            subscriptions: 12,
            publications: 1,
            waiting_bytes: 2_000_000,
            link_bytes_per_s: Some(61_000.0),
            held_back_bytes: 150_000,
            reduced_maps: 1,
            live_delay_s: 0.31,
            dropped: 345,
            drives: vec![2],
            clock: None,
        };
        let waiting = vec!["10.0.0.8".parse().unwrap()];
        let state = BridgeState { clients: vec![client], waiting, ..BridgeState::default() };
        let row = "   3  10.0.0.7:4321                75       0.2        12      1        2000      150         61       0.31      345  robot2\n";
        assert!(state.client_table().ends_with(row), "{}", state.client_table());
        let lines = state.table();
        assert!(
            lines.contains(
                "10.0.0.7:4321: receives 12 topics, sends 1; 2000 kB waiting, 345 messages dropped; slow link of 61 kB/s: transforms are 0.31 s late; 1 maps have larger cells, 150 kB are held back, drives robot2\n"
            )
        );
        assert!(lines.contains("10.0.0.8 asks to drive: mr-slam allow 10.0.0.8\n"));
        assert!(!lines.contains("EMERGENCY"));
        let room_offer = Some(RoomOffer { address: [10, 0, 0, 9].into(), bytes: 400_000 });
        let lines = BridgeState { room_offer, ..BridgeState::default() }.table();
        assert!(lines.contains("10.0.0.9 offers its room as the world: mr-slam room accept, or refuse\n"));
        let not_saved = Some("no room".into());
        assert!(BridgeState { not_saved, ..BridgeState::default() }.table().contains("NOT SAVED: no room"));
        assert!(
            BridgeState { stopped: true, ..BridgeState::default() }.table().contains("EMERGENCY STOP is set")
        );
    }
}
