//! Messages that two robots or two scanners sent under one name: they are no log of one robot. Poses that are mixed jump to the other
//! robot and back; scans that are mixed are less like the next one than like the one after it.

use super::BagScan;
use msg::{Pose2, Stamp};

/// A jump is at least this long, metres: more than what odometry jitters.
const JUMP_MIN_M: f64 = 0.3;
/// A jump is faster than any robot, m/s.
const JUMP_SPEED_MIN_M_S: f64 = 5.0;
/// A jump that leads back comes within this share of its length to where it began.
const BACK_SHARE: f64 = 0.3;
/// Messages within which it leads back: a robot may send some times as often as the other.
const BACK_WITHIN: usize = 5;
/// Ranges of two scans of one place differ by less, in the mean, metres.
const RANGES_DIFFER_MIN_M: f64 = 0.3;
/// Messages of two sources change between them so often at least.
const CHANGES_MIN: usize = 10;
/// And in this share of the messages at least: one of the two may send some times as often. A clock that was set back while a
/// recorder put messages in order of their stamps mixes a part of them.
const CHANGES_SHARE_MIN: f64 = 0.25;
/// Scans that are compared at most; they tell it for the rest.
const SCANS_COMPARED_MAX: usize = 600;

/// Returns how often poses jump elsewhere and back, if so often that two robots sent them.
pub fn changes_of_poses(poses: &[(Stamp, Pose2)]) -> Option<usize> {
    let is_change = |at: usize| {
        let ((before, from), (stamp, to)) = (poses[at - 1], poses[at]);
        let jump_m = from.distance_m(to);
        let is_jump = jump_m > JUMP_MIN_M && jump_m > JUMP_SPEED_MIN_M_S * (stamp - before);
        let next = poses.iter().skip(at + 1).take(BACK_WITHIN);
        is_jump && next.into_iter().any(|(_, later)| later.distance_m(from) < BACK_SHARE * jump_m)
    };
    enough((1..poses.len()).filter(|at| is_change(*at)).count(), poses.len())
}

/// Returns how often scans are of another place than the next one and of the same as one of the two after it, if so often that
/// two scanners sent them.
pub fn changes_of_scans<'a>(scans: impl Iterator<Item = &'a BagScan>) -> Option<usize> {
    let scans: Vec<&BagScan> = scans.take(SCANS_COMPARED_MAX).collect();
    let is_change = |four: &&[&BagScan]| {
        let Some(next_m) = ranges_differ_m(four[0], four[1]).filter(|differ| *differ > RANGES_DIFFER_MIN_M)
        else {
            return false;
        };
        let later = four[2..].iter().filter_map(|later| ranges_differ_m(four[0], later));
        later.fold(f64::INFINITY, f64::min) < BACK_SHARE * next_m
    };
    enough(scans.windows(4).filter(is_change).count(), scans.len())
}

fn enough(changes: usize, messages: usize) -> Option<usize> {
    let is_enough = changes >= CHANGES_MIN && changes as f64 >= CHANGES_SHARE_MIN * messages as f64;
    is_enough.then_some(changes)
}

/// Returns the mean difference of the ranges that both scans have, metres; `None` if they have less than half of their beams in common.
fn ranges_differ_m(a: &BagScan, b: &BagScan) -> Option<f64> {
    let is_return = |scan: &BagScan, range_m: f32| (scan.range_min_m..scan.range_max_m).contains(&range_m);
    let both = a.ranges_m.iter().zip(&b.ranges_m);
    let (mut sum_m, mut count) = (0.0, 0_usize);
    for (p, q) in both.filter(|(p, q)| is_return(a, **p) && is_return(b, **q)) {
        sum_m += f64::from((p - q).abs());
        count += 1;
    }
    (2 * count > a.ranges_m.len().max(b.ranges_m.len())).then(|| sum_m / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot's poses while it drives around a circle, at so many hertz.
    fn circle(begins_rad: f64, hz: u64) -> Vec<(Stamp, Pose2)> {
        let pose = |k: u64| {
            let at_s = k as f64 / hz as f64;
            let angle = begins_rad + 0.3 * at_s;
            (Stamp::from_seconds(at_s), Pose2::new(2.0 * angle.cos(), 2.0 * angle.sin(), angle))
        };
        (0..20 * hz).map(pose).collect()
    }

    fn mixed(mut a: Vec<(Stamp, Pose2)>, b: Vec<(Stamp, Pose2)>) -> Vec<(Stamp, Pose2)> {
        a.extend(b);
        a.sort_by_key(|(stamp, _)| *stamp);
        a
    }

    #[test]
    fn poses_of_two_robots_are_noticed_at_any_rates_and_those_of_one_never() {
        for (hz, other_hz) in [(50, 50), (50, 20), (20, 50), (100, 40), (10, 10)] {
            let both = mixed(circle(0.0, hz), circle(3.0, other_hz));
            assert!(changes_of_poses(&both).is_some(), "{hz} and {other_hz} Hz");
            assert_eq!(changes_of_poses(&circle(0.0, hz)), None, "{hz} Hz");
        }
        // In millimetres a robot is fast, and does not jump back.
        let fast = |(stamp, pose): (Stamp, Pose2)| (stamp, Pose2::new(1e3 * pose.x_m, 1e3 * pose.y_m, 0.0));
        assert_eq!(changes_of_poses(&circle(0.0, 50).into_iter().map(fast).collect::<Vec<_>>()), None);
        // Nor is a driver that was started again, or a few wrong messages, another robot.
        let mut started_again = circle(0.0, 50);
        started_again[500..].iter_mut().for_each(|(_, pose)| pose.x_m += 30.0);
        (100..108).for_each(|k| started_again[10 * k % 1000].1.y_m = 70.0);
        assert_eq!(changes_of_poses(&started_again), None);
        assert_eq!(changes_of_poses(&[]), None);
    }

    #[test]
    fn scans_of_two_scanners_are_noticed_and_those_of_one_that_turns_are_not() {
        let scan = |room_m: f32, turned: usize| BagScan {
            stamp: Stamp(0),
            odom_from_base: Pose2::IDENTITY,
            world_from_base: None,
            angle_min_rad: 0.0,
            angle_increment_rad: 0.02,
            time_increment_s: 0.0,
            scan_time_s: 0.1,
            range_min_m: 0.1,
            range_max_m: 30.0,
            ranges_m: (0..300).map(|beam| room_m + ((beam + turned) % 60) as f32 * 0.1).collect(),
        };
        let one: Vec<BagScan> = (0..60).map(|k| scan(1.0, 7 * k)).collect();
        assert_eq!(changes_of_scans(one.iter()), None);
        let two: Vec<BagScan> = (0..60).map(|k| scan(if k % 2 == 0 { 1.0 } else { 6.0 }, k)).collect();
        assert!(changes_of_scans(two.iter()).is_some());
        let unlike: Vec<BagScan> = (0..90).map(|k| scan(if k % 3 == 0 { 1.0 } else { 6.0 }, k)).collect();
        assert!(changes_of_scans(unlike.iter()).is_some());
        assert_eq!(changes_of_scans([].iter()), None);
    }
}
