//! Pairs of maps with exact truth: how many are found, how exactly, how fast, and that nothing wrong is accepted.

use super::table::{Row, Table};
use formats::map_file::read_map;
use merge::{AlignConfig, Alignment, align};
use msg::grid::{Occupancy, occupancy};
use msg::{Grid, Pose2, pose::wrap_angle};
use serde::Deserialize;
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

/// An accepted place is right within these: RMS displacement of b's walls in the overlap, metres, and rotation, degrees.
const RIGHT: [f64; 2] = [0.5, 5.0];

/// Two maps and where the second truly lies in the first; `None`: of different buildings.
pub struct Pair {
    /// The folder's.
    pub name: String,
    /// The maps.
    pub maps: [Grid; 2],
    /// The truth.
    pub a_from_b: Option<Pose2>,
    /// Known to both over what the smaller one knows.
    pub overlap: f64,
}

#[derive(Deserialize)]
struct Truth {
    #[serde(rename = "T_A_B")]
    a_from_b: Option<[f64; 3]>,
    #[serde(default)]
    ov_min: Option<f64>,
}

/// All pairs in a folder, by name.
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

/// What became of a pair.
pub struct Outcome {
    /// What was found.
    pub found: Option<Alignment>,
    /// Thread's processor time, milliseconds.
    pub ms: f64,
    /// Of an accepted place: RMS displacement and rotation from the truth.
    pub error: Option<[f64; 2]>,
}

impl Outcome {
    /// Aligns two maps as they are.
    pub fn of(maps: [&Grid; 2], a_from_b: Option<Pose2>) -> Self {
        let outcome = Self::unjudged(maps);
        let error = outcome.place().zip(a_from_b).map(|(place, truth)| {
            displacement(&shared_walls(maps, |at| truth.apply(at)), place).unwrap_or([f64::INFINITY; 2])
        });
        Self { error, ..outcome }
    }

    /// The same where the second map is bent, and `straight` takes a point of it to where it is in the one that the truth
    /// is of. No transform puts a bent map right everywhere: what counts are the walls that were found again.
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

    /// Accepted.
    pub fn accepted(&self) -> bool {
        self.place().is_some()
    }

    fn place(&self) -> Option<Pose2> {
        self.found.filter(|found| found.accepted).map(|found| found.a_from_b)
    }

    /// Accepted where it truly lies.
    pub fn right(&self) -> bool {
        self.error.is_some_and(|[m, deg]| m < RIGHT[0] && deg < RIGHT[1])
    }
}

/// A wall: in b, and where it truly lies in a.
type Wall = ([f64; 2], [f64; 2]);

/// b's walls where a knows something.
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

/// A wall in the cell or in one around it.
fn is_wall_near(map: &Grid, at: [f64; 2]) -> bool {
    let (x, y) = map.view().cell_of(at);
    let around = (-1..=1).flat_map(|j| (-1..=1).map(move |i| (i, j)));
    around.into_iter().any(|(i, j)| occupancy(map.view().cell(x + i, y + j)) == Occupancy::Occupied)
}

/// RMS displacement of walls, metres, and rotation, degrees, of an estimate; `None` without walls. The rotation is from
/// that which fits them best (Umeyama, "Least-squares estimation of transformation parameters between two point
/// patterns", PAMI 1991).
fn displacement(walls: &[Wall], estimate: Pose2) -> Option<[f64; 2]> {
    let count = walls.len() as f64;
    let middle = |of: fn(&Wall) -> [f64; 2]| {
        walls.iter().map(of).fold([0.0; 2], |sum, at| [sum[0] + at[0] / count, sum[1] + at[1] / count])
    };
    let (here, there) = (middle(|wall| wall.0), middle(|wall| wall.1));
    let (mut sum, mut dot, mut cross) = (0.0, 0.0, 0.0);
    for (at, truly) in walls {
        let placed = estimate.apply(*at);
        sum += (truly[0] - placed[0]).powi(2) + (truly[1] - placed[1]).powi(2);
        let ([x, y], [u, v]) =
            ([at[0] - here[0], at[1] - here[1]], [truly[0] - there[0], truly[1] - there[1]]);
        dot += x * u + y * v;
        cross += x * v - y * u;
    }
    let rms_m = (sum / count).sqrt();
    let turned = wrap_angle(estimate.yaw_rad - f64::atan2(cross, dot)).abs();
    (!walls.is_empty()).then(|| [rms_m, turned.to_degrees()])
}

/// The public pairs as they are.
pub fn rows(table: &mut Table, pairs: &[Pair], results: Option<&Path>) -> std::io::Result<()> {
    table.begin("pairs of maps, unknown starts", "", "of");
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
            "right at >= 70 % overlap".into()
        } else {
            format!("right at {:.0} to {:.0} % overlap", 100.0 * low, 100.0 * high)
        };
        table.add(Row::new(name, right, all));
    }
    let share = |(right, all): (f64, f64)| 100.0 * right / all;
    table
        .add(Row::new("right at >= 30 % overlap, %", share(band(0.3, 9.0)), band(0.3, 9.0).1).at_least(95.0));
    table.add(Row::new("right below, %", share(band(0.0, 0.3)), band(0.0, 0.3).1).at_least(75.0));
    let wrong = both().filter(|(pair, o)| pair.a_from_b.is_some() && o.accepted() && !o.right()).count();
    table.add(Row::new("wrong places accepted", wrong as f64, band(0.0, 9.0).1).at_most(0.0));
    let strangers = || both().filter(|(pair, _)| pair.a_from_b.is_none());
    let fooled = strangers().filter(|(_, outcome)| outcome.accepted()).count();
    table.add(
        Row::new("different buildings accepted", fooled as f64, strangers().count() as f64).at_most(0.0),
    );
    let mut errors: Vec<f64> =
        outcomes.iter().filter(|o| o.right()).filter_map(|o| o.error).map(|[m, _]| m).collect();
    errors.sort_by(f64::total_cmp);
    table.add(Row::new("median error, m", middle(&errors), errors.len() as f64).at_most(0.02));
    let mut small: Vec<f64> = both().filter(|(p, _)| is_small(p)).map(|(_, o)| o.ms).collect();
    small.sort_by(f64::total_cmp);
    let most = small.last().copied().unwrap_or(f64::NAN);
    let note = format!("({:.1} s for all {})", wall_s, pairs.len());
    table.add(
        Row::new("processor ms a pair up to 1000 x 1000: median", middle(&small), small.len() as f64)
            .note(note),
    );
    table.add(Row::new("  most", most, small.len() as f64).at_most(300.0));
    let mut lines = String::new();
    for (pair, outcome) in both() {
        let found = outcome.found.map(|found| {
            serde_json::json!({
                "x": found.a_from_b.x_m, "y": found.a_from_b.y_m, "theta": found.a_from_b.yaw_rad,
                "inliers": found.inliers, "score": found.occupied_f1, "strict": found.agreement,
                "overlap_m2": found.overlap_m2, "overlap_share": found.overlap_share, "residual_m": found.residual_m,
                "conflict": found.conflict, "margin": found.margin, "observability": found.observability,
            })
        });
        let mut line = found.unwrap_or(serde_json::json!({}));
        (line["pair"], line["accepted"], line["ms"]) =
            (pair.name.clone().into(), outcome.accepted().into(), outcome.ms.into());
        let _ = writeln!(lines, "{line}");
    }
    results.map_or(Ok(()), |path| std::fs::write(path, lines))
}

fn is_small(pair: &Pair) -> bool {
    pair.maps.iter().all(|map| map.header.width.max(map.header.height) <= 1000)
}

/// Of sorted values.
pub fn middle(sorted: &[f64]) -> f64 {
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Processor time of this thread, seconds: what a busy machine does not change much.
pub fn cpu_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
