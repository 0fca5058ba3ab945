//! One order of time for a bag's scans, odometry and true poses.

use super::epochs::{Epochs, Timed, shifts_ns};
use super::found::RawScan;
use super::{BagError, BagScan, LeftOut};
use msg::{Pose2, Stamp};

/// Poses in order of time.
type Poses = Vec<(Stamp, Pose2)>;

/// Returns scans, odometry and true poses in order of time. Where the clock was set back, the stamps after that go on after
/// those before it.
pub fn in_order(
    scan_topic: &str,
    scans: Vec<RawScan>,
    odometry: Vec<Timed<Pose2>>,
    truth: Vec<Timed<Pose2>>,
    left_out: &mut LeftOut,
) -> Result<(Vec<RawScan>, Poses, Poses), BagError> {
    let (scans, odometry, truth) = (Epochs::new(scans), Epochs::new(odometry), Epochs::new(truth));
    let mut ends = scans.ends();
    for (poses, epochs) in [("the odometry", &odometry), ("the true poses", &truth)] {
        if epochs.ends() == [None] {
            continue;
        }
        if epochs.steps() != scans.steps() {
            return Err(BagError::Clocks {
                scan_topic: scan_topic.to_owned(),
                scan_steps: scans.steps(),
                poses: poses.to_owned(),
                steps: epochs.steps(),
            });
        }
        for (ends, others) in ends.iter_mut().zip(epochs.ends()) {
            *ends = match (*ends, others) {
                (Some(a), Some(b)) => Some(a.union(b)),
                (one, other) => one.or(other),
            };
        }
    }
    left_out.stray_stamps = scans.stray;
    left_out.clock_steps = scans.steps() as u64;
    let shifts = shifts_ns(&ends);
    let poses = |epochs: Epochs<Pose2>| {
        epochs.joined(&shifts).into_iter().map(|pose| (pose.stamp, pose.value)).collect::<Poses>()
    };
    let (odometry, truth) = (poses(odometry), poses(truth));
    Ok((scans.joined(&shifts), odometry, truth))
}

/// Returns the odometry with the poses at the scans, each stamp once; empty without odometry.
pub fn with_scans(odometry: Poses, scans: &[BagScan]) -> Poses {
    if odometry.is_empty() {
        return odometry;
    }
    let mut all = odometry;
    all.extend(scans.iter().map(|scan| (scan.stamp, scan.odom_from_base)));
    // Stable: of one stamp the message comes first, and is kept.
    all.sort_by_key(|(stamp, _)| *stamp);
    all.dedup_by_key(|(stamp, _)| *stamp);
    all
}
