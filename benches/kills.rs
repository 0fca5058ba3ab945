//! Kills SLAM processes of a running fleet at random moments and counts the map cells that are lost.
//!
//! A cell is lost if it was known half a second before the kill and neither it nor a neighbour is known in the map of the
//! process that takes the dead one's place: a solution of the pose graph may move a wall by a cell.
//!
//! `cargo bench --bench kills [-- --kills 100 --robots 8 --seed 1 --check --json FILE]`

use mr_slam::channel::{self, Opener};
use mr_slam::observer::Observer;
use mr_slam::ports::ReadMapPort;
use mr_slam::run::Run;
use mr_slam::shared_memory::Participant;
use msg::{DenseMap, RobotId};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use reports::FleetView;
use rustix::process::{Pid, Signal, kill_process};
use serde::Serialize;
use std::collections::BTreeSet;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Age of the newest cells that a kill may take.
const LOST_MAX: Duration = Duration::from_millis(500);
/// Longest random wait before a kill.
const PAUSE_MAX: Duration = Duration::from_secs(2);
/// Time for which a process is left alone after its death: a life of 10 s lets the supervisor forget earlier deaths.
const LIFE: Duration = Duration::from_secs(12);
/// Longest wait for a fleet, for a killed process, and for its map.
const PATIENCE: Duration = Duration::from_secs(20);
/// Time between two looks at a map.
const LOOK_PERIOD: Duration = Duration::from_millis(50);

/// Cells in whole cells from the origin of a map's frame.
type Cells = BTreeSet<(i64, i64)>;

/// Outcome of one kill.
#[derive(Serialize)]
struct Kill {
    robot: String,
    /// Time since the fleet's start, seconds.
    at_s: f64,
    /// Cells known half a second before the kill.
    known: usize,
    /// Those of them that the new process has not.
    lost: usize,
    /// Time from the kill until the new process had the others, seconds.
    back_after_s: f64,
}

/// A fleet with an operator, which ends with the bench.
struct Fleet {
    launcher: Child,
    dir: PathBuf,
    run: Run,
    observer: Observer,
}

impl Fleet {
    fn start(robots: usize) -> Result<Self, Box<dyn Error>> {
        let dir = std::env::temp_dir().join(format!("mr-slam-kills-{}", std::process::id()));
        let mut launcher = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
            .args(["demo", "--port", "0", "--robots", &robots.to_string(), "--run-dir"])
            .arg(&dir)
            .env("XDG_STATE_HOME", dir.join("state"))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        let begun = Instant::now();
        loop {
            if let Ok(run) = Run::open(&dir)
                && let Ok(observer) = Observer::attach(&run, "kills")
            {
                return Ok(Self { launcher, dir, run, observer });
            }
            if begun.elapsed() > PATIENCE {
                launcher.kill()?;
                launcher.wait()?;
                return Err("the fleet did not start".into());
            }
            std::thread::sleep(LOOK_PERIOD);
        }
    }

    /// Returns the id of a robot's SLAM process by the newest figures.
    fn pid(&mut self, robot: RobotId) -> Option<u32> {
        self.observer.wait(Duration::from_secs(2));
        let view = FleetView::new(self.observer.stats()?);
        let name = format!("slam of {robot}");
        view.processes.iter().find(|process| process.process == name).map(|process| process.pid)
    }

    /// Waits until a robot's SLAM process is another than `before`.
    fn new_pid(&mut self, robot: RobotId, before: Option<u32>) -> Result<u32, Box<dyn Error>> {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            if let Some(pid) = self.pid(robot).filter(|pid| Some(*pid) != before) {
                return Ok(pid);
            }
        }
        Err(format!("no SLAM process of {robot} within {PATIENCE:?}").into())
    }

    /// Reads a robot's map from the process that runs now, until `is_enough`.
    fn cells(&self, robot: RobotId, is_enough: impl Fn(&Cells) -> bool) -> Result<Cells, Box<dyn Error>> {
        let opener = Opener::of_fleet(channel::Program::Launcher);
        let participant = Participant::open(&self.run.domain, opener, "kills-map")?;
        let mut reader = participant.map_reader(&channel::map(robot))?;
        let begun = Instant::now();
        loop {
            reader.poll();
            let mut map = DenseMap::default();
            let cells = match reader.map().tiles().next() {
                Some(_) => known_cells(&map.update(reader.map())),
                None => Cells::new(),
            };
            if is_enough(&cells) || begun.elapsed() > PATIENCE {
                return Ok(cells);
            }
            std::thread::sleep(LOOK_PERIOD);
        }
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        if let Some(pid) = Pid::from_raw(self.launcher.id() as i32) {
            let _ = kill_process(pid, Signal::TERM);
        }
        let _ = self.launcher.wait();
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

fn known_cells(map: &msg::GridView<'_>) -> Cells {
    let cell = |metres: f64| (metres / map.header.resolution_m).round() as i64;
    let (x0, y0) = (cell(map.header.origin.x_m), cell(map.header.origin.y_m));
    let width = map.header.width as usize;
    let known = map.cells.iter().enumerate().filter(|(_, cell)| **cell != 0);
    known.map(|(k, _)| (x0 + (k % width) as i64, y0 + (k / width) as i64)).collect()
}

/// Cells of `before` that have no known cell in or around their place in `after`.
fn count_lost(before: &Cells, after: &Cells) -> usize {
    let is_near = |(x, y): &(i64, i64)| (-1..=1).any(|i| (-1..=1).any(|j| after.contains(&(x + i, y + j))));
    before.iter().filter(|cell| !is_near(cell)).count()
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().collect();
    let value = |name: &str| words.iter().position(|word| word == name).and_then(|at| words.get(at + 1));
    let number = |name: &str, default: u64| value(name).map_or(Ok(default), |text| text.parse::<u64>());
    let (kills, robots) = (number("--kills", 100)?, number("--robots", 8)?.max(1) as usize);
    let mut random = SplitMix64::seed_from_u64(number("--seed", 1)?);
    let mut fleet = Fleet::start(robots)?;
    let begun = Instant::now();
    println!("{:>6} {:>8} {:>8} {:>8} {:>8} {:>8}", "kill", "robot", "at s", "known", "lost", "back s");
    let mut killed_at: Vec<Option<Instant>> = vec![None; robots];
    let mut rows = Vec::new();
    for number in 1..=kills {
        // Whoever was not killed for longest, so that nobody dies nine times in a row.
        let index = (0..robots).min_by_key(|index| killed_at[*index]).unwrap_or(0);
        let robot = RobotId::new(index + 1).ok_or("no such robot")?;
        if let Some(at) = killed_at[index] {
            std::thread::sleep(LIFE.saturating_sub(at.elapsed()));
        }
        std::thread::sleep(PAUSE_MAX.mul_f64(f64::from(random.next_u32()) / f64::from(u32::MAX)));
        let pid = fleet.new_pid(robot, None)?;
        let before = fleet.cells(robot, |cells| !cells.is_empty())?;
        std::thread::sleep(LOST_MAX);
        let row = kill(&mut fleet, robot, pid, &before, begun)?;
        killed_at[index] = Some(Instant::now());
        let Kill { at_s, known, lost, back_after_s, .. } = &row;
        println!("{number:>6} {:>8} {at_s:>8.1} {known:>8} {lost:>8} {back_after_s:>8.1}", row.robot);
        rows.push(row);
    }
    let worst = rows.iter().map(|row| row.lost).max().unwrap_or(0);
    println!(
        "{} kills, {} without a loss; worst {worst} cells",
        rows.len(),
        rows.iter().filter(|row| row.lost == 0).count()
    );
    if let Some(path) = value("--json") {
        std::fs::write(Path::new(path), serde_json::to_string_pretty(&rows)?)?;
    }
    drop(fleet);
    let is_checked = words.iter().any(|word| word == "--check");
    if is_checked && worst > 0 { Err(format!("a kill lost {worst} cells").into()) } else { Ok(()) }
}

/// Kills a process and waits for the map of the next one.
fn kill(
    fleet: &mut Fleet,
    robot: RobotId,
    pid: u32,
    before: &Cells,
    begun: Instant,
) -> Result<Kill, Box<dyn Error>> {
    let at_s = begun.elapsed().as_secs_f64();
    let killed = Instant::now();
    kill_process(Pid::from_raw(pid as i32).ok_or("no process")?, Signal::KILL)?;
    fleet.new_pid(robot, Some(pid))?;
    let after = fleet.cells(robot, |after| count_lost(before, after) == 0)?;
    Ok(Kill {
        robot: robot.to_string(),
        at_s,
        known: before.len(),
        lost: count_lost(before, &after),
        back_after_s: killed.elapsed().as_secs_f64(),
    })
}
