//! A scan allocates nothing, and a driving robot's memory does not grow.

mod common;

use bytemuck::Zeroable;
use common::{drive, robot};
use msg::{GroundTruth, Header, MovingObjects, Pose2, Scan, Stamp};
use sim::{MovingConfig, ObjectSimulator, Room, SimConfig, Simulator};

/// Largest number of allocations in one tick. All are rapier's, which collects contacts and islands in short-lived
/// vectors in every step, with more of them while the robot touches something.
const IN_A_TICK_MAX: u64 = 20;

#[test]
fn scans_allocate_nothing_and_ticks_grow_nothing() {
    let start = Pose2::new(-1.2, -1.7, 0.6);
    let mut simulator =
        Simulator::new(&Room::laboratory(), &SimConfig::default(), robot(1), start, 1).unwrap();
    let mut scan = Box::new(Scan::zeroed());
    // The process of moving objects has its own memory: its messages are computed before.
    let config = MovingConfig { people: 8, doors: 1, boxes: 2 };
    let mut objects = ObjectSimulator::new(&Room::laboratory(), &config, &[start], 1);
    let mut messages = (0..400).map(|number| {
        let mut message = Box::new(MovingObjects::default());
        objects.advance([start]);
        objects.write(&mut message);
        message.header.stamp = Stamp(number * 50_000_000);
        message
    });
    let messages: Vec<_> = messages.by_ref().collect();
    let mut drive_about = |ticks: u32| {
        for tick in 0..ticks {
            let newest = simulator.now().0 / 50_000_000;
            simulator.update_objects(&messages[newest as usize]);
            if tick % 5 == 0 {
                let header = Header { stamp: simulator.now(), ..Header::default() };
                let world_from_base = Pose2::new(-2.0, 1.3, 0.1);
                simulator.update_peer(
                    robot(2),
                    &GroundTruth { header, world_from_base, ..GroundTruth::default() },
                );
            }
            simulator.set_velocity_command(&drive(0.15, if tick % 500 < 250 { 0.6 } else { -0.4 }));
            simulator.step();
        }
        allocation_counter::measure(|| simulator.scan_into(&mut scan))
    };
    // The peer's body and rapier's buffers are allocated once, before the measurement.
    drive_about(1000);
    let mut scanned = None;
    let ticks = allocation_counter::measure(|| scanned = Some(drive_about(1000)));
    assert_eq!(scanned.unwrap().count_total, 0);
    assert!(ticks.count_total <= 1000 * IN_A_TICK_MAX, "{ticks:?}");
    assert!(ticks.bytes_current < 16 << 10, "{ticks:?}");
}
