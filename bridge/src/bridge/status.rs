//! The state of the fleet as the operator's page shows it.

use super::Bridge;
use crate::battery::{BatteryLevel, BatteryStatus};
use crate::core::Core;
use crate::drive::DriveClient;
use crate::drive::velocity_gate::RobotLimits;
use crate::room_offer::RoomOffer;
use crate::router::ClientId;
use msg::{Distribution, FleetStats, MAP_OLD_AFTER_S, Monotonic, RobotId, RobotStats, TrackingState};
use serde::Serialize;

/// The state of the fleet. What is not known is left out of the JSON: the protocol's values have no null.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct FleetStatus {
    /// The robots, in order of their numbers.
    pub robots: Vec<RobotStatus>,
    /// Known area of the merged map, square metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    merged_known_m2: Option<f64>,
    /// Known cells of the merged map over the observable cells of the room, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    room_coverage: Option<f64>,
    /// Share of commonly known cells on which the robots' maps agree, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    consistency: Option<f64>,
    /// The same by chance, under wrong transforms.
    #[serde(skip_serializing_if = "Option::is_none")]
    null_consistency: Option<f64>,
    /// Pairs of maps that overlap.
    #[serde(skip_serializing_if = "Option::is_none")]
    overlapping_pairs: Option<u32>,
    /// The room that a headset offers as the simulators' world, until the operator answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    room_offer: Option<RoomOffer>,
    /// Whether a recording is shown: nobody drives, and an emergency stop stops nothing.
    is_replay: bool,
}

/// The state of one robot.
// More than 12 fields: one row of figures, as the page shows it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct RobotStatus {
    /// The beginning of its topics' names, such as `/robot1/`.
    prefix: String,
    /// Number, from 1.
    number: usize,
    /// Who drives it: an address, or `ROS 2`.
    #[serde(skip_serializing_if = "Option::is_none")]
    driver: Option<String>,
    /// Whether this client drives it: it may use the driver's lease.
    is_mine: bool,
    /// Largest speed forward and backward, m/s.
    linear_max_m_s: f64,
    /// Largest turning rate, rad/s.
    angular_max_rad_s: f64,
    /// State of SLAM, such as `tracking`.
    #[serde(skip_serializing_if = "Option::is_none")]
    slam: Option<&'static str>,
    /// Scans that reached SLAM in the last second.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_hz: Option<f64>,
    /// Scans lost since telemetry was started; missing where SLAM is on another machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    scans_lost: Option<u64>,
    /// Time over which lost scans and the delays are counted, seconds: since telemetry was started last.
    #[serde(skip_serializing_if = "Option::is_none")]
    counted_s: Option<f64>,
    /// Age of the maps from which figures of maps were computed, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    maps_age_s: Option<f64>,
    /// Known cells over all cells of its map, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    coverage: Option<f64>,
    /// Known area of its map, square metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    known_m2: Option<f64>,
    /// Width and height of its map, cells.
    #[serde(skip_serializing_if = "Option::is_none")]
    map_cells: Option<[u32; 2]>,
    /// Scan to pose, milliseconds: median and 95th percentile.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_to_pose_ms: Option<[f32; 2]>,
    /// Scan to map, milliseconds: median and 95th percentile.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan_to_map_ms: Option<[f32; 2]>,
    /// Nodes of the pose graph.
    #[serde(skip_serializing_if = "Option::is_none")]
    nodes: Option<u32>,
    /// Loop closures of the pose graph.
    #[serde(skip_serializing_if = "Option::is_none")]
    closures: Option<u32>,
    /// Whether its map is part of the merged map.
    #[serde(skip_serializing_if = "Option::is_none")]
    is_merged: Option<bool>,
    /// Age of its part of the merged map, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    map_age_s: Option<f64>,
    /// Whether that part is old: nothing comes from its SLAM.
    #[serde(skip_serializing_if = "Option::is_none")]
    is_map_old: Option<bool>,
    /// State of its battery, if it has sent one.
    #[serde(skip_serializing_if = "Option::is_none")]
    battery: Option<KnownBattery>,
}

/// A battery's state without what is not known of it: see [`BatteryStatus`].
#[derive(Clone, Debug, PartialEq, Serialize)]
struct KnownBattery {
    #[serde(skip_serializing_if = "Option::is_none")]
    charge: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    voltage_v: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    is_charging: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    level: Option<BatteryLevel>,
    #[serde(skip_serializing_if = "Option::is_none")]
    last_charge: Option<f64>,
    age_s: f64,
}

impl From<BatteryStatus> for KnownBattery {
    fn from(status: BatteryStatus) -> Self {
        let BatteryStatus { charge, voltage_v, is_charging, level, last_charge, age_s } = status;
        Self { charge, voltage_v, is_charging, level, last_charge, age_s }
    }
}

impl Bridge {
    /// Returns the newest time of the run, seconds.
    pub(crate) fn run_time_s(&self) -> f64 {
        self.core.borrow().fleet.now().0 as f64 * 1e-9
    }

    /// Returns the state of the fleet for a client.
    pub(crate) fn fleet_status(&self, viewer: ClientId, now: Monotonic) -> FleetStatus {
        let core = self.core.borrow();
        let stats = core.stats.get();
        let finite = |value: fn(&FleetStats) -> f64| stats.map(value).filter(|value| value.is_finite());
        FleetStatus {
            robots: core.fleet.robots().map(|robot| robot_status(&core, robot, viewer, now)).collect(),
            merged_known_m2: stats.map(|stats| known_m2(&stats.merged_map)),
            room_coverage: finite(|stats| stats.room_coverage),
            consistency: finite(|stats| stats.consistency)
                .filter(|_| stats.is_some_and(|s| s.pair_count > 0)),
            null_consistency: finite(|stats| stats.null_consistency_mean)
                .filter(|_| stats.is_some_and(|stats| stats.null_count > 0)),
            overlapping_pairs: stats.map(|stats| stats.pair_count),
            room_offer: core.access.room_offer(),
            is_replay: core.access.is_replay,
        }
    }

    /// Returns what is known of each robot's battery, robot1's first; `None`: it has sent nothing.
    pub fn batteries(&self, now: Monotonic) -> Vec<Option<BatteryStatus>> {
        let core = self.core.borrow();
        let status = |robot| core.batteries.status(robot, &core.config.battery, now);
        core.fleet.robots().map(status).collect()
    }

    /// Lets the operator's page say that a recording is shown, and offer nothing that moves robots.
    pub fn mark_replay(&self) {
        self.core.borrow_mut().access.is_replay = true;
    }
}

fn robot_status(core: &Core, robot: RobotId, viewer: ClientId, now: Monotonic) -> RobotStatus {
    let stats = core.stats.get().map(|stats| &stats.robots[robot.index()]);
    let driver = core.gate.drive().leaseholder(robot, now);
    let limits = RobotLimits::new(&core.config.velocity, robot);
    RobotStatus {
        prefix: core.fleet.robot_names().topic(robot, ""),
        number: robot.number(),
        driver: driver.map(|driver| driver_name(core, driver)),
        is_mine: driver.is_some_and(|driver| driver.is_same(&core.driver(viewer))),
        linear_max_m_s: limits.linear_m_s,
        angular_max_rad_s: limits.angular_rad_s,
        slam: stats.and_then(|stats| TrackingState::from_code(stats.state)).map(TrackingState::name),
        scan_hz: stats.map(|stats| stats.scan_hz),
        scans_lost: stats.filter(|stats| stats.scans_lost_unknown == 0).map(|stats| stats.scans_lost),
        counted_s: core.stats.get().map(|stats| stats.counted_s),
        maps_age_s: core.stats.get().map(|stats| stats.maps_age_s).filter(|age_s| age_s.is_finite()),
        coverage: stats.map(|stats| stats.coverage).filter(|coverage| coverage.is_finite()),
        known_m2: stats.map(known_m2),
        map_cells: stats.map(|stats| [stats.width, stats.height]),
        scan_to_pose_ms: stats.and_then(|stats| percentiles(&stats.scan_to_pose_ms)),
        scan_to_map_ms: stats.and_then(|stats| percentiles(&stats.scan_to_map_ms)),
        nodes: stats.map(|stats| stats.nodes),
        closures: stats.map(|stats| stats.closures),
        is_merged: stats.map(|stats| stats.is_merged == 1),
        map_age_s: stats.map(|stats| stats.map_age_s).filter(|age_s| age_s.is_finite()),
        is_map_old: stats.map(|stats| stats.is_merged == 1 && stats.map_age_s > MAP_OLD_AFTER_S),
        battery: core.batteries.status(robot, &core.config.battery, now).map(Into::into),
    }
}

fn driver_name(core: &Core, driver: DriveClient) -> String {
    let peer = driver.client.and_then(|id| core.router.client(id)).map(|client| client.peer.to_string());
    peer.or_else(|| driver.address.map(|address| address.to_string())).unwrap_or_else(|| "ROS 2".into())
}

fn known_m2(stats: &RobotStats) -> f64 {
    f64::from(stats.free_cells + stats.occupied_cells) * stats.resolution_m * stats.resolution_m
}

fn percentiles(measured: &Distribution) -> Option<[f32; 2]> {
    (measured.count > 0).then_some([measured.p50, measured.p95])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::BridgeConfig;
    use std::time::Duration;

    #[test]
    fn after_a_restart_a_robot_is_that_clients_whose_address_drove_it_before() {
        let bridge = Bridge::new(BridgeConfig::default(), 1, |_, _| {}).unwrap();
        let mut connect = |peer: &str| bridge.core.borrow_mut().connect(peer.parse().unwrap(), None).unwrap();
        let [former, other] = ["127.0.0.1:5000", "127.0.0.2:5000"].map(&mut connect);
        let (robot, until) = (RobotId::new(1).unwrap(), Monotonic(0) + Duration::from_secs(4));
        bridge.restore_driver(robot, Some("127.0.0.1".parse().unwrap()), until);
        let is_mine = |viewer, now| bridge.fleet_status(viewer, now).robots[0].is_mine;
        assert!(is_mine(former, Monotonic(0)), "it may drive on");
        assert!(!is_mine(other, Monotonic(0)));
        assert!(!is_mine(former, until), "the lease is over");
    }
}
