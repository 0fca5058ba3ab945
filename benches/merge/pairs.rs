//! Alignment of pairs of maps with exact truth: how many are found, how exactly, how fast, and that no wrong place is
//! accepted.

use super::table::{Row, Table};
use formats::map_file::read_map;
use merge::{AlignConfig, Alignment, align};
use msg::grid::{Occupancy, occupancy};
use msg::pose::{best_rigid_transform, wrap_angle};
use msg::{Grid, Pose2};
use serde::Deserialize;
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

/// Largest error of a right place: RMS displacement of b's walls in the overlap, metres, and rotation, degrees.
const RIGHT: [f64; 2] = [0.5, 5.0];

/// Two maps, and where the second truly lies in the first.
pub struct Pair {
    /// Name of its folder.
    pub name: String,
    /// The maps a and b.
    pub maps: [Grid; 2],
    /// The true transform; `None` for maps of different buildings.
    pub a_from_b: Option<Pose2>,
    /// Area known to both over the known area of the smaller map.
    pub overlap: f64,
}

#[derive(Deserialize)]
struct Truth {
    #[serde(rename = "T_A_B")]
    a_from_b: Option<[f64; 3]>,
    #[serde(default)]
    ov_min: Option<f64>,
}

/// Reads all pairs of a folder, sorted by name.
pub fn read(folder: &Path) -> Result<Vec<Pair>, Box<dyn std::error::Error>> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(Vec::new()) };
    let mut folders: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    folders.sort();
    let mut pairs = Vec::new();
    for folder in folders.iter().filter(|folder| folder.join("truth.json").is_file()) {
        let truth: Truth = serde_json::from_str(&std::fs::read_to_string(folder.join("truth.json"))?)?;
        pairs.push(Pair {
            name: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            maps: [read_map(&folder.join("a.yaml"))?, read_map(&folder.join("b.yaml"))?],
            a_from_b: truth.a_from_b.map(|[x, y, yaw]| Pose2::new(x, y, yaw)),
            overlap: truth.ov_min.unwrap_or(0.0),
        });
    }
    Ok(pairs)
}

/// Result of aligning a pair.
pub struct Outcome {
    /// The alignment, if any.
    pub found: Option<Alignment>,
    /// Processor time of the thread, milliseconds.
    pub ms: f64,
    /// Error of an accepted place: RMS displacement (metres) and rotation (degrees) from the truth.
    pub error: Option<[f64; 2]>,
}

impl Outcome {
    /// Aligns two maps.
    pub fn of(maps: [&Grid; 2], a_from_b: Option<Pose2>) -> Self {
        let outcome = Self::unjudged(maps);
        let error = outcome.place().zip(a_from_b).map(|(place, truth)| {
            displacement(&shared_walls(maps, |at| truth.apply(at)), place).unwrap_or([f64::INFINITY; 2])
        });
        Self { error, ..outcome }
    }

    /// Aligns two maps of which the second is bent; `straight` maps a point of it to the straight map, of which the truth
    /// is known. No transform puts a bent map right everywhere: only walls that match count.
    pub fn of_bent(
        maps: [&Grid; 2],
        a_from_b: Option<Pose2>,
        straight: impl Fn([f64; 2]) -> [f64; 2],
    ) -> Self {
        let outcome = Self::unjudged(maps);
        let error = outcome.place().zip(a_from_b).map(|(place, truth)| {
            let mut walls = shared_walls(maps, |at| truth.apply(straight(at)));
            walls.retain(|(at, _)| is_wall_near(maps[0], place.apply(*at)));
            displacement(&walls, place).unwrap_or([f64::INFINITY; 2])
        });
        Self { error, ..outcome }
    }

    fn unjudged(maps: [&Grid; 2]) -> Self {
        let began_s = cpu_s();
        let found = align(maps[0].view(), maps[1].view(), &AlignConfig::default());
        Self { found, ms: 1e3 * (cpu_s() - began_s), error: None }
    }

    /// Whether the alignment was accepted.
    pub fn accepted(&self) -> bool {
        self.place().is_some()
    }

    fn place(&self) -> Option<Pose2> {
        self.found.filter(|found| found.accepted).map(|found| found.a_from_b)
    }

    /// Whether it was accepted at the right place.
    pub fn right(&self) -> bool {
        self.error.is_some_and(is_right)
    }
}

/// Whether an error, metres and degrees, is that of a right place.
pub fn is_right([m, deg]: [f64; 2]) -> bool {
    m < RIGHT[0] && deg < RIGHT[1]
}

/// A wall point in b, and where it truly lies in a.
type Wall = ([f64; 2], [f64; 2]);

/// b's wall points where a is known.
fn shared_walls([a, b]: [&Grid; 2], truly: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<Wall> {
    let cells =
        (0..i64::from(b.header.height)).flat_map(|y| (0..i64::from(b.header.width)).map(move |x| (x, y)));
    let walls = cells.filter(|(x, y)| occupancy(b.view().cell(*x, *y)) == Occupancy::Occupied);
    let places = walls.map(|(x, y)| b.view().centre_m(x, y)).map(|at| (at, truly(at)));
    let known = |at: [f64; 2]| {
        let (i, j) = a.view().cell_of(at);
        occupancy(a.view().cell(i, j)) != Occupancy::Unknown
    };
    places.filter(|(_, there)| known(*there)).collect()
}

/// Whether the cell at a point, or one around it, is occupied.
fn is_wall_near(map: &Grid, at: [f64; 2]) -> bool {
    let (x, y) = map.view().cell_of(at);
    let around = (-1..=1).flat_map(|j| (-1..=1).map(move |i| (i, j)));
    around.into_iter().any(|(i, j)| occupancy(map.view().cell(x + i, y + j)) == Occupancy::Occupied)
}

/// Error of an estimate: RMS displacement of walls, metres, and rotation, degrees; `None` without walls. The rotation is
/// relative to the one that fits the walls best.
fn displacement(walls: &[Wall], estimate: Pose2) -> Option<[f64; 2]> {
    let count = walls.len() as f64;
    let squared_m2 = |(at, truly): &Wall| {
        let placed = estimate.apply(*at);
        (truly[0] - placed[0]).powi(2) + (truly[1] - placed[1]).powi(2)
    };
    let rms_m = (walls.iter().map(squared_m2).sum::<f64>() / count).sqrt();
    let pairs: Vec<_> = walls.iter().map(|(at, truly)| [*at, *truly]).collect();
    let best = best_rigid_transform(&pairs)?;
    Some([rms_m, wrap_angle(estimate.yaw_rad - best.yaw_rad).abs().to_degrees()])
}

/// Adds the figures of the pairs as they are.
pub fn rows(table: &mut Table, pairs: &[Pair], results: Option<&Path>) -> std::io::Result<()> {
    table.begin("pairs of maps, unknown starts", "value", "pairs");
    let began = Instant::now();
    let outcomes: Vec<Outcome> =
        pairs.iter().map(|pair| Outcome::of([&pair.maps[0], &pair.maps[1]], pair.a_from_b)).collect();
    let wall_s = began.elapsed().as_secs_f64();
    let both = || pairs.iter().zip(&outcomes);
    let band = |low: f64, high: f64| {
        let of = || both().filter(|(p, _)| p.a_from_b.is_some() && p.overlap >= low && p.overlap < high);
        (of().filter(|(_, outcome)| outcome.right()).count() as f64, of().count() as f64)
    };
    for (low, high) in [(0.0, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 9.0)] {
        let (right, all) = band(low, high);
        let name = if high > 1.0 {
            "right at >= 70 % overlap, pairs".into()
        } else {
            format!("right at {:.0} to {:.0} % overlap, pairs", 100.0 * low, 100.0 * high)
        };
        table.add(Row::new(name, right, all));
    }
    let share = |(right, all): (f64, f64)| 100.0 * right / all;
    table
        .add(Row::new("right at >= 30 % overlap, %", share(band(0.3, 9.0)), band(0.3, 9.0).1).at_least(95.0));
    table.add(Row::new("right at < 30 % overlap, %", share(band(0.0, 0.3)), band(0.0, 0.3).1).at_least(75.0));
    let wrong = both().filter(|(pair, o)| pair.a_from_b.is_some() && o.accepted() && !o.right()).count();
    table.add(Row::new("wrong places accepted, pairs", wrong as f64, band(0.0, 9.0).1).at_most(0.0));
    let negatives = || both().filter(|(pair, _)| pair.a_from_b.is_none());
    let accepted = negatives().filter(|(_, outcome)| outcome.accepted()).count();
    table.add(
        Row::new(
            "negatives (different buildings) accepted, pairs",
            accepted as f64,
            negatives().count() as f64,
        )
        .at_most(0.0),
    );
    let mut errors: Vec<f64> =
        outcomes.iter().filter(|o| o.right()).filter_map(|o| o.error).map(|[m, _]| m).collect();
    errors.sort_by(f64::total_cmp);
    table.add(Row::new("median error, m", middle(&errors), errors.len() as f64).at_most(0.02));
    let mut small: Vec<f64> = both().filter(|(p, _)| is_small(p)).map(|(_, o)| o.ms).collect();
    small.sort_by(f64::total_cmp);
    let (median_ms, most_ms) = (middle(&small), small.last().copied().unwrap_or(f64::NAN));
    let count = small.len() as f64;
    let note = format!("({:.1} s for all {})", wall_s, pairs.len());
    table.add(Row::new("processor time a pair up to 1000 x 1000: median, ms", median_ms, count).note(note));
    table.add(Row::new("  maximum, ms", most_ms, count).note("(aim 300, alone on the machine)"));
    // Milliseconds depend on the machine and on what else it does: limits are ratios of this run.
    let compose_ms = super::speed::compose_all_new_ms();
    table.add(
        Row::new("  median over composing 8 x 1000 x 1000", median_ms / compose_ms, count).at_most(25.0),
    );
    table.add(Row::new("  maximum over median", most_ms / median_ms, count).at_most(3.0));
    results.map_or(Ok(()), |path| std::fs::write(path, json_lines(pairs, &outcomes)))
}

/// One JSON line a pair.
fn json_lines(pairs: &[Pair], outcomes: &[Outcome]) -> String {
    let mut lines = String::new();
    for (pair, outcome) in pairs.iter().zip(outcomes) {
        let found = outcome.found.map(|found| {
            serde_json::json!({
                "x": found.a_from_b.x_m, "y": found.a_from_b.y_m, "theta": found.a_from_b.yaw_rad,
                "inliers": found.inliers, "score": found.occupied_f1, "strict": found.agreement,
                "overlap_m2": found.overlap_m2, "overlap_share": found.overlap_share, "residual_m": found.residual_m,
                "conflict": found.conflict, "margin": found.margin, "short_walls_margin": found.short_walls_margin, "short_wall_conflict": found.short_wall_conflict, "short_walls_m": found.short_walls_m, "observability": found.observability,
            })
        });
        let mut line = found.unwrap_or(serde_json::json!({}));
        (line["pair"], line["accepted"], line["ms"]) =
            (pair.name.clone().into(), outcome.accepted().into(), outcome.ms.into());
        let _ = writeln!(lines, "{line}");
    }
    lines
}

fn is_small(pair: &Pair) -> bool {
    pair.maps.iter().all(|map| map.header.width.max(map.header.height) <= 1000)
}

/// Median of sorted values.
pub fn middle(sorted: &[f64]) -> f64 {
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Processor time of this thread, seconds: a busy machine hardly changes it.
pub fn cpu_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
