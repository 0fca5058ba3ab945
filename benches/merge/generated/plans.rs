//! Pairs of maps drawn from a seed: parts of one building, or two places that are alike.

use super::building::{Building, Kind, Point, Wall, distance};
use super::drawing::{Mapping, draw_map};
use crate::noise::Noise;
use core::f64::consts::TAU;
use msg::grid::{Occupancy, occupancy};
use msg::{Grid, Pose2};

/// Limits of the overlaps' bands.
pub const BANDS: [f64; 6] = [0.05, 0.15, 0.30, 0.50, 0.70, 1.01];
/// Ranges of the LiDARs, metres.
const RANGES_M: [f64; 4] = [3.5, 8.0, 12.0, 25.0];
/// Fields of view, degrees.
const VIEWS_DEG: [f64; 4] = [360.0, 360.0, 270.0, 180.0];
/// Standard deviation of the heading's drift, radians a metre: 3 mrad after a path of 60 m.
const BEND_RAD_PER_M: f64 = 5e-5;
/// A place counts as seen from another place this near, metres: for choosing paths.
const SEEN_M: f64 = 3.0;
/// Most paths tried for an overlap that is wanted.
const TRIES: usize = 30;
/// Share of the pairs of one building in which something has moved.
const CHANGED_SHARE: f64 = 0.4;
/// Share of the inner walls that are not there on the other floor.
const OTHER_WALLS_SHARE: f64 = 0.2;
/// Pieces of furniture tried in each room of a flat, office or museum, and in a room alone (at least).
const PIECES: usize = 8;
const ROOM_PIECES: usize = 10;
/// Length of corridor with one niche, metres.
const NICHE_STEP_M: f64 = 3.0;
/// Share of the path that a map of a hard negative has at least.
const NEGATIVE_PATH_MIN: f64 = 0.5;

/// How two maps are related.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relation {
    /// Parts of one building.
    OneBuilding,
    /// Two rooms of one size with other furniture.
    OtherFurniture,
    /// Two flats, offices or museums with the same rooms and other furniture.
    OtherTenant,
    /// A building and its mirror image.
    Mirrored,
    /// Two floors: other furniture, some other inner walls.
    TwoFloors,
    /// Two corridors of one length and width with other niches.
    EqualCorridors,
    /// Two buildings.
    OtherBuilding,
}

impl Relation {
    /// All relations of places that must not be merged.
    pub const NEGATIVES: [Self; 6] = [
        Self::OtherFurniture,
        Self::OtherTenant,
        Self::Mirrored,
        Self::TwoFloors,
        Self::EqualCorridors,
        Self::OtherBuilding,
    ];

    /// Returns the name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::OneBuilding => "one building",
            Self::OtherFurniture => "rooms of one size, other furniture",
            Self::OtherTenant => "the same rooms, other furniture",
            Self::Mirrored => "mirrored plans",
            Self::TwoFloors => "two floors of one building",
            Self::EqualCorridors => "equal corridors, other niches",
            Self::OtherBuilding => "other buildings",
        }
    }
}

/// Two maps drawn from a seed, and where the second truly lies in the first.
pub struct Case {
    /// The seed.
    pub seed: u64,
    /// How the maps are related.
    pub relation: Relation,
    /// Name of the kind of building.
    pub building: &'static str,
    /// The maps a and b.
    pub maps: [Grid; 2],
    /// The true transform; `None` where there is none.
    pub a_from_b: Option<Pose2>,
    /// Area known to both over the known area of the smaller map; 0 where there is no true transform.
    pub overlap: f64,
}

impl Case {
    /// Draws a pair: even seeds are parts of one building, odd ones places that must not be merged.
    pub fn draw(seed: u64) -> Self {
        let mut noise = Noise::new(seed ^ 0x4D45_5247);
        let half = (seed / 2) as usize;
        if seed.is_multiple_of(2) {
            Self::one_building(seed, Kind::ALL[half % Kind::ALL.len()], &mut noise)
        } else {
            let relation = Relation::NEGATIVES[half % Relation::NEGATIVES.len()];
            Self::negative(seed, relation, &mut noise)
        }
    }

    fn one_building(seed: u64, kind: Kind, noise: &mut Noise) -> Self {
        let building = Building::draw(kind, noise);
        let mapping = draw_mapping(noise);
        let band = noise.below(BANDS.len() - 1);
        let paths = two_parts(&building.route, [BANDS[band], BANDS[band + 1]], noise);
        let mut later = building.clone();
        if noise.uniform() < CHANGED_SHARE {
            change(&mut later, noise);
        }
        let worlds = [&building, &later];
        let frames = paths.each_ref().map(|path| draw_frame(path, noise));
        let maps = [0, 1].map(|k| draw_map(worlds[k], &paths[k], bent(mapping, noise), frames[k], noise));
        let a_from_b = frames[0].between(frames[1]);
        let overlap = overlap_share(&maps, a_from_b);
        Self {
            seed,
            relation: Relation::OneBuilding,
            building: kind.name(),
            maps,
            a_from_b: Some(a_from_b),
            overlap,
        }
    }

    fn negative(seed: u64, relation: Relation, noise: &mut Noise) -> Self {
        let (buildings, name) = draw_alike(relation, noise);
        let mapping = draw_mapping(noise);
        let maps = buildings.each_ref().map(|building| {
            let share = noise.between(NEGATIVE_PATH_MIN, 1.0);
            let begin = noise.between(0.0, 1.0 - share);
            let path = part(&building.route, begin, begin + share);
            let frame = draw_frame(&path, noise);
            draw_map(building, &path, bent(mapping, noise), frame, noise)
        });
        Self { seed, relation, building: name, maps, a_from_b: None, overlap: 0.0 }
    }
}

/// Draws two places that are alike but must not be merged, with a name of the first.
fn draw_alike(relation: Relation, noise: &mut Noise) -> ([Building; 2], &'static str) {
    let with_rooms = [Kind::Office, Kind::Museum, Kind::Flat][noise.below(3)];
    match relation {
        Relation::OtherFurniture => {
            let size = [noise.between(4.0, 9.0), noise.between(3.5, 7.0)];
            ([room(size, noise), room(size, noise)], "room")
        }
        Relation::OtherTenant => {
            let plan = Building::draw(with_rooms, noise);
            ([refurnished(&plan, 0.0, noise), refurnished(&plan, 0.0, noise)], with_rooms.name())
        }
        Relation::TwoFloors => {
            let plan = Building::draw(with_rooms, noise);
            let floors = [refurnished(&plan, 0.0, noise), refurnished(&plan, OTHER_WALLS_SHARE, noise)];
            (floors, with_rooms.name())
        }
        Relation::Mirrored => {
            let kind = [Kind::Office, Kind::Museum, Kind::Flat, Kind::RingOfCorridors][noise.below(4)];
            let drawn = Building::draw(kind, noise);
            let first = if drawn.rooms.is_empty() { drawn } else { refurnished(&drawn, 0.0, noise) };
            let second = mirrored(&first);
            ([first, second], kind.name())
        }
        Relation::EqualCorridors => {
            let size = [noise.between(15.0, 40.0), noise.between(1.8, 2.6)];
            ([corridor(size, noise), corridor(size, noise)], "corridor with niches")
        }
        Relation::OtherBuilding | Relation::OneBuilding => {
            // Two empty corridors, halls or aisles of one size are alike: nothing tells them apart.
            let kinds = [Kind::Office, Kind::RingOfCorridors, Kind::Museum, Kind::Flat, Kind::Campus];
            let kind = kinds[noise.below(kinds.len())];
            let other = if noise.uniform() < 0.5 { kind } else { with_rooms };
            ([Building::draw(kind, noise), Building::draw(other, noise)], kind.name())
        }
    }
}

fn draw_mapping(noise: &mut Noise) -> Mapping {
    Mapping {
        view_deg: VIEWS_DEG[noise.below(VIEWS_DEG.len())],
        range_m: RANGES_M[noise.below(RANGES_M.len())],
        noise_m: noise.between(0.005, 0.02),
        bend_rad_per_m: 0.0,
    }
}

fn bent(mapping: Mapping, noise: &mut Noise) -> Mapping {
    Mapping { bend_rad_per_m: BEND_RAD_PER_M * noise.normal(), ..mapping }
}

/// A robot's map begins where it starts, at any heading.
fn draw_frame(path: &[Point], noise: &mut Noise) -> Pose2 {
    let [x, y] = path.first().copied().unwrap_or_default();
    Pose2::new(x, y, noise.between(-TAU / 2.0, TAU / 2.0))
}

/// The part of a route between two shares of its length.
fn part(route: &[Point], from: f64, to: f64) -> Vec<Point> {
    let length_m: f64 = route.windows(2).map(|leg| distance(leg[0], leg[1])).sum();
    let (from_m, to_m, mut begin_m) = (from * length_m, to * length_m, 0.0);
    let mut path = Vec::new();
    for leg in route.windows(2) {
        let leg_m = distance(leg[0], leg[1]);
        let at = |m: f64| {
            let share = ((m - begin_m) / leg_m.max(1e-9)).clamp(0.0, 1.0);
            [0, 1].map(|k| leg[0][k] + share * (leg[1][k] - leg[0][k]))
        };
        if begin_m < to_m && begin_m + leg_m > from_m {
            if path.is_empty() {
                path.push(at(from_m));
            }
            path.push(at(to_m));
        }
        begin_m += leg_m;
    }
    path
}

/// Two parts of a route whose surroundings overlap by about this share, if such are found.
fn two_parts(route: &[Point], [least, most]: [f64; 2], noise: &mut Noise) -> [Vec<Point>; 2] {
    let mut best: Option<(f64, [Vec<Point>; 2])> = None;
    for _ in 0..TRIES {
        let mut draw = || {
            let share = noise.between(0.2, 0.8);
            let begin = noise.between(0.0, 1.0 - share);
            part(route, begin, begin + share)
        };
        let parts = [draw(), draw()];
        let shared = shared_path(&parts[0], &parts[1]).max(shared_path(&parts[1], &parts[0]));
        let miss = (least - shared).max(shared - most).max(0.0);
        if best.as_ref().is_none_or(|(other, _)| miss < *other) {
            best = Some((miss, parts));
        }
        if miss == 0.0 {
            break;
        }
    }
    best.map_or_else(|| [route.to_vec(), route.to_vec()], |(_, parts)| parts)
}

/// Share of a path that lies near another.
fn shared_path(path: &[Point], other: &[Point]) -> f64 {
    let places = |path: &[Point]| -> Vec<Point> {
        path.windows(2)
            .flat_map(|leg| {
                let count = distance(leg[0], leg[1]).ceil().max(1.0) as usize;
                let at = move |step: usize| step as f64 / count as f64;
                let leg = [leg[0], leg[1]];
                (0..count).map(move |step| [0, 1].map(|k| leg[0][k] + at(step) * (leg[1][k] - leg[0][k])))
            })
            .collect()
    };
    let (path, other) = (places(path), places(other));
    let near = path.iter().filter(|at| other.iter().any(|there| distance(**at, *there) < SEEN_M)).count();
    near as f64 / path.len().max(1) as f64
}

/// The building with other furniture, and without some of its inner walls.
fn refurnished(building: &Building, walls_left_out: f64, noise: &mut Noise) -> Building {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for at in building.walls.iter().flat_map(|wall| [wall.from, wall.to]) {
        for k in 0..2 {
            (low[k], high[k]) = (low[k].min(at[k]), high[k].max(at[k]));
        }
    }
    let mut walls = building.walls[..building.fixed_walls].to_vec();
    walls.retain(|wall| {
        let on_edge = |k: usize| {
            wall.from[k] == wall.to[k] && (wall.from[k] - low[k] < 0.01 || high[k] - wall.from[k] < 0.01)
        };
        on_edge(0) || on_edge(1) || noise.uniform() >= walls_left_out
    });
    let (route, rooms) = (building.route.clone(), building.rooms.clone());
    let mut other = Building { walls, route, rooms, fixed_walls: 0 };
    other.furnish(PIECES, noise);
    other
}

/// Moves or removes furniture, or puts some there.
fn change(building: &mut Building, noise: &mut Noise) {
    let pieces = (building.walls.len() - building.fixed_walls) / 4;
    if pieces > 0 {
        let first = building.fixed_walls + 4 * noise.below(pieces);
        building.walls.drain(first..first + 4);
    }
    if !building.rooms.is_empty() {
        let [low, high] = building.rooms[noise.below(building.rooms.len())];
        building.add_furniture(low, high, 2, noise);
    }
}

fn mirrored(building: &Building) -> Building {
    let mirror = |[x, y]: Point| [-x, y];
    Building {
        walls: building
            .walls
            .iter()
            .map(|wall| Wall { from: mirror(wall.from), to: mirror(wall.to), ..*wall })
            .collect(),
        route: building.route.iter().copied().map(mirror).collect(),
        rooms: Vec::new(),
        fixed_walls: building.fixed_walls,
    }
}

/// A room with furniture along a way around its centre.
fn room([width, depth]: [f64; 2], noise: &mut Noise) -> Building {
    let route = [[0.35, 0.35], [0.65, 0.35], [0.65, 0.65], [0.35, 0.65], [0.35, 0.35]]
        .map(|[x, y]| [x * width, y * depth])
        .to_vec();
    let rooms = vec![[[0.05, 0.05], [width - 0.05, depth - 0.05]]];
    let mut room = Building { walls: Vec::new(), route, rooms, fixed_walls: 4 };
    room.add_box([0.0; 2], [width, depth]);
    room.furnish(ROOM_PIECES + noise.below(ROOM_PIECES), noise);
    room
}

/// A corridor with niches, which are drawn as cupboards along its walls.
fn corridor([length, width]: [f64; 2], noise: &mut Noise) -> Building {
    let route = vec![[1.0, width / 2.0], [length - 1.0, width / 2.0]];
    let mut corridor = Building { walls: Vec::new(), route, rooms: Vec::new(), fixed_walls: 4 };
    corridor.add_box([0.0; 2], [length, width]);
    for _ in 0..(length / NICHE_STEP_M) as usize {
        let (depth_m, length_m) = (noise.between(0.2, 0.45), noise.between(0.3, 1.5));
        let x = noise.between(0.0, length - length_m);
        let y = if noise.uniform() < 0.5 { 0.0 } else { width - depth_m };
        corridor.add_box([x, y], [x + length_m, y + depth_m]);
    }
    corridor
}

/// Area known to both maps over the known area of the smaller one.
fn overlap_share([a, b]: &[Grid; 2], a_from_b: Pose2) -> f64 {
    let known =
        |grid: &Grid| grid.cells.iter().filter(|cell| occupancy(**cell) != Occupancy::Unknown).count();
    let width = b.header.width as usize;
    let both = b.cells.iter().enumerate().filter(|(_, cell)| occupancy(**cell) != Occupancy::Unknown);
    let both = both.filter(|(index, _)| {
        let at = b.view().centre_m((index % width) as i64, (index / width) as i64);
        let (x, y) = a.view().cell_of(a_from_b.apply(at));
        occupancy(a.view().cell(x, y)) != Occupancy::Unknown
    });
    both.count() as f64 / known(a).min(known(b)).max(1) as f64
}
