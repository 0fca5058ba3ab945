//! SLAM as a library: scans and odometry in, poses and a map out.
//!
//! `cargo run --example slam_on_a_log [LOG]`
//!
//! LOG is a CARMEN log, plain or gzip. Without one, a simulated robot drives a circle in the built-in laboratory for 40 s.

use bytemuck::Zeroable;
use flate2::read::GzDecoder;
use formats::carmen::{LaserLine, Reader, Record};
use msg::grid::{Occupancy, occupancy};
use msg::{Odometry, RobotId, Scan, VelocityCommand};
use sim::{Room, SimConfig, Simulator};
use slam::{Slam, SlamConfig};
use std::io::Read;

type Error = Box<dyn std::error::Error>;

fn main() -> Result<(), Error> {
    let mut slam = Slam::new(SlamConfig::default());
    match std::env::args().nth(1) {
        Some(path) => map_log(&mut slam, &path)?,
        None => map_simulation(&mut slam)?,
    }
    // Links, loop closures and the pose graph of all nodes that still wait.
    slam.finish();

    let poses: Vec<_> = slam.trajectory().collect();
    let (first, last) = (poses.first().ok_or("no scan was accepted")?, poses[poses.len() - 1]);
    println!("{} poses over {:.0} s", poses.len(), last.0.seconds() - first.0.seconds());
    println!("the robot ends at x {:.2} m, y {:.2} m, yaw {:.2} rad", last.1.x_m, last.1.y_m, last.1.yaw_rad);
    let map = slam.map();
    let free = map.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Free).count();
    let occupied = map.cells.iter().filter(|cell| occupancy(**cell) == Occupancy::Occupied).count();
    let header = map.header;
    println!(
        "map of {} x {} cells of {} m: {free} free, {occupied} occupied",
        header.width, header.height, header.resolution_m
    );
    Ok(())
}

fn map_log(slam: &mut Slam, path: &str) -> Result<(), Error> {
    let mut bytes = std::fs::read(path)?;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut plain = Vec::new();
        GzDecoder::new(&bytes[..]).read_to_end(&mut plain)?;
        bytes = plain;
    }
    let mut scan = Box::new(Scan::zeroed());
    let lasers = Reader::new(&bytes).filter_map(|record| match record {
        Ok(Record::Laser(line)) => Some(line),
        // Odometry comes with each scan as well; a damaged line does not spoil the lines after it.
        _ => None,
    });
    for (seq, line) in (0..).zip(lasers) {
        slam.add_odometry(&odometry_of(&line));
        line.write_to(&mut scan, seq, None);
        slam.process(&scan);
        slam.work();
    }
    Ok(())
}

fn odometry_of(line: &LaserLine) -> Odometry {
    let mut odometry = Odometry { odom_from_base: line.odom_from_base, ..Odometry::default() };
    odometry.header.stamp = line.stamp;
    odometry
}

fn map_simulation(slam: &mut Slam) -> Result<(), Error> {
    let room = Room::laboratory();
    let robot = RobotId::first(1).next().ok_or("no robot")?;
    let mut simulator = Simulator::new(&room, &SimConfig::default(), robot, room.starts(1)?[0], 1)?;
    let mut scan = Box::new(Scan::zeroed());
    for _ in 0..4000 {
        let command = VelocityCommand { linear_m_s: 0.1, angular_rad_s: 0.3, ..VelocityCommand::default() };
        simulator.set_velocity_command(&command);
        let tick = simulator.step();
        if let Some(odometry) = tick.odometry {
            slam.add_odometry(&odometry);
        }
        if tick.scan_due {
            simulator.scan_into(&mut scan);
            slam.process(&scan);
            slam.work();
        }
    }
    Ok(())
}
