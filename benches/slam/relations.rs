//! How far a trajectory is from relative poses known otherwise: the relation metric (Kümmerle et
//! al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 2009).

use msg::{Pose2, pose::wrap_angle};
use serde::{Deserialize, Serialize};

/// A relation's stamp is a trajectory's if they are this close, seconds.
const NEAR_S: f64 = 0.05;
/// The same, if only relations between scans of the log shall count.
const SAME_S: f64 = 0.002;
/// Without odometry, stamps between scans are interpolated over gaps up to this, seconds.
const GAP_MAX_S: f64 = 3.0;
/// Odometry at a stamp may be this far from it, seconds.
const ODOMETRY_NEAR_S: f64 = 0.1;
/// Relations over more than this are revisits, seconds: they can tell systems apart.
const REVISIT_S: f64 = 30.0;

/// How lines of a trajectory begin whose pose is not known in the map; their numbers follow a colon.
const UNPLACED: [&str; 2] = ["# not placed in the map", "# lost"];

/// Poses by time, seconds; no time twice.
pub struct Trajectory {
    poses: Vec<(f64, Pose2)>,
    /// Times of scans whose poses are not known in the map, ascending.
    unplaced_s: Vec<f64>,
}

/// The pose of the robot at `to_s` as seen from where it was at `from_s`.
pub struct Relation {
    from_s: f64,
    to_s: f64,
    start_from_end: Pose2,
}

/// Errors of the relations that could be compared.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Errors {
    /// How many.
    pub count: usize,
    /// Relations to scans that are not placed in the map: they are not compared.
    pub unplaced: usize,
    /// Mean error of the translation, metres.
    pub mean_m: f64,
    /// The largest.
    pub max_m: f64,
    /// Mean error of the rotation, degrees.
    pub mean_deg: f64,
}

/// Which relations count.
#[derive(Clone, Copy, PartialEq)]
pub enum Which {
    /// All that can be reached.
    All,
    /// Those over more than 30 s.
    Revisits,
    /// Those between scans of the log, nothing interpolated.
    BothKept,
}

impl Errors {
    /// Number of relations that could be compared if all scans were placed in the map.
    #[allow(dead_code, reason = "the merge bench's: the slam bench counts what is placed itself")]
    pub fn known(&self) -> usize {
        self.count + self.unplaced
    }
}

impl Relation {
    /// Whether both ends are after this moment.
    pub fn begins_after(&self, begins_s: f64) -> bool {
        self.from_s.min(self.to_s) >= begins_s - NEAR_S
    }

    /// Which poses of a trajectory are nearest to both ends.
    pub fn ends(&self, trajectory: &Trajectory) -> [usize; 2] {
        [self.from_s, self.to_s].map(|at_s| trajectory.nearest(at_s))
    }
}

impl Trajectory {
    /// Sorts by time and drops doubles.
    pub fn new(mut poses: Vec<(f64, Pose2)>) -> Self {
        poses.sort_by(|a, b| a.0.total_cmp(&b.0));
        poses.dedup_by(|later, kept| later.0 <= kept.0);
        Self { poses, unplaced_s: Vec::new() }
    }

    /// From text: `t x y yaw` or `t x y z qx qy qz qw` a line. Of lines that begin as [`UNPLACED`] the time alone counts.
    pub fn parse(text: &str) -> Result<Self, String> {
        let pose = |row: &[f64]| match *row {
            [t, x, y, yaw] => Some((t, Pose2::new(x, y, yaw))),
            [t, x, y, _, _, _, qz, qw] => Some((t, Pose2::new(x, y, wrap_angle(2.0 * qz.atan2(qw))))),
            _ => None,
        };
        let time_s =
            |line: &str| -> Option<f64> { line.split_once(':')?.1.split_whitespace().next()?.parse().ok() };
        let mut found = Self::new(rows(text, pose, "t x y yaw")?);
        for line in text.lines().filter(|line| UNPLACED.iter().any(|start| line.starts_with(start))) {
            let at_s = time_s(line).ok_or_else(|| format!("{line}: expected a time after the colon"))?;
            found.unplaced_s.push(at_s);
        }
        found.unplaced_s.sort_by(f64::total_cmp);
        Ok(found)
    }

    /// Whether a relation is between two of its own times.
    #[allow(dead_code, reason = "the merge bench's: the slam bench has one trajectory at a time")]
    pub fn spans(&self, relation: &Relation) -> bool {
        let within = |at_s: f64| {
            let times = || self.poses.iter().map(|(t, _)| *t).chain(self.unplaced_s.iter().copied());
            let [first, last] = [times().fold(f64::NAN, f64::min), times().fold(f64::NAN, f64::max)];
            (first - NEAR_S..=last + NEAR_S).contains(&at_s)
        };
        within(relation.from_s) && within(relation.to_s)
    }

    /// As [`Trajectory::parse`] reads it.
    pub fn text(&self) -> String {
        let line = |(t, pose): &(f64, Pose2)| {
            format!("{t:.6} {:.6} {:.6} {:.6}\n", pose.x_m, pose.y_m, pose.yaw_rad)
        };
        self.poses.iter().map(line).collect()
    }

    /// When it begins, seconds.
    pub fn begins_s(&self) -> f64 {
        self.poses.first().map_or(f64::INFINITY, |(t, _)| *t)
    }

    /// The pose at a scan's own time.
    pub fn scan_at(&self, at_s: f64) -> Option<Pose2> {
        let (scan_s, pose) = *self.poses.get(self.nearest(at_s))?;
        ((scan_s - at_s).abs() <= SAME_S).then_some(pose)
    }

    /// Whether the scan nearest to a time is placed in the map.
    fn is_placed(&self, at_s: f64) -> bool {
        let Some((placed_s, _)) = self.poses.get(self.nearest(at_s)) else { return false };
        let after = self.unplaced_s.partition_point(|t| *t < at_s);
        let beside = self.unplaced_s[after.saturating_sub(1)..].iter().take(2);
        let unplaced_s = beside.map(|t| (t - at_s).abs()).fold(f64::INFINITY, f64::min);
        (placed_s - at_s).abs() <= unplaced_s
    }

    /// Index of the pose nearest in time; of two as near, the earlier.
    fn nearest(&self, at_s: f64) -> usize {
        let last = self.poses.len().saturating_sub(1);
        let after = self.poses.partition_point(|(t, _)| *t < at_s).clamp(1.min(last), last);
        let before = after.saturating_sub(1);
        if (self.poses[before].0 - at_s).abs() <= (self.poses[after].0 - at_s).abs() { before } else { after }
    }

    /// The pose at a time, if it can be told; between scans with odometry's help where there is some.
    fn at(&self, at_s: f64, odometry: Option<&Self>, near_s: f64) -> Option<Pose2> {
        let (scan_s, pose) = self.poses[self.nearest(at_s)];
        if (scan_s - at_s).abs() <= near_s {
            return Some(pose);
        }
        if let Some(odometry) = odometry {
            let [from, to] = [scan_s, at_s].map(|t| odometry.poses[odometry.nearest(t)]);
            let known = (from.0 - scan_s).abs() <= ODOMETRY_NEAR_S && (to.0 - at_s).abs() <= ODOMETRY_NEAR_S;
            return known.then(|| pose * from.1.between(to.1));
        }
        let after = self.poses.partition_point(|(t, _)| *t < at_s);
        let ((from_s, from), (to_s, to)) = (self.poses.get(after.checked_sub(1)?)?, self.poses.get(after)?);
        let share = (at_s - from_s) / (to_s - from_s);
        let yaw_rad = wrap_angle(from.yaw_rad + share * wrap_angle(to.yaw_rad - from.yaw_rad));
        let between = Pose2::new(
            from.x_m + share * (to.x_m - from.x_m),
            from.y_m + share * (to.y_m - from.y_m),
            yaw_rad,
        );
        (near_s > SAME_S && to_s - from_s <= GAP_MAX_S).then_some(between)
    }
}

/// Relations from text: `t1 t2 x y z roll pitch yaw` a line.
pub fn parse(text: &str) -> Result<Vec<Relation>, String> {
    let relation = |row: &[f64]| match *row {
        [from_s, to_s, x, y, _, _, _, yaw] => {
            Some(Relation { from_s, to_s, start_from_end: Pose2::new(x, y, yaw) })
        }
        _ => None,
    };
    rows(text, relation, "t1 t2 x y z roll pitch yaw")
}

/// What the trajectory gets wrong.
pub fn errors(
    estimate: &Trajectory,
    odometry: Option<&Trajectory>,
    relations: &[Relation],
    which: Which,
) -> Errors {
    if estimate.poses.is_empty() {
        return Errors::default();
    }
    let (odometry, near_s) = if which == Which::BothKept { (None, SAME_S) } else { (odometry, NEAR_S) };
    let mut errors = Errors::default();
    for relation in relations {
        let short = (relation.to_s - relation.from_s).abs() <= REVISIT_S;
        if which == Which::Revisits && short {
            continue;
        }
        if !estimate.is_placed(relation.from_s) || !estimate.is_placed(relation.to_s) {
            errors.unplaced += 1;
            continue;
        }
        let from = estimate.at(relation.from_s, odometry, near_s);
        let to = estimate.at(relation.to_s, odometry, near_s);
        let Some((from, to)) = from.zip(to) else { continue };
        let error = relation.start_from_end.between(from.between(to));
        let away_m = error.x_m.hypot(error.y_m);
        errors.count += 1;
        errors.mean_m += away_m;
        errors.max_m = errors.max_m.max(away_m);
        errors.mean_deg += wrap_angle(error.yaw_rad).abs().to_degrees();
    }
    let count = errors.count.max(1) as f64;
    Errors { mean_m: errors.mean_m / count, mean_deg: errors.mean_deg / count, ..errors }
}

/// The numbers of every line that is no comment.
fn rows<T>(text: &str, row: impl Fn(&[f64]) -> Option<T>, expected: &str) -> Result<Vec<T>, String> {
    let lines =
        text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    lines
        .map(|(index, line)| {
            let numbers: Option<Vec<f64>> = line.split_whitespace().map(|word| word.parse().ok()).collect();
            let found = numbers.and_then(|numbers| row(&numbers));
            found.ok_or_else(|| format!("line {}: expected {expected}", index + 1))
        })
        .collect()
}
