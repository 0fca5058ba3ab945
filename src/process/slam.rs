//! One robot's SLAM: scans in, map and correction out.

use super::Error;
use super::pulse::{Account, Pulse};
use crate::channel;
use crate::run::Run;
use crate::shared_memory::wait;
use crate::stop::Stop;
use ::slam::Slam;
use msg::{Role, RobotId, Stamp};

/// Seconds of the run's clock between two maps.
pub const MAP_PERIOD_S: f64 = 1.0;

pub fn run(run: &Run, robot: RobotId, stop: &Stop) -> Result<(), Error> {
    let node = run.attach(Role::Slam, Some(robot))?;
    let mut pulse = Pulse::new(&node, run, Role::Slam, Some(robot))?;
    let mut scans = node.reader(&channel::scan(robot))?;
    let scan_bell = node.bell(&channel::scan(robot))?;
    let mut odometry = node.reader(&channel::odometry(robot))?;
    let mut corrections = node.writer(&channel::correction(robot))?;
    let mut maps = node.grid_writer(&channel::map(robot))?;

    let mut slam = Slam::new(run.config.slam.clone());
    let mut map_due = Stamp(i64::MIN);
    let mut refused = 0;
    while !stop.requested() {
        wait(&[&scan_bell], pulse.due());
        while let Some(scan) = scans.receive() {
            while let Some(odometry) = odometry.receive() {
                slam.odometry(&odometry);
            }
            let step = pulse.work(|| slam.process(&scan));
            refused += u64::from(step.refused.is_some());
            corrections.send(&step.correction);
            if scan.header.stamp >= map_due {
                maps.send(slam.map());
                map_due = Stamp::from_seconds(scan.header.stamp.seconds() + MAP_PERIOD_S);
            }
        }
        maps.refresh();
        pulse.beat(|| Account { gaps: scans.gaps(), refused, ..Account::default() });
    }
    Ok(())
}
