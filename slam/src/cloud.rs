//! A scan's surface points with normals, and a spatial index that finds the one nearest to a point.
//!
//! Points are thinned to an even spacing and lie in `base_footprint`.

mod encoding;
mod surfaces;

pub use surfaces::CloudScratch;

use crate::beam_poses::BeamPoses;
use crate::config::LidarConfig;
use crate::point_transform::PointTransform;
use msg::{Pose2, Scan};

/// Side of an index cell, metres: a search covers half of it in every direction.
const INDEX_CELL_M: f32 = 0.5;
/// Farthest correspondence the index can find, metres.
pub const SEARCH_MAX_M: f32 = INDEX_CELL_M / 2.0;
/// Cosine of the largest angle between normals of the same surface.
const FACING: f32 = 0.7;
/// A point this close to a surface of another scan agrees with it, metres: twice the drift between linked scans.
const SURFACE_TOLERANCE_M: f32 = 0.15;
/// A scan that sees this far behind a point contradicts it, metres: more than the tolerance, a thin obstacle
/// and a flat angle leave together.
pub(crate) const SEE_THROUGH_M: f32 = 0.4;
/// Neighbours on one surface are no farther apart than this many angles between beams: a surface that is seen at 30 degrees.
const NEIGHBOUR_BEAMS: f32 = 2.0;
/// Bearings of [`Cloud::sees_through`]: one a degree.
pub const BEARINGS: usize = 360;

/// A point of a surface, metres, and the surface's unit normal towards the sensor (zero: unknown).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SurfacePoint {
    /// Position in the cloud's frame, metres.
    pub at: [f32; 2],
    /// Unit normal towards the sensor, or zero if unknown.
    pub normal: [f32; 2],
}

impl SurfacePoint {
    /// Whether the surface's direction is known.
    pub fn has_normal(&self) -> bool {
        self.normal != [0.0; 2]
    }
}

/// The surface points of one scan, or of several merged ones.
#[derive(Clone, Debug)]
pub struct Cloud {
    /// Points, grouped by the index's buckets.
    points: Vec<SurfacePoint>,
    /// `heads[b]..heads[b + 1]` are bucket b's points. The number of buckets is a power of two.
    heads: Vec<u16>,
    sensor: [f32; 2],
    /// Mean of the points, metres: about what the scan looks at.
    centroid_m: [f32; 2],
    /// Nearest return by bearing around the sensor, centimetres; 0 without a return.
    seen_cm: Box<[u16; BEARINGS]>,
}

impl Cloud {
    /// An empty cloud with room for `points_max` points.
    pub fn with_capacity(points_max: usize) -> Self {
        let mut heads = Vec::with_capacity(buckets(points_max) + 1);
        heads.resize(2, 0);
        Self {
            points: Vec::with_capacity(points_max),
            heads,
            sensor: [0.0; 2],
            centroid_m: [0.0; 2],
            seen_cm: Box::new([0; BEARINGS]),
        }
    }

    /// Replaces the points by the surfaces of a scan. Allocates nothing if there is room.
    pub fn fill(&mut self, scan: &Scan, sweep: &BeamPoses, config: &LidarConfig, scratch: &mut CloudScratch) {
        let CloudScratch { hits, kept, points } = scratch;
        surfaces::find_hits(hits, scan, sweep, config.range_use_max_m);
        let gap_per_m = NEIGHBOUR_BEAMS * scan.angle_increment_rad.abs();
        self.sensor = sweep.mid_sweep_position();
        surfaces::thin(kept, hits, config.spacing_m, config.points_max);
        points.clear();
        points.extend(kept.iter().map(|&i| surfaces::surface_point(hits, i, gap_per_m, self.sensor)));
        surfaces::fill_bearings(&mut self.seen_cm, hits, self.sensor);
        self.index(points);
    }

    /// Merges clouds, each moved by its pose; keeps every n-th point if they are more than `points_max`.
    /// The merged cloud does not know what was seen through.
    pub fn merged<'a>(clouds: impl Iterator<Item = (&'a Cloud, Pose2)> + Clone, points_max: usize) -> Self {
        let total: usize = clouds.clone().map(|(c, _)| c.points.len()).sum();
        let stride = total.div_ceil(points_max.max(1)).max(1);
        let mut points = Vec::with_capacity(total / stride + 1);
        for (cloud, pose) in clouds {
            let transform = PointTransform::new(pose);
            points.extend(
                cloud.points.iter().step_by(stride).map(|p| SurfacePoint {
                    at: transform.point(p.at),
                    normal: transform.direction(p.normal),
                }),
            );
        }
        let mut cloud = Self::with_capacity(points.len());
        cloud.index(&points);
        cloud
    }

    /// Replaces the points, grouped by bucket (counting sort).
    fn index(&mut self, points: &[SurfacePoint]) {
        let buckets = buckets(points.len());
        let heads = &mut self.heads;
        heads.clear();
        heads.resize(buckets + 1, 0);
        let share = 1.0 / points.len().max(1) as f32;
        self.centroid_m =
            points.iter().fold([0.0; 2], |m, p| [m[0] + share * p.at[0], m[1] + share * p.at[1]]);
        for p in points {
            heads[bucket(cell(p.at), buckets) + 1] += 1;
        }
        for b in 0..buckets {
            heads[b + 1] += heads[b];
        }
        self.points.clear();
        self.points.resize(points.len(), SurfacePoint::default());
        for p in points {
            let slot = &mut heads[bucket(cell(p.at), buckets)];
            self.points[*slot as usize] = *p;
            *slot += 1;
        }
        // Every head now is where its bucket ends, which is where the next one begins.
        heads.rotate_right(1);
        heads[0] = 0;
    }

    /// Parts of the cloud for a session: points, sensor position and mean of the points (metres), and the nearest
    /// return by bearing (centimetres).
    pub fn parts(&self) -> (&[SurfacePoint], [f32; 2], [f32; 2], &[u16; BEARINGS]) {
        (&self.points, self.sensor, self.centroid_m, &self.seen_cm)
    }

    /// The cloud of [`Cloud::parts`]; at most 4096 points.
    pub fn from_parts(
        points: Vec<SurfacePoint>,
        sensor: [f32; 2],
        centroid_m: [f32; 2],
        seen_cm: Box<[u16; BEARINGS]>,
    ) -> Self {
        // Points are grouped already, and grouping keeps the order within a group: nothing moves.
        let mut cloud = Self::with_capacity(points.len());
        cloud.index(&points);
        Self { sensor, centroid_m, seen_cm, ..cloud }
    }

    /// The points, in no particular order.
    pub fn points(&self) -> &[SurfacePoint] {
        &self.points
    }

    /// Mean of the points: about what the scan looks at, in `base_footprint`.
    pub fn centroid_m(&self) -> [f64; 2] {
        self.centroid_m.map(f64::from)
    }

    /// The point nearest to `at`, not farther than `gate_m` (at most `SEARCH_MAX_M`), whose normal
    /// is within about 45° of `normal`, if both are known.
    pub fn nearest(&self, at: [f32; 2], normal: [f32; 2], gate_m: f32) -> Option<&SurfacePoint> {
        let buckets = self.heads.len() - 1;
        let corner = at.map(|v| floor_i32(v * (1.0 / INDEX_CELL_M) - 0.5));
        let mut best = gate_m.min(SEARCH_MAX_M).powi(2);
        let mut found = None;
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let b = bucket([corner[0] + dx, corner[1] + dy], buckets);
            for p in &self.points[self.heads[b] as usize..self.heads[b + 1] as usize] {
                let (x, y) = (p.at[0] - at[0], p.at[1] - at[1]);
                let squared = x * x + y * y;
                if squared < best && compatible(normal, p.normal) {
                    best = squared;
                    found = Some(p);
                }
            }
        }
        found
    }

    /// Whether this scan has a surface at `at` that faces as `normal` does.
    pub fn has_surface(&self, at: [f32; 2], normal: [f32; 2]) -> bool {
        self.nearest(at, normal, SURFACE_TOLERANCE_M).is_some()
    }

    /// Whether this scan saw something clearly (by `margin_m`) behind `at`: nothing can stand there.
    pub fn sees_through(&self, at: [f32; 2], margin_m: f32) -> bool {
        let (range_m, seen_cm) = self.seen_near(at);
        let reach_cm = (range_m + margin_m) * 100.0;
        seen_cm.iter().all(|cm| f32::from(*cm) > reach_cm)
    }

    /// The distance from the sensor to `at`, metres, and the nearest returns in the degree of its direction and the two beside it,
    /// centimetres; 0: no beam.
    fn seen_near(&self, at: [f32; 2]) -> (f32, [u16; 3]) {
        let (x, y) = (at[0] - self.sensor[0], at[1] - self.sensor[1]);
        let bearing_bin = bearing(x, y);
        let around = [bearing_bin + BEARINGS - 1, bearing_bin, bearing_bin + 1];
        ((x * x + y * y).sqrt(), around.map(|b| self.seen_cm[b % BEARINGS]))
    }

    /// Tells how the points of another cloud, placed at `self_from_other`, lie to what this scan saw in their directions. Each of the
    /// beams within a degree of a point counts, where [`Cloud::sees_through`] needs one in each of three degrees.
    pub fn compare_ranges(&self, other: &Cloud, self_from_other: Pose2) -> RangeComparison {
        let transform = PointTransform::new(self_from_other);
        let mut found = RangeComparison { points: other.points.len(), ..RangeComparison::default() };
        for p in &other.points {
            let at = transform.point(p.at);
            if self.has_surface(at, transform.direction(p.normal)) {
                found.on_surface += 1;
                continue;
            }
            let (range_m, around) = self.seen_near(at);
            let range_cm = range_m * 100.0;
            let seen_cm = || around.iter().filter(|cm| **cm > 0).map(|cm| f32::from(*cm));
            let is_seen = seen_cm().next().is_some();
            let margin_cm = 100.0 * SEE_THROUGH_M;
            found.before += usize::from(is_seen && seen_cm().all(|cm| cm > range_cm + margin_cm));
            found.behind += usize::from(is_seen && seen_cm().all(|cm| cm < range_cm - margin_cm));
        }
        found
    }

    /// Compares another cloud, placed at `self_from_other`, with this one: how many of its points lie on a
    /// surface of this scan, and at how many this scan saw something more than `see_through_m` behind them.
    pub fn compare(&self, other: &Cloud, self_from_other: Pose2, see_through_m: f32) -> Agreement {
        let transform = PointTransform::new(self_from_other);
        let mut agreement = Agreement::default();
        for p in &other.points {
            let at = transform.point(p.at);
            if self.has_surface(at, transform.direction(p.normal)) {
                agreement.agree += 1;
            } else if self.sees_through(at, see_through_m) {
                agreement.contradict += 1;
            }
        }
        agreement
    }
}

/// How the points of a scan lie to what another one saw in their directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RangeComparison {
    /// Number of all points of the scan.
    pub points: usize,
    /// Points on a surface of the other scan.
    pub on_surface: usize,
    /// Points clearly before all that the other scan saw near their direction.
    pub before: usize,
    /// Points clearly behind it.
    pub behind: usize,
}

/// How many points of two scans agree with each other, and how many contradict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Points that lie on a surface of the other scan.
    pub agree: usize,
    /// Points that the other scan saw through.
    pub contradict: usize,
}

impl Agreement {
    /// Points of each scan compared with the other one, `b` placed at `a_from_b`.
    pub fn both_ways(a: &Cloud, b: &Cloud, a_from_b: Pose2) -> Self {
        let mut agreement = a.compare(b, a_from_b, SEE_THROUGH_M);
        agreement += b.compare(a, a_from_b.inverse(), SEE_THROUGH_M);
        agreement
    }

    /// Whether at least this share (0 to 1) of the compared points agrees.
    pub fn is_sound(self, share_min: f32) -> bool {
        self.agree as f32 >= share_min * (self.agree + self.contradict) as f32
    }

    /// Whether more than this share (0 to 1) of the compared points, and at least `points_min`, contradicts.
    pub fn is_contradicted(self, share: f32, points_min: usize) -> bool {
        self.contradict >= points_min
            && self.contradict as f32 > share * (self.agree + self.contradict) as f32
    }
}

impl core::ops::AddAssign for Agreement {
    fn add_assign(&mut self, other: Self) {
        self.agree += other.agree;
        self.contradict += other.contradict;
    }
}

/// Whether two normals may belong to one surface: an unknown normal fits any.
fn compatible(a: [f32; 2], b: [f32; 2]) -> bool {
    let faces = a[0] * b[0] + a[1] * b[1];
    faces > FACING || a == [0.0; 2] || b == [0.0; 2]
}

/// Index cell of a point.
fn cell(at: [f32; 2]) -> [i32; 2] {
    at.map(|v| floor_i32(v * (1.0 / INDEX_CELL_M)))
}

/// The largest integer not above `v`: without SSE 4.1 the library's floor is a call. Beyond a billion it
/// stays there, so that neighbours can be counted from it.
pub fn floor_i32(v: f32) -> i32 {
    let whole = v.clamp(-1e9, 1e9) as i32;
    whole - i32::from(v < whole as f32)
}

/// Number of buckets of the index for so many points, a power of two.
fn buckets(points: usize) -> usize {
    (2 * points).next_power_of_two()
}

/// Bucket of an index cell (spatial hash).
fn bucket([x, y]: [i32; 2], buckets: usize) -> usize {
    let hash = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77);
    (hash ^ (hash >> 15)) as usize & (buckets - 1)
}

/// Bearing of a direction, 0 to `BEARINGS - 1`.
fn bearing(x: f32, y: f32) -> usize {
    let turns = y.atan2(x) / core::f32::consts::TAU + 0.5;
    ((turns * BEARINGS as f32) as usize).min(BEARINGS - 1)
}
