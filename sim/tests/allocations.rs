//! A scan allocates nothing, and a driving robot's memory does not grow.

mod common;

use bytemuck::Zeroable;
use common::{drive, robot};
use msg::{GroundTruth, Header, Pose2, Scan};
use sim::{Room, SimConfig, Simulator};

/// Largest number of allocations in one tick. All are rapier's, which collects contacts and islands in short-lived
/// vectors in every step.
const IN_A_TICK_MAX: u64 = 16;

#[test]
fn scans_allocate_nothing_and_ticks_grow_nothing() {
    let start = Pose2::new(-1.2, -1.7, 0.6);
    let mut simulator =
        Simulator::new(&Room::laboratory(), &SimConfig::default(), robot(1), start, 1).unwrap();
    let mut scan = Box::new(Scan::zeroed());
    let mut drive_about = |ticks: u32| {
        for tick in 0..ticks {
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
