//! Kills SLAM processes of a running fleet at random moments and counts the map cells that are lost.
//!
//! A cell is lost if it was known half a second before the kill and neither it nor a neighbour is known in the map of the
//! process that takes the dead one's place: a solution of the pose graph may move a wall by a cell.
//!
//! `cargo bench --bench kills [-- --kills 100 --robots 8 --seed 1 --check --json FILE]`

#[allow(dead_code, reason = "shared with the chaos bench, which uses all of it")]
#[path = "shared/fleet.rs"]
mod fleet;
mod launcher;
#[path = "shared/map_cells.rs"]
mod map_cells;
#[path = "shared/words.rs"]
mod words;

use fleet::{Fleet, send};
use map_cells::{Cells, count_lost};
use msg::RobotId;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rustix::process::Signal;
use serde::Serialize;
use std::error::Error;
use std::time::{Duration, Instant};
use words::Words;

/// Age of the newest cells that a kill may take.
const LOST_MAX: Duration = Duration::from_millis(500);
/// Longest random wait before a kill.
const PAUSE_MAX: Duration = Duration::from_secs(2);
/// Time for which a process is left alone after its death: a life of 10 s lets the supervisor forget earlier deaths.
const LIFE: Duration = Duration::from_secs(12);
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

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().collect();
    let words = Words::parse(&words[1..], &["--kills", "--robots", "--seed"], &["--check"])?;
    let (kills, robots) = (words.number("--kills", 100_u64)?, words.number("--robots", 8_usize)?.max(1));
    let mut random = SplitMix64::seed_from_u64(words.number("--seed", 1)?);
    let fleet = Fleet::start("demo", robots, &[])?;
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
        let pid = fleet.wait_for_other(&format!("slam of {robot}"), None)?;
        let before = fleet.cells(Some(robot), |cells| !cells.is_empty())?;
        std::thread::sleep(LOST_MAX);
        let row = kill(&fleet, robot, pid, &before, begun)?;
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
    words.write_json(&rows)?;
    drop(fleet);
    if words.has("--check") && worst > 0 { Err(format!("a kill lost {worst} cells").into()) } else { Ok(()) }
}

/// Kills a process and waits for the map of the next one.
fn kill(
    fleet: &Fleet,
    robot: RobotId,
    pid: u32,
    before: &Cells,
    begun: Instant,
) -> Result<Kill, Box<dyn Error>> {
    let at_s = begun.elapsed().as_secs_f64();
    let killed = Instant::now();
    send(pid, Signal::KILL);
    fleet.wait_for_other(&format!("slam of {robot}"), Some(pid))?;
    let after = fleet.cells(Some(robot), |after| count_lost(before, after) == 0)?;
    Ok(Kill {
        robot: robot.to_string(),
        at_s,
        known: before.len(),
        lost: count_lost(before, &after),
        back_after_s: killed.elapsed().as_secs_f64(),
    })
}
