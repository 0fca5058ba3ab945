//! Prints the time of a tick and of a scan: median, 99th percentile and largest, microseconds.
//!
//! `cargo run --release -p sim --example cost -- [ROOM_FILE|MAP.yaml|KIND:SEED]...`

use bytemuck::Zeroable;
use msg::{GroundTruth, RobotId, Scan, VelocityCommand};
use sim::{LidarConfig, Room, SimConfig, Simulator};
use std::time::Instant;

const TICKS: usize = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("{:<28}{:>7}{:>7}{:>20}{:>22}", "room", "peers", "rays", "tick p50/p99/max", "scan p50/p99/max");
    let mut rooms = vec![Room::laboratory()];
    for path in std::env::args().skip(1) {
        let begun = Instant::now();
        rooms.push(load(&path)?);
        println!("{path} is loaded in {:.2} s", begun.elapsed().as_secs_f64());
    }
    for room in &rooms {
        for (peers, lidar) in [
            (0, LidarConfig::PAPER),
            (2, LidarConfig::PAPER),
            (2, LidarConfig::LDS_01),
            (2, LidarConfig::LDS_02),
        ] {
            measure(room, peers, lidar)?;
        }
    }
    measure(&rooms[0], 15, LidarConfig::PAPER)
}

fn load(path: &str) -> Result<Room, Box<dyn std::error::Error>> {
    if let Some((kind, seed)) = Room::parse_generated(path) {
        return Ok(Room::generate(kind, seed));
    }
    if path.ends_with(".yaml") {
        return Ok(Room::from_map(path, formats::map_file::read_map(path.as_ref())?.view())?);
    }
    Ok(Room::from_bytes(path, &std::fs::read(path)?)?)
}

fn measure(room: &Room, peers: usize, lidar: LidarConfig) -> Result<(), Box<dyn std::error::Error>> {
    let config = SimConfig { lidar, ..SimConfig::default() };
    let starts = room.starts(peers + 1)?;
    let mut robots = RobotId::first(peers + 1).zip(starts);
    let (robot, start) = robots.next().ok_or("no robot")?;
    let others: Vec<_> = robots.collect();
    let mut simulator = Simulator::new(room, &config, robot, start, 1)?;
    let mut scan = Box::new(Scan::zeroed());
    let (mut ticks, mut scans) = (Vec::with_capacity(TICKS), Vec::with_capacity(TICKS));
    for tick in 0..TICKS {
        if tick % 5 == 0 {
            for (peer, at) in &others {
                let mut truth = GroundTruth { world_from_base: *at, ..GroundTruth::default() };
                truth.header.stamp = simulator.now();
                simulator.update_peer(*peer, &truth);
            }
        }
        let angular_rad_s = if tick % 1000 < 300 { 1.0 } else { -0.1 };
        simulator.set_velocity_command(&VelocityCommand {
            linear_m_s: 0.15,
            angular_rad_s,
            ..VelocityCommand::default()
        });
        let before = Instant::now();
        let due = simulator.step().scan_due;
        ticks.push(before.elapsed());
        if due {
            let before = Instant::now();
            simulator.scan_into(&mut scan);
            scans.push(before.elapsed());
        }
    }
    let row = |times: &mut Vec<std::time::Duration>| {
        times.sort();
        let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e6;
        format!("{:.0}/{:.0}/{:.0}", at(0.5), at(0.99), at(1.0))
    };
    let name = room.name().rsplit('/').next().unwrap_or_default();
    println!("{name:<28}{peers:>7}{:>7}{:>20}{:>22}", lidar.beams, row(&mut ticks), row(&mut scans));
    Ok(())
}
