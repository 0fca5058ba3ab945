//! `cargo bench --bench relocalize -- LOG...`: a robot is put down anywhere in the second half of a
//! log, in the map of the first half. How often it is found, how often wrongly, and what a search costs.
//!
//! The truth is the whole log's own map. A start counts as found if the robot was believed to be
//! found within the scans it was given, as wrong if that was more than 0.5 m or 0.2 rad off.

use formats::carmen::{Reader, Record};
use mr_slam::config::recorded_log_slam;
use msg::{Odometry, Pose2, Scan, SlamMode, Stamp, pose::wrap_angle};
use rustix::time::{ClockId, clock_gettime};
use slam::{InitialPose, Session, SessionIdentity, Slam};
use std::collections::BTreeMap;
use std::path::Path;

/// Scans between two starts, and scans that a robot is given to be found.
const STEP: usize = 8;
const SCANS: usize = 40;
/// Farther off is wrong, metres and radians.
const WRONG_M: f64 = 0.5;
const WRONG_RAD: f64 = 0.2;

/// Largest log when unpacked, bytes: a safety limit, public logs are below 100 MB.
const LOG_BYTES_MAX: u64 = 1 << 30;

type Line = (Odometry, Box<Scan>);

fn read(path: &Path) -> Vec<Line> {
    let log = formats::gzip::unpack(std::fs::read(path).expect("the log"), LOG_BYTES_MAX).expect("gzip");
    let lines = Reader::new(&log).filter_map(|record| match record {
        Ok(Record::Laser(line)) => {
            let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
            line.write_to(&mut scan, 0, None);
            let header = msg::Header { stamp: line.stamp, ..Default::default() };
            Some((Odometry { header, odom_from_base: line.odom_from_base, ..Default::default() }, scan))
        }
        _ => None,
    });
    lines.collect()
}

fn feed(slam: &mut Slam, line: &Line) -> msg::PoseEstimate {
    slam.add_odometry(&line.0);
    slam.process(&line.1).pose_estimate
}

fn cpu_ms() -> f64 {
    let t = clock_gettime(ClockId::ThreadCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

fn main() {
    let logs: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if logs.is_empty() {
        println!("give CARMEN logs: cargo bench --bench relocalize -- LOG...");
        return;
    }
    println!(
        "log                    starts   found   wrong   scans p50   search ms p50 / p99 / max (processor time)"
    );
    for log in &logs {
        let lines = read(Path::new(log));
        let mut whole = Slam::new(recorded_log_slam());
        for line in &lines {
            feed(&mut whole, line);
            whole.work();
        }
        whole.finish();
        let truth: BTreeMap<Stamp, Pose2> = whole.trajectory().collect();

        let half = lines.len() / 2;
        let mut first = Slam::new(recorded_log_slam());
        for line in &lines[..half] {
            feed(&mut first, line);
            first.work();
        }
        first.finish();
        let session = first.session(SessionIdentity::new(0, 0, &recorded_log_slam()));
        let (mut starts, mut found, mut wrong) = (0, 0, 0);
        let (mut needed, mut costs) = (Vec::new(), Vec::new());
        for start in (half..lines.len().saturating_sub(SCANS)).step_by(STEP) {
            starts += 1;
            let (n, outcome) = put_down(&session, &lines[start..start + SCANS], &mut costs);
            let Some((stamp, pose)) = outcome else { continue };
            found += 1;
            needed.push(n as f64);
            // The half's map and the whole's differ by what later closures taught: compare at the place.
            let want = truth[&stamp];
            let off = want.between(pose);
            if want.distance_m(pose) > WRONG_M || wrap_angle(off.yaw_rad).abs() > WRONG_RAD {
                wrong += 1;
                eprintln!("  wrong from scan {start}: {pose:?}, truth {want:?}");
            }
        }
        let name = Path::new(log).file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        println!(
            "{name:<22} {starts:>6} {found:>7} {wrong:>7} {:>11.0}   {:.0} / {:.0} / {:.0}",
            at(&mut needed, 0.5),
            at(&mut costs, 0.5),
            at(&mut costs, 0.99),
            at(&mut costs, 1.0)
        );
    }
}

/// How many scans it took, and where the robot was then said to be.
fn put_down(session: &Session, lines: &[Line], costs: &mut Vec<f64>) -> (usize, Option<(Stamp, Pose2)>) {
    let kept = Some(session.clone());
    let mut slam =
        Slam::create_or_resume(recorded_log_slam(), kept, SlamMode::Localization, InitialPose::Unknown);
    for (n, line) in lines.iter().enumerate() {
        let pose_estimate = feed(&mut slam, line);
        let (before, searches) = (cpu_ms(), slam.back_counts().relocalization.searches);
        slam.work();
        if slam.back_counts().relocalization.searches > searches {
            costs.push(cpu_ms() - before);
        }
        if slam.back_counts().relocalization.accepted > 0 {
            let pose = slam.back().map_from_base().unwrap_or_default();
            return (n + 1, Some((pose_estimate.header.stamp, pose)));
        }
    }
    (lines.len(), None)
}

fn at(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values.len().checked_sub(1).map_or(f64::NAN, |last| values[(share * last as f64).ceil() as usize])
}
