//! Pairs of maps drawn from seeds, with known truth: parts of one building, and places that are alike but must not be
//! merged.
//!
//! `--logs generated --seeds 0..400`. Even seeds are parts of one building, odd ones hard negatives. Seeds from
//! [`HELD_BACK`](crate::seeds::HELD_BACK) on are for reporting: nothing is tuned on them. `--maps DIR` draws every wrong pair.

#[allow(dead_code, reason = "shared with the slam bench, which uses more of it")]
#[path = "../../slam/generated/building.rs"]
mod building;
mod drawing;
mod plans;

use crate::pairs::{Outcome, is_right, middle};
use crate::seeds::Seeds;
use crate::table::{Row, Table};
use formats::map_file::{MapFileError, Picture, write_map};
use merge::{AlignConfig, Alignment, align_near};
use msg::grid::{Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridHeader, Pose2};
use plans::{BANDS, Case, Relation};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Two alignments nearer than this are one, metres.
const SAME_PLACE_M: f64 = 0.5;

/// A pair and what became of it.
struct Judged {
    seed: u64,
    relation: Relation,
    building: &'static str,
    overlap: f64,
    found: Option<Alignment>,
    error: Option<[f64; 2]>,
    /// Refined from the truth: the evidence there. `None` where there is no truth.
    at_truth: Option<Alignment>,
}

impl Judged {
    fn new(case: &Case) -> Self {
        let maps = [&case.maps[0], &case.maps[1]];
        let outcome = Outcome::of(maps, case.a_from_b);
        let near = |truth| align_near(maps[0].view(), maps[1].view(), truth, &AlignConfig::default());
        Self {
            seed: case.seed,
            relation: case.relation,
            building: case.building,
            overlap: case.overlap,
            found: outcome.found,
            error: outcome.error,
            at_truth: case.a_from_b.and_then(near),
        }
    }

    fn accepted(&self) -> bool {
        self.found.is_some_and(|found| found.accepted)
    }

    fn right(&self) -> bool {
        self.accepted() && self.error.is_some_and(is_right)
    }

    /// Whether the thresholds pass at the true place, also those of the margins, or of the margin over the place that was found elsewhere.
    fn acceptable(&self) -> bool {
        let (Some(truth), Some(found)) = (self.at_truth, self.found) else { return false };
        let is_there = found.a_from_b.distance_m(truth.a_from_b) < SAME_PLACE_M;
        let margin = if is_there { found.margin } else { truth.score_m / found.score_m };
        let config = AlignConfig::default();
        let repeats = is_there && found.short_walls_margin < config.short_walls_margin_min;
        truth.accepted && margin >= config.margin_min && !repeats
    }

    /// Whether the thresholds but the margin pass at the true place.
    fn fits(&self) -> bool {
        self.at_truth.is_some_and(|found| found.accepted)
    }

    fn json(&self) -> Value {
        json!({
            "seed": self.seed, "relation": self.relation.name(), "building": self.building, "overlap": self.overlap,
            "right": self.right(), "error": self.error, "found": self.found, "at_truth": self.at_truth,
        })
    }
}

/// Adds the figures of the pairs of these seeds; returns all pairs as JSON.
pub fn rows(table: &mut Table, seeds: &Seeds, maps: Option<&Path>) -> Result<Vec<Value>, MapFileError> {
    let mut judged = score_all(seeds);
    judged.sort_by_key(|pair| pair.seed);
    table.begin("generated pairs of one building", "right", "acceptable");
    let of_one = |of: &dyn Fn(&Judged) -> bool| -> Vec<&Judged> {
        judged.iter().filter(|pair| pair.relation == Relation::OneBuilding && of(pair)).collect()
    };
    for band in BANDS.windows(2) {
        let of = of_one(&|pair| (band[0]..band[1]).contains(&pair.overlap));
        let name = format!("overlap {:.0} to {:.0} %", 100.0 * band[0], 100.0 * band[1].min(1.0));
        table.add(recall(name, &of));
    }
    let kinds: std::collections::BTreeSet<_> = of_one(&|_| true).iter().map(|pair| pair.building).collect();
    for kind in kinds {
        table.add(recall(kind.to_owned(), &of_one(&|pair| pair.building == kind)));
    }
    let all = of_one(&|_| true);
    let found = all.iter().filter(|pair| pair.right() && pair.acceptable()).count() as f64;
    let acceptable = all.iter().filter(|pair| pair.acceptable()).count() as f64;
    table.add(
        Row::new("found of those that pass at the truth, %, pairs", 100.0 * found / acceptable, acceptable)
            .at_least(80.0),
    );
    let wrong = all.iter().filter(|pair| pair.accepted() && !pair.right());
    table.add(Row::new("wrong places accepted, pairs", wrong.count() as f64, all.len() as f64).at_most(0.0));
    let mut errors: Vec<f64> =
        all.iter().filter(|p| p.right()).filter_map(|p| p.error).map(|[m, _]| m).collect();
    errors.sort_by(f64::total_cmp);
    table.add(Row::new("median error, m", middle(&errors), errors.len() as f64));
    table.begin("generated pairs of places that are alike", "accepted", "pairs");
    for relation in Relation::NEGATIVES {
        let of = judged.iter().filter(|pair| pair.relation == relation);
        let accepted: Vec<u64> = of.clone().filter(|pair| pair.accepted()).map(|pair| pair.seed).collect();
        let note = if accepted.is_empty() { String::new() } else { format!("seeds {accepted:?}") };
        table
            .add(Row::new(relation.name(), accepted.len() as f64, of.count() as f64).at_most(0.0).note(note));
    }
    if let Some(folder) = maps {
        for pair in judged.iter().filter(|pair| pair.accepted() && !pair.right()) {
            draw(pair, folder)?;
        }
    }
    Ok(judged.iter().map(Judged::json).collect())
}

fn recall(name: String, pairs: &[&Judged]) -> Row {
    let right = pairs.iter().filter(|pair| pair.right()).count();
    let acceptable = pairs.iter().filter(|pair| pair.acceptable()).count();
    let wrong: Vec<u64> = pairs.iter().filter(|p| p.accepted() && !p.right()).map(|p| p.seed).collect();
    let fits = pairs.iter().filter(|pair| pair.fits()).count();
    let note = format!("of {} pairs, {fits} but for the margin", pairs.len());
    let note = if wrong.is_empty() { note } else { format!("{note}; wrong: seeds {wrong:?}") };
    Row::new(name, right as f64, acceptable as f64).note(note)
}

/// Judges the pairs of all seeds on as many threads as there are cores.
fn score_all(seeds: &Seeds) -> Vec<Judged> {
    let next = AtomicU64::new(seeds.range.start);
    let judged = Mutex::new(Vec::new());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(seeds.step, Ordering::Relaxed);
                    if seed >= seeds.range.end {
                        return;
                    }
                    let pair = Judged::new(&Case::draw(seed));
                    judged.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(pair);
                }
            });
        }
    });
    judged.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Writes both maps, and a picture of b's walls over map a where they were found to lie.
fn draw(pair: &Judged, folder: &Path) -> Result<(), MapFileError> {
    let Some(found) = pair.found else { return Ok(()) };
    let [a, b] = Case::draw(pair.seed).maps;
    for (name, map) in [("a", &a), ("b", &b)] {
        write_map(&folder.join(format!("pair-{}-{name}", pair.seed)), map.view())?;
    }
    let walls: Vec<[f64; 2]> = walls_of(&b).map(|at| found.a_from_b.apply(at)).collect();
    let both = extended(&a, &walls);
    let mut picture = Picture::new(both.view());
    walls.iter().for_each(|at| picture.path([*at, *at], Picture::robot_colour(0)));
    picture.write_png(&folder.join(format!("pair-{}.png", pair.seed)))
}

fn walls_of(map: &Grid) -> impl Iterator<Item = [f64; 2]> {
    let width = map.header.width as usize;
    let walls = map.cells.iter().enumerate().filter(|(_, cell)| occupancy(**cell) == Occupancy::Occupied);
    walls.map(move |(index, _)| map.view().centre_m((index % width) as i64, (index / width) as i64))
}

/// The map on a grid that holds these points too.
fn extended(map: &Grid, points: &[[f64; 2]]) -> Grid {
    let size = [map.header.width, map.header.height].map(i64::from);
    let cells = points.iter().map(|at| map.view().cell_of(*at));
    let (mut low, mut high) = ([0; 2], size);
    for (x, y) in cells {
        (low, high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x + 1), high[1].max(y + 1)]);
    }
    let corner = low.map(|cells| cells as f64 * map.header.resolution_m);
    let origin = map.header.origin * Pose2::new(corner[0], corner[1], 0.0);
    let [width, height] = [0, 1].map(|k| high[k] - low[k]);
    let cell = |x: i64, y: i64| {
        if (0..size[0]).contains(&x) && (0..size[1]).contains(&y) { map.view().cell(x, y) } else { UNKNOWN }
    };
    let cells = (low[1]..high[1]).flat_map(|y| (low[0]..high[0]).map(move |x| cell(x, y))).collect();
    Grid { header: GridHeader { origin, width: width as u32, height: height as u32, ..map.header }, cells }
}
