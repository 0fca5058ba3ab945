//! A room of one's own: walls as Wavefront OBJ, a robot that drives in it, and what its LiDAR measures.
//!
//! `cargo run --example custom_world [FILE.obj|FILE.glb|FILE.json]`
//!
//! Without a file the room is 6 m x 4 m with a partition, built below. Any fleet can use the same file:
//! `mr-slam up --room FILE`.

use bytemuck::Zeroable;
use msg::{RobotId, Scan, VelocityCommand};
use sim::{Room, SimConfig, Simulator};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let room = match std::env::args().nth(1) {
        Some(path) => Room::from_bytes(&path, &std::fs::read(&path)?)?,
        None => Room::from_bytes("own_room.obj", own_room().as_bytes())?,
    };
    let robot = RobotId::first(1).next().ok_or("no robot")?;
    let start = room.starts(1)?[0];
    let mut simulator = Simulator::new(&room, &SimConfig::default(), robot, start, 1)?;
    let mut scan = Box::new(Scan::zeroed());
    println!("{}: the robot starts at ({:.2}, {:.2}) m", room.name(), start.x_m, start.y_m);

    // 5 s of the simulator's 100 Hz ticks. A command is valid for 0.3 s, so it is repeated.
    for tick in 0..500 {
        let command = VelocityCommand { linear_m_s: 0.1, angular_rad_s: 0.2, ..VelocityCommand::default() };
        simulator.set_velocity_command(&command);
        let step = simulator.step();
        if step.scan_due {
            simulator.scan_into(&mut scan);
        }
        if tick % 100 == 99 {
            let seen = &scan.ranges_m[..scan.len as usize];
            let returns = seen.iter().filter(|range| (scan.range_min_m..scan.range_max_m).contains(range));
            let pose = step.truth.world_from_base;
            println!(
                "{:.1} s: at ({:.2}, {:.2}) m, {:.0} degrees; {} of {} beams return",
                step.stamp.seconds(),
                pose.x_m,
                pose.y_m,
                pose.yaw_rad.to_degrees(),
                returns.count(),
                seen.len()
            );
        }
    }
    Ok(())
}

/// A floor of 6 m x 4 m, four walls and a partition, 1 m high; z is up.
fn own_room() -> String {
    let mut obj = String::from("# up z\n");
    let mut corners = 0;
    let mut quad = |points: [[f32; 3]; 4]| {
        for [x, y, z] in points {
            obj.push_str(&format!("v {x} {y} {z}\n"));
        }
        obj.push_str(&format!("f {} {} {} {}\n", corners + 1, corners + 2, corners + 3, corners + 4));
        corners += 4;
    };
    quad([[0.0, 0.0, 0.0], [6.0, 0.0, 0.0], [6.0, 4.0, 0.0], [0.0, 4.0, 0.0]]);
    let walls = [
        ([0.0, 0.0], [6.0, 0.0]),
        ([6.0, 0.0], [6.0, 4.0]),
        ([6.0, 4.0], [0.0, 4.0]),
        ([0.0, 4.0], [0.0, 0.0]),
        ([3.0, 0.0], [3.0, 2.5]),
    ];
    for ([ax, ay], [bx, by]) in walls {
        quad([[ax, ay, 0.0], [bx, by, 0.0], [bx, by, 1.0], [ax, ay, 1.0]]);
    }
    obj
}
