//! One fleet in one generated room: simulators, exact poses, and the map drawn from the scans.

use bytemuck::Zeroable;
use msg::grid::{LOG_ODDS_MAX, Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridView, GroundTruth, Pose2, RobotId, Scan, Stamp, VelocityCommand};
use nav::observation::BURGER_BASE_FROM_SCAN;
use nav::{ClearanceMap, MapView, RobotBody, RouteSearch, ScanView, Twist};
use sim::{Room, SimConfig, Simulator};

/// Length of the map's cells, metres.
const RESOLUTION_M: f64 = 0.05;
/// Ticks between two control steps: 20 Hz.
const CONTROL_TICKS: usize = 5;
/// Evidence of a hit and of a miss, in the map's steps: a hit is kept over one miss, two misses are free.
const HIT: i16 = 20;
const MISS: i16 = -12;
/// Largest evidence of a cell, in the map's steps.
const EVIDENCE_MAX: i16 = 100;
/// Distance within which a hit belongs to another robot, metres: such hits are not drawn.
const ROBOT_HIT_M: f64 = 0.25;
/// Smallest distance between robots that start together, metres, and their clearance.
const NEAR_START_M: f64 = 0.6;
const NEAR_CLEARANCE_M: f64 = 0.3;
/// Radius of a robot's body, metres: for the distance between robots.
const BODY_M: f64 = 0.105;

/// Where the robots start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Starts {
    /// All in one place.
    Near,
    /// As far apart as the room allows.
    Far,
}

/// One robot.
pub struct Robot {
    pub id: RobotId,
    simulator: Simulator,
    pub truth: GroundTruth,
    pub scan: Box<Scan>,
    pub has_scan: bool,
    /// Contacts with anything in the last step.
    pub new_contacts: u64,
    pub travelled_m: f64,
    pub trail: Vec<[f64; 2]>,
}

/// Fleet, room and map.
pub struct World {
    pub robots: Vec<Robot>,
    pub map: Grid,
    /// Cells that a robot's body can cover.
    pub reachable: Vec<bool>,
    pub plan: Grid,
    /// Robots that have seen each cell, as bits.
    seen_by: Vec<u16>,
    pub now: Stamp,
    /// Smallest distance between two robots' bodies so far, metres.
    pub separation_m: f64,
}

impl World {
    /// Places a fleet in a room.
    pub fn new(room: &Room, robots: usize, starts: Starts, seed: u64) -> Result<Self, String> {
        let plan = room.floor_plan(RESOLUTION_M);
        let (map, routes) = passable(&plan, room)?;
        let reachable = covered_cells(&plan, &map, &routes);
        let poses = match starts {
            Starts::Far => room.starts(robots).map_err(|why| why.to_string())?,
            Starts::Near => near_starts(&map, &routes, robots, seed),
        };
        let config = SimConfig::default();
        let mut fleet = Vec::new();
        for (id, pose) in RobotId::first(robots).zip(poses) {
            let simulator = Simulator::new(room, &config, id, pose, seed).map_err(|why| why.to_string())?;
            let truth = GroundTruth { world_from_base: pose, ..GroundTruth::default() };
            let (scan, trail) = (Box::new(Scan::zeroed()), vec![[pose.x_m, pose.y_m]]);
            fleet.push(Robot {
                id,
                simulator,
                truth,
                scan,
                has_scan: false,
                new_contacts: 0,
                travelled_m: 0.0,
                trail,
            });
        }
        let cells = vec![UNKNOWN; plan.cells.len()];
        let map = Grid { header: plan.header, cells };
        let seen_by = vec![0; plan.cells.len()];
        Ok(Self { robots: fleet, map, reachable, plan, seen_by, now: Stamp(0), separation_m: f64::INFINITY })
    }

    /// The map as planners see it.
    pub fn map_view(&self) -> MapView<'_> {
        view(&self.map)
    }

    /// Drives one control step of 50 ms.
    pub fn step(&mut self, twists: &[Twist]) {
        for (robot, twist) in self.robots.iter_mut().zip(twists) {
            let Twist { linear_m_s, angular_rad_s } = *twist;
            robot.simulator.set_velocity_command(&VelocityCommand {
                linear_m_s,
                angular_rad_s,
                ..VelocityCommand::default()
            });
        }
        let truths: Vec<(RobotId, GroundTruth)> = self.robots.iter().map(|r| (r.id, r.truth)).collect();
        self.robots.iter_mut().for_each(|robot| robot.new_contacts = 0);
        for tick in 0..CONTROL_TICKS {
            for robot in &mut self.robots {
                if tick == 0 {
                    let peers = truths.iter().filter(|(id, _)| *id != robot.id);
                    peers.for_each(|(id, truth)| robot.simulator.update_peer(*id, truth));
                }
                let step = robot.simulator.step();
                let from = robot.truth.world_from_base;
                robot.travelled_m += from.distance_m(step.truth.world_from_base);
                robot.new_contacts += step.truth.contacts - robot.truth.contacts;
                robot.truth = step.truth;
                self.now = step.stamp;
                if step.scan_due {
                    robot.simulator.scan_into(&mut robot.scan);
                    robot.has_scan = true;
                    let pose = robot.truth.world_from_base;
                    let bit = 1 << robot.id.index();
                    draw_scan(&mut self.map, &mut self.seen_by, bit, pose, &robot.scan, &truths, robot.id);
                }
            }
        }
        self.measure_separation();
        for robot in &mut self.robots {
            let Pose2 { x_m, y_m, .. } = robot.truth.world_from_base;
            let last = robot.trail[robot.trail.len() - 1];
            if (last[0] - x_m).hypot(last[1] - y_m) > 0.1 {
                robot.trail.push([x_m, y_m]);
            }
        }
    }

    /// Share of the reachable floor that is known.
    pub fn coverage(&self) -> f64 {
        let total = self.reachable.iter().filter(|reachable| **reachable).count();
        let cells = self.reachable.iter().zip(&self.map.cells);
        let known = cells.filter(|(reachable, cell)| **reachable && occupancy(**cell) != Occupancy::Unknown);
        known.count() as f64 / total.max(1) as f64
    }

    /// Sum of what each robot has seen of the reachable floor, less what all have seen together, as a share of it.
    pub fn overlap(&self) -> f64 {
        let cells = || self.reachable.iter().zip(&self.seen_by).filter(|(reachable, _)| **reachable);
        let seen: u32 = cells().map(|(_, robots)| robots.count_ones()).sum();
        let once = cells().filter(|(_, robots)| **robots != 0).count();
        (f64::from(seen) - once as f64) / cells().count().max(1) as f64
    }

    fn measure_separation(&mut self) {
        for (i, a) in self.robots.iter().enumerate() {
            for b in &self.robots[i + 1..] {
                let apart_m = a.truth.world_from_base.distance_m(b.truth.world_from_base) - 2.0 * BODY_M;
                self.separation_m = self.separation_m.min(apart_m);
            }
        }
    }
}

impl Robot {
    /// The newest scan.
    pub fn scan_view(&self) -> Option<ScanView<'_>> {
        self.has_scan.then(|| ScanView::from_burger_scan(&self.scan))
    }

    pub fn pose(&self) -> Pose2 {
        self.truth.world_from_base
    }
}

/// A grid as planners see it.
pub fn view(grid: &Grid) -> MapView<'_> {
    let view = GridView::new(&grid.header, &grid.cells).expect("a grid has as many cells as its header says");
    MapView::from_log_odds(view).expect("a grid of a room is valid")
}

/// Routes of a robot in the true plan, from the first start of the room.
fn passable(plan: &Grid, room: &Room) -> Result<(ClearanceMap, RouteSearch), String> {
    let start = room.starts(1).map_err(|why| why.to_string())?[0];
    let start_m = [start.x_m, start.y_m];
    let (body, mut map, mut routes) = (RobotBody::default(), ClearanceMap::default(), RouteSearch::default());
    let centre_m = plan.view().centre_m(i64::from(plan.header.width) / 2, i64::from(plan.header.height) / 2);
    map.copy_window(&view(plan), centre_m);
    map.compute_clearance();
    let clearance_m = body.clearance_min_m(RESOLUTION_M);
    if !routes.search_from(&map, start_m, clearance_m) {
        return Err("no robot can start in the true plan".to_owned());
    }
    Ok((map, routes))
}

/// Cells of the plan within a robot's clearance of a place that it can drive to.
fn covered_cells(plan: &Grid, map: &ClearanceMap, routes: &RouteSearch) -> Vec<bool> {
    let body = RobotBody::default();
    let reach = ((body.radius_m + body.margin_m) / RESOLUTION_M).floor() as i64;
    let mut covered = vec![false; plan.cells.len()];
    let (width, height) = (i64::from(plan.header.width), i64::from(plan.header.height));
    for cell in routes.reached_cells().iter().filter(|cell| routes.is_passable(map, **cell)) {
        let (x, y) = plan.view().cell_of(map.cell_centre_m(*cell));
        for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
            let (u, v) = (x + dx, y + dy);
            if dx * dx + dy * dy <= reach * reach && (0..width).contains(&u) && (0..height).contains(&v) {
                covered[(v * width + u) as usize] = true;
            }
        }
    }
    covered
}

/// Starts around one random place, each facing away from it.
fn near_starts(map: &ClearanceMap, routes: &RouteSearch, robots: usize, seed: u64) -> Vec<Pose2> {
    let mut random = nav::RandomNumbers::new(seed);
    let is_wide = |cell: &&usize| map.clearance_m(**cell) >= NEAR_CLEARANCE_M;
    let wide: Vec<usize> = routes.reached_cells().iter().filter(is_wide).copied().collect();
    loop {
        let centre_m = map.cell_centre_m(wide[random.index_below(wide.len())]);
        let mut by_distance: Vec<(f64, [f64; 2])> = wide
            .iter()
            .map(|cell| map.cell_centre_m(*cell))
            .map(|at| ((at[0] - centre_m[0]).hypot(at[1] - centre_m[1]), at))
            .filter(|(distance_m, _)| *distance_m < 4.0)
            .collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut chosen: Vec<[f64; 2]> = Vec::new();
        for (_, at) in by_distance {
            let is_apart = |other: &[f64; 2]| (at[0] - other[0]).hypot(at[1] - other[1]) >= NEAR_START_M;
            if chosen.len() < robots && chosen.iter().all(is_apart) {
                chosen.push(at);
            }
        }
        if chosen.len() == robots {
            let yaw = |at: &[f64; 2]| (at[1] - centre_m[1]).atan2(at[0] - centre_m[0]);
            return chosen.iter().map(|at| Pose2::new(at[0], at[1], yaw(at))).collect();
        }
    }
}

/// Draws a scan into the map: misses along the beams, hits at their ends.
fn draw_scan(
    map: &mut Grid,
    seen_by: &mut [u16],
    bit: u16,
    pose: Pose2,
    scan: &Scan,
    truths: &[(RobotId, GroundTruth)],
    own: RobotId,
) {
    let others: Vec<[f64; 2]> = truths
        .iter()
        .filter(|(id, _)| *id != own)
        .map(|(_, truth)| [truth.world_from_base.x_m, truth.world_from_base.y_m])
        .collect();
    let map_from_scan = pose * BURGER_BASE_FROM_SCAN;
    let from = [map_from_scan.x_m, map_from_scan.y_m];
    let mut hits = Vec::new();
    for beam in ScanView::from_burger_scan(scan).beams() {
        let (sin, cos) = beam.angle_rad.sin_cos();
        let end = map_from_scan.apply([cos * beam.range_m, sin * beam.range_m]);
        let is_robot = others.iter().any(|o| (o[0] - end[0]).hypot(o[1] - end[1]) < ROBOT_HIT_M);
        let shorter_m = if is_robot { ROBOT_HIT_M } else { RESOLUTION_M / 2.0 };
        let range_m = (beam.range_m - shorter_m).max(0.0);
        mark_ray(map, seen_by, bit, from, map_from_scan.apply([cos * range_m, sin * range_m]));
        if beam.is_hit && !is_robot {
            hits.push(end);
        }
    }
    for hit in hits {
        if let Some(cell) = cell_of(map, hit) {
            add(&mut map.cells[cell], HIT);
            seen_by[cell] |= bit;
        }
    }
}

fn mark_ray(map: &mut Grid, seen_by: &mut [u16], bit: u16, from: [f64; 2], to: [f64; 2]) {
    let length_m = (to[0] - from[0]).hypot(to[1] - from[1]);
    let steps = (length_m / (RESOLUTION_M / 2.0)).ceil().max(1.0) as usize;
    let mut last = None;
    for i in 0..=steps {
        let t = i as f64 / steps as f64;
        let cell = cell_of(map, [from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])]);
        if cell != last {
            if let Some(cell) = cell {
                add(&mut map.cells[cell], MISS);
                seen_by[cell] |= bit;
            }
            last = cell;
        }
    }
}

fn cell_of(map: &Grid, point_m: [f64; 2]) -> Option<usize> {
    // The plan of a room is not turned.
    let header = &map.header;
    let in_cells = |v: f64| (v / header.resolution_m).floor() as i64;
    let (x, y) = (in_cells(point_m[0] - header.origin.x_m), in_cells(point_m[1] - header.origin.y_m));
    let (width, height) = (i64::from(map.header.width), i64::from(map.header.height));
    ((0..width).contains(&x) && (0..height).contains(&y)).then_some((y * width + x) as usize)
}

fn add(cell: &mut i8, evidence: i16) {
    let old = if *cell == UNKNOWN { 0 } else { i16::from(*cell) };
    *cell = (old + evidence).clamp(-EVIDENCE_MAX, EVIDENCE_MAX.min(i16::from(LOG_ODDS_MAX))) as i8;
}
