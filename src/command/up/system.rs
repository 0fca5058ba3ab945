//! The part of a report that says what ran: hardware and software, frames, processes, topics.

use crate::channel::document::arrows;
use crate::config::FleetConfig;
use crate::process::record::description::machine_parts;
use bridge::OUTGOING_TOPICS;
use reports::{Page, Row, frame_tree, process_graph};

/// Adds tables of hardware, software and topics, the tree of frames and the graph of processes.
pub fn add_system(page: &mut Page, config: &FleetConfig) {
    page.heading("Hardware and software");
    let row = |name: &str, value: String| -> Row { vec![name.into(), value] };
    let mut rows: Vec<Row> = machine_parts().into_iter().map(|(name, value)| row(name, value)).collect();
    let build = if cfg!(debug_assertions) { "development build" } else { "release build" };
    let (lidar, real_time) = (&config.sim.lidar, config.realtime.priority);
    let simulated = format!(
        "{} beams over {:.0} degrees, {} to {} m, {:.0} Hz",
        lidar.beams, lidar.fov_deg, lidar.range_min_m, lidar.range_max_m, lidar.rate_hz
    );
    rows.extend([
        row("program", format!("mr-slam {}, {build}", env!("CARGO_PKG_VERSION"))),
        row("robots", config.fleet.robots.to_string()),
        row("world", config.world_name().to_owned()),
        row("LiDAR", if config.world.is_external() { "the robots' own".into() } else { simulated }),
        row("real-time priority", if real_time > 0 { real_time.to_string() } else { "none".into() }),
    ]);
    page.table(&["", "this run"], &rows);
    page.heading("Frames, processes and topics");
    page.pictures(&[
        ("Frames of /tf".to_owned(), frame_tree(&config.robot_names())),
        ("Processes and the channels between them".to_owned(), process_graph(&arrows())),
    ]);
    page.paragraph(
        "Frames and topics are those of a fleet as it is configured: at most four robots' frames are drawn. What an arrow \
         stands for is shown under the pointer.",
    );
    let topics = OUTGOING_TOPICS.iter().filter(|topic| !topic.external_only);
    let rows: Vec<Row> = topics.map(|topic| row(topic.name, topic.message_type.to_owned())).collect();
    page.table(&["topic", "type"], &rows);
}
