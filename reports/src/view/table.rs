//! Tables of a fleet's figures for a terminal.

use super::layout::{Cell, Column, Emphasis, Style, table};
use super::{DistributionView, FleetView};
use crate::BridgeState;
use bridge::ClientStatus;

/// Indent of wrapped lines below a name.
const INDENT: usize = 9;
/// Clients that the live table lists; `mr-slam status` lists all.
const LIVE_CLIENTS_MAX: usize = 2;
/// Age of maps above which tables say it: their figures come once a second.
const MAPS_AGE_MAX_S: f64 = 3.0;
/// F1 of occupied cells below which a map shares almost nothing with the room's walls.
const ROOM_F1_MIN: f64 = 0.05;

const ROBOT_COLUMNS: [Column; 8] = [
    Column { heading: ["robot", ""], width: 8, is_left: true, drop_order: 0 },
    Column { heading: ["state", ""], width: 10, is_left: true, drop_order: 0 },
    Column { heading: ["scans", "Hz"], width: 8, is_left: false, drop_order: 1 },
    Column { heading: ["lost", "scans"], width: 6, is_left: false, drop_order: 3 },
    Column { heading: ["coverage", "%"], width: 9, is_left: false, drop_order: 2 },
    Column { heading: ["TF jitter", "p50 / p99 ms"], width: 16, is_left: false, drop_order: 5 },
    Column { heading: ["scan to pose", "p50 / p99 ms"], width: 16, is_left: false, drop_order: 6 },
    Column { heading: ["pose error", "m"], width: 10, is_left: false, drop_order: 4 },
];

const PROCESS_COLUMNS: [Column; 10] = [
    Column { heading: ["process", ""], width: 16, is_left: true, drop_order: 0 },
    Column { heading: ["pid", ""], width: 8, is_left: false, drop_order: 3 },
    Column { heading: ["state", ""], width: 13, is_left: true, drop_order: 0 },
    Column { heading: ["restarts", ""], width: 8, is_left: false, drop_order: 1 },
    Column { heading: ["received", ""], width: 9, is_left: false, drop_order: 7 },
    Column { heading: ["lost", ""], width: 6, is_left: false, drop_order: 6 },
    Column { heading: ["dropped", ""], width: 8, is_left: false, drop_order: 8 },
    Column { heading: ["work p50/max us", ""], width: 15, is_left: false, drop_order: 9 },
    Column { heading: ["memory MB", ""], width: 9, is_left: false, drop_order: 4 },
    Column { heading: ["CPU s", ""], width: 8, is_left: false, drop_order: 5 },
];

impl FleetView {
    /// Formats all figures of robots, merging and clients for a terminal, and what is wrong first.
    pub fn table(&self, style: &Style) -> String {
        let mut text = self.alarm_lines(style) + &self.figures(style);
        for line in self
            .bridge
            .iter()
            .flat_map(|bridge| bridge.table().lines().map(str::to_owned).collect::<Vec<_>>())
        {
            text += &style.wrap(&line, INDENT);
        }
        text
    }

    /// Formats the figures for the live table: what is wrong first, and few lines for many clients.
    pub fn live_table(&self, style: &Style) -> String {
        let mut text = self.alarm_lines(style);
        let waiting = self.bridge.iter().flat_map(|bridge| &bridge.waiting);
        for address in waiting.clone().take(LIVE_CLIENTS_MAX) {
            let line = format!("? {address} asks to drive: key a, or mr-slam allow {address}");
            text += &paint_lines(&style.wrap(&line, 2), style, Emphasis::Attention);
        }
        let more = waiting.count().saturating_sub(LIVE_CLIENTS_MAX);
        if more > 0 {
            text += &style.wrap(&format!("? {more} more ask to drive: mr-slam allow"), 2);
        }
        if let Some(offer) = self.bridge.as_ref().and_then(|bridge| bridge.room_offer) {
            let line =
                format!("? {} offers its room as the world: mr-slam room accept, or refuse", offer.address);
            text += &paint_lines(&style.wrap(&line, 2), style, Emphasis::Attention);
        }
        text += &self.figures(style);
        if let Some(bridge) = &self.bridge {
            text += &client_lines(bridge, style);
        }
        text
    }

    /// Says since when figures are counted, if that is not the start of the run: telemetry was started again. Rates and lost scans of
    /// the whole run are not among them.
    pub fn counting_note(&self) -> Option<String> {
        let is_again = |process: &super::ProcessView| {
            process.process == msg::Role::Telemetry.name() && process.restarts > 0
        };
        let is_of_run = self.robots.iter().any(|robot| robot.scan_hz.is_some());
        let what = if is_of_run { "jitter and latencies" } else { "jitter, latencies and lost scans" };
        self.processes
            .iter()
            .any(is_again)
            .then(|| format!("{what} are of the last {:.0} s: telemetry was started again", self.counted_s))
    }

    /// Says how old the maps are of which figures are shown, if their comparison takes long.
    fn maps_note(&self) -> Option<String> {
        let age_s = self.maps_age_s.filter(|age_s| *age_s > MAPS_AGE_MAX_S)?;
        Some(format!("coverage and comparisons are of maps that are {age_s:.0} s old"))
    }

    fn alarm_lines(&self, style: &Style) -> String {
        let lines =
            |alarm: String| paint_lines(&style.wrap(&format!("! {alarm}"), 2), style, Emphasis::Alarm);
        self.alarms().into_iter().map(lines).collect()
    }

    fn figures(&self, style: &Style) -> String {
        let rows: Vec<Vec<Cell>> = self.robots.iter().map(robot_row).collect();
        let mut text = table(&ROBOT_COLUMNS, &rows, style) + &self.name_line(style);
        if let Some(note) = self.battery_note() {
            text += &style.wrap(&note, INDENT);
        }
        if let Some(note) = self.counting_note() {
            text += &style.wrap(&format!("counted  {note}"), INDENT);
        }
        if let Some(note) = self.maps_note() {
            text += &style.wrap(&format!("maps     {note}"), INDENT);
        }
        let percent = |value: Option<f64>| value.map_or_else(|| "-".into(), |v| format!("{:.1}%", 100.0 * v));
        text += &style.wrap(
            &format!(
                "merged   room covered {}   consistency {} ({} within one cell)   occupied F1 {}   over {}   by chance: {}, F1 {}",
                percent(self.room_coverage),
                percent(self.consistency),
                percent(self.consistency_one_cell),
                percent(self.occupied_f1),
                self.overlap_m2.map_or_else(|| "-".into(), |m2| format!("{m2:.1} m2")),
                percent(self.null_consistency_mean),
                percent(self.null_f1_mean),
            ),
            INDENT,
        );
        let is_elsewhere = self.against_room.as_ref().is_some_and(|room| room.occupied_f1 < ROOM_F1_MIN);
        if is_elsewhere {
            text +=
                &style.wrap("room     the merged map shares almost nothing with the room's walls", INDENT);
        }
        text + &self.merge_lines(style)
    }

    /// Says which robot has which name of its own, if one has.
    fn name_line(&self, style: &Style) -> String {
        let named =
            |robot: &super::RobotView| robot.name.as_ref().map(|name| format!("{} is {name}", robot.robot));
        let names: Vec<String> = self.robots.iter().filter_map(named).collect();
        if names.is_empty() {
            String::new()
        } else {
            style.wrap(&format!("robots   {}", names.join("   ")), INDENT)
        }
    }

    /// Lists the robots that are not in the merged map, and the edges that were found.
    fn merge_lines(&self, style: &Style) -> String {
        let of = |merged: bool| {
            let robots = self.robots.iter().filter(|robot| robot.merged == merged);
            robots.map(|robot| robot.robot.as_str()).collect::<Vec<_>>().join(", ")
        };
        let mut text = String::new();
        let (merged, unmerged) = (of(true), of(false));
        if !unmerged.is_empty() {
            let merged = if merged.is_empty() { "no robot" } else { &merged };
            let line = format!(
                "         merged map of {merged}; place of {unmerged} not known (each keeps its own map)"
            );
            text += &style.wrap(&line, INDENT);
        }
        for edge in self.merge_edges.iter().filter(|edge| edge.was_found()) {
            text += &style.wrap(&format!("         {edge}"), INDENT);
        }
        text
    }

    /// Formats the processes' figures for a terminal.
    pub fn process_table(&self, style: &Style) -> String {
        let row = |p: &super::ProcessView| -> Vec<Cell> {
            vec![
                p.process.as_str().into(),
                if p.pid == 0 { "-".into() } else { p.pid.to_string().into() },
                Cell::alarm_if(p.state != "up", p.state),
                p.restarts.to_string().into(),
                p.received.to_string().into(),
                p.lost.to_string().into(),
                p.dropped.to_string().into(),
                format!("{:.0}/{:<6.0}", p.work_p50_us, p.work_max_us).into(),
                format!("{:.1}", p.memory_mb).into(),
                format!("{:.1}", p.cpu_s).into(),
            ]
        };
        table(&PROCESS_COLUMNS, &self.processes.iter().map(row).collect::<Vec<_>>(), style)
    }
}

fn robot_row(robot: &super::RobotView) -> Vec<Cell> {
    vec![
        robot.robot.as_str().into(),
        Cell::alarm_if(robot.is_lost() || robot.is_unreliable() || robot.has_stale_scans(), robot.state),
        Cell::alarm_if(robot.has_stale_scans(), format!("{:.2}", robot.scan_hz_last_second)),
        robot.scans_lost.map_or_else(|| "-".into(), |lost| lost.to_string()).into(),
        format!("{:.1}", 100.0 * robot.map.coverage).into(),
        robot.tf_jitter_ms.p50_and_p99().into(),
        robot.scan_to_pose_ms.p50_and_p99().into(),
        robot.pose_error_m.map_or_else(|| "-".into(), |error| format!("{error:.3}")).into(),
    ]
}

fn client_lines(bridge: &BridgeState, style: &Style) -> String {
    let mut text = String::new();
    for client in bridge.clients.iter().take(LIVE_CLIENTS_MAX) {
        let ClientStatus { address, subscriptions, waiting_bytes, dropped, drives, .. } = client;
        let mut line = format!("client   {address}");
        drives.iter().for_each(|robot| line += &format!("   drives robot{robot}"));
        line += &format!("   {subscriptions} topics");
        if *waiting_bytes > 0 {
            line += &format!("   {:.0} kB waiting", *waiting_bytes as f64 / 1e3);
        }
        if *dropped > 0 {
            line += &format!("   {dropped} dropped");
        }
        text += &style.wrap(&line, INDENT);
    }
    let more = bridge.clients.len().saturating_sub(LIVE_CLIENTS_MAX);
    if more > 0 {
        text += &style.wrap(&format!("         and {more} more clients: mr-slam status"), INDENT);
    }
    text
}

fn paint_lines(text: &str, style: &Style, emphasis: Emphasis) -> String {
    text.lines().map(|line| style.paint(line, emphasis) + "\n").collect()
}

impl DistributionView {
    fn p50_and_p99(&self) -> String {
        match (self.p50, self.p99) {
            (Some(p50), Some(p99)) => format!("{p50:.3} / {p99:.3}"),
            _ => "-".into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{FleetStats, Role, TrackingState};

    /// A fleet in which everything is wrong, with many clients.
    fn fleet() -> FleetView {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        stats.robot_count = 3;
        for robot in &mut stats.robots[..3] {
            (robot.state, robot.scans, robot.scan_hz) = (TrackingState::Tracking as u32, 100, 10.0);
        }
        stats.robots[1].state = TrackingState::Lost as u32;
        stats.robots[2].state = TrackingState::MapUnreliable as u32;
        stats.robots[2].scan_hz = 0.0;
        (stats.robots[0].is_merged, stats.robots[0].map_age_s) = (1, 12.3);
        let client = |port: usize| ClientStatus {
            number: port as u64,
            connected_s: 60.0,
            silent_s: 0.5,
            link_bytes_per_s: None,
            held_back_bytes: 0,
            reduced_maps: 0,
            live_delay_s: 0.0,
            address: format!("192.168.100.200:{}", 50_000 + port).parse().unwrap(),
            subscriptions: 12,
            publications: 1,
            waiting_bytes: 2_000_000,
            dropped: 345,
            drives: vec![2],
            clock: None,
        };
        let waiting = (1..9).map(|n| format!("10.0.0.{n}").parse().unwrap()).collect();
        let clients = (0..64).map(client).collect();
        let bridge = BridgeState { stopped: true, waiting, clients, ..BridgeState::default() };
        FleetView { bridge: Some(bridge), ..FleetView::new(&stats) }
    }

    #[test]
    fn a_table_says_what_is_counted_anew_and_what_is_not_known() {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        (stats.robot_count, stats.counted_s) = (1, 42.0);
        (stats.robots[0].scans_lost, stats.robots[0].scans_lost_unknown) = (0, 1);
        (stats.processes[0].health.role, stats.processes[0].health.pid) = (Role::Telemetry as u32, 7);
        let style = Style { width: 200, is_coloured: false };
        let table = |stats: &FleetStats| FleetView::new(stats).table(&style);
        assert!(!table(&stats).contains("started again"));
        stats.processes[0].restarts = 1;
        let text = table(&stats);
        assert!(
            text.contains("latencies and lost scans are of the last 42 s: telemetry was started again"),
            "{text}"
        );
        let mut of_run = FleetView::new(&stats);
        of_run.robots[0].scan_hz = Some(10.0);
        let note = of_run.counting_note().unwrap();
        assert!(
            note.starts_with("jitter and latencies are of the last 42 s"),
            "lost scans are of the run: {note}"
        );
        for (age_s, is_said) in [(f64::NAN, false), (1.2, false), (12.0, true)] {
            stats.maps_age_s = age_s;
            let text = table(&stats);
            assert_eq!(text.contains("maps that are 12 s old"), is_said, "{text}");
        }
        for (room_f1, is_said) in [(f64::NAN, false), (0.9, false), (0.01, true)] {
            (stats.room_f1, stats.pair_count, stats.overlap_m2) = (room_f1, 1, 0.3);
            let text = table(&stats);
            assert_eq!(text.contains("almost nothing with the room's walls"), is_said, "{text}");
            assert!(text.contains("occupied F1 0.0%   over 0.3 m2"), "{text}");
        }
        let json = serde_json::to_value(FleetView::new(&stats)).unwrap();
        assert!(json["robots"][0]["scans_lost"].is_null() && json["counted_s"] == 42.0, "{json}");
        stats.robots[0].scans_lost_unknown = 0;
        assert_eq!(FleetView::new(&stats).robots[0].scans_lost, Some(0));
    }

    #[test]
    fn no_line_is_wider_than_the_terminal() {
        for width in [39, 60, 79, 100, 119] {
            let style = Style { width, is_coloured: false };
            let text = fleet().live_table(&style) + &fleet().process_table(&style);
            for line in text.lines() {
                assert!(line.chars().count() <= width, "{width}: `{line}`");
            }
            assert!(text.contains("robot3"), "{width}: {text}");
        }
    }

    #[test]
    fn own_names_are_shown_beside_the_numbers() {
        let names = ["alice", "", "robot3"].map(String::from);
        let named = fleet().with_names(&names);
        let text = named.table(&Style::PLAIN);
        assert!(text.contains("robots   robot1 is alice\n"), "{text}");
        assert!(!fleet().table(&Style::PLAIN).contains("robots   robot"));
        let json = serde_json::to_value(&named.robots).unwrap();
        assert_eq!((&json[0]["name"], &json[1]["name"]), (&"alice".into(), &serde_json::Value::Null));
    }

    #[test]
    fn a_process_that_is_no_more_has_ended_and_is_not_up_or_silent() {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        for (number, process) in stats.processes[..3].iter_mut().enumerate() {
            (process.health.role, process.health.pid) = (Role::Merge as u32, 100 + number as u32);
            process.age_s = [0.1, 9.0, 0.1][number];
        }
        let fleet = FleetView::new(&stats).with_ended_processes(|pid| pid != 102);
        let states: Vec<&str> = fleet.processes.iter().map(|process| process.state).collect();
        assert_eq!(states, ["up", "silent", "ended"]);
        assert!(fleet.live_table(&Style::PLAIN).contains("! merge has ended"));
    }

    #[test]
    fn what_is_wrong_comes_first_and_stands_out() {
        let fleet = fleet();
        let plain = fleet.live_table(&Style::PLAIN);
        assert!(plain.starts_with("! EMERGENCY STOP"), "{plain}");
        assert!(plain.contains("! robot2 is lost") && plain.contains("! robot3: no scan"), "{plain}");
        let old = "robot1's part of the merged map is 12 s old";
        assert!(plain.contains(&format!("! {old}")) && fleet.table(&Style::PLAIN).contains(old), "{plain}");
        assert!(plain.contains("! robot3's map may be wrong"), "{plain}");
        let all = fleet.table(&Style::PLAIN);
        assert!(fleet.alarms().iter().all(|alarm| all.contains(&format!("! {alarm}"))), "{all}");
        assert!(!plain.contains("no scan has come"), "{plain}");
        assert!(!plain.contains('\x1b'), "no colours in a file: {plain:?}");
        let coloured = fleet.live_table(&Style { width: 80, is_coloured: true });
        assert!(coloured.contains("\x1b[1;31mlost"), "{coloured:?}");
        assert!(coloured.starts_with("\x1b[1;31m! EMERGENCY"), "{coloured:?}");
    }

    #[test]
    fn a_robot_of_which_no_scan_has_come_is_named_when_the_fleet_has_started() {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        stats.robot_count = 1;
        let reported = |stats: &FleetStats| FleetView::new(stats).alarms().len();
        assert_eq!(reported(&stats), 0, "it starts");
        stats.header.stamp = msg::Stamp::from_seconds(super::super::alarms::FIRST_SCAN_S);
        assert_eq!(reported(&stats), 1);
        stats.robots[0].scans = 1;
        stats.robots[0].scan_hz = 10.0;
        assert_eq!(reported(&stats), 0);
    }

    #[test]
    fn many_clients_do_not_make_the_live_table_long() {
        let text = fleet().live_table(&Style { width: 79, is_coloured: false });
        assert!(text.contains("and 62 more clients") && text.contains("6 more ask to drive"), "{text}");
        assert!(text.lines().count() < 24, "{} lines: {text}", text.lines().count());
        assert_eq!(fleet().table(&Style::PLAIN).matches("192.168.100.200").count(), 64);
    }
}
