//! Generated logs with known truth: buildings, robots and accidents drawn from seeds.
//!
//! `--logs generated --seeds 0..400`. The seeds from [`HELD_BACK`] on are for reporting: nothing is tuned on them. A seed is
//! one building, one robot and one run; the same seed gives the same figures.

mod building;
mod picture;
mod robot;
mod run;
mod walls;
mod wrong_sensor;

use crate::seeds::{HELD_BACK, Seeds};
pub use robot::Event;
pub use run::Case;
use run::{METRE_SCALE_M, Outcome, median, run};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use wrong_sensor::WrongSensor;

/// Number of the worst runs that are named and drawn.
const WORST: usize = 10;

/// Runs all seeds on as many threads as there are cores; draws the worst maps if there is a folder for them.
pub fn run_all(
    Seeds { range: seeds, step }: Seeds,
    maps: Option<&Path>,
    draw: fn(u64) -> Case,
) -> Result<Vec<Outcome>, String> {
    let next = AtomicU64::new(seeds.start);
    let outcomes = Mutex::new(Vec::new());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(step, Ordering::Relaxed);
                    if seed >= seeds.end {
                        return;
                    }
                    let outcome = run(&draw(seed), None);
                    let mut outcomes = outcomes.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                    outcomes.push(outcome);
                    eprint!("\r{} of {}", outcomes.len(), (seeds.end - seeds.start).div_ceil(step));
                }
            });
        }
    });
    eprintln!();
    let outcomes = outcomes.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    let mut outcomes = outcomes.into_iter().collect::<Result<Vec<_>, _>>()?;
    outcomes.sort_by_key(|outcome| outcome.seed);
    for outcome in worst(&outcomes) {
        if let Some(folder) = maps {
            run(&draw(outcome.seed), Some(&folder.join(format!("generated-{}", outcome.seed))))?;
        }
    }
    Ok(outcomes)
}

fn worst(outcomes: &[Outcome]) -> Vec<&Outcome> {
    let mut worst: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.is_wrong()).collect();
    worst.sort_by(|a, b| b.max_error_unsaid_m.total_cmp(&a.max_error_unsaid_m));
    worst.truncate(WORST);
    worst
}

/// Prints the figures of the logs of this name by group, and the worst runs.
pub fn print(name: &str, outcomes: &[Outcome]) {
    if outcomes.is_empty() {
        return;
    }
    println!(
        "{:<28} {:>5} {:>5} {:>6} {:>6} {:>7} {:>6} {:>7} {:>6} {:>6} {:>5} {:>5} {:>8} {:>6} {:>8}",
        format!("{name} logs"),
        "runs",
        "wrong",
        "silent",
        "alarms",
        "mean m",
        "placed %",
        "walls %",
        "right",
        "wrong",
        "back",
        "wrong",
        "NEES",
        "links",
        "closures"
    );
    let row = |name: &str, of: &dyn Fn(&Outcome) -> bool| {
        let group: Vec<&Outcome> = outcomes.iter().filter(|outcome| of(outcome)).collect();
        if !group.is_empty() {
            println!("{}", Summary::new(&group).line(name));
        }
    };
    row("all", &|_| true);
    row("with odometry", &|outcome| outcome.odometry != "None");
    row("without odometry", &|outcome| outcome.odometry == "None");
    row("tuned on", &|outcome| outcome.seed < HELD_BACK);
    row("held back", &|outcome| outcome.seed >= HELD_BACK);
    for kind in building::Kind::ALL {
        row(kind.name(), &|outcome| outcome.building == kind.name());
    }
    for sensor in robot::SENSORS {
        row(sensor.name, &|outcome| outcome.sensor == sensor.name);
    }
    for odometry in robot::OdometryKind::ALL {
        let name = format!("{odometry:?}");
        row(&format!("odometry: {name}"), &|outcome| outcome.odometry == name);
    }
    for event in robot::Event::ALL {
        let name = format!("{event:?}");
        row(&format!("event: {name}"), &|outcome| outcome.event == name);
    }
    print_worst(outcomes);
}

/// Prints how many runs with wrong sensors say so.
pub fn print_wrong_sensors(outcomes: &[Outcome]) {
    println!(
        "{:<28} {:>5} {:>10} {:>10} {:>8}",
        "wrong sensors, with odometry", "runs", "say what", "unreliable", "neither"
    );
    for name in WrongSensor::names() {
        let group: Vec<&Outcome> =
            outcomes.iter().filter(|o| o.wrong_sensor == name && o.odometry != "None").collect();
        let count = |of: fn(&Outcome) -> bool| group.iter().filter(|outcome| of(outcome)).count();
        println!(
            "{name:<28} {:>5} {:>10} {:>10} {:>8}",
            group.len(),
            count(|o| o.says_wrong_sensor),
            count(|o| o.is_unreliable),
            count(|o| !o.says_wrong_sensor && !o.is_unreliable)
        );
    }
    for outcome in outcomes.iter().filter(|o| o.odometry != "None" && !o.says_wrong_sensor) {
        println!(
            "seed {}: {}, {}, {}, odometry {}: {:?}, placed {:.0} %",
            outcome.seed,
            outcome.wrong_sensor,
            outcome.building,
            outcome.sensor,
            outcome.odometry,
            outcome.evidence.odometry_agreement,
            100.0 * outcome.placed_share
        );
    }
}

fn print_worst(outcomes: &[Outcome]) {
    println!(
        "wrong: runs with a pose of the map more than {METRE_SCALE_M} m off (what SLAM says is not placed in its map does not count: \
         placed %); silent: those in which it is more than three standard deviations off by its covariance and SLAM does not call \
         its map unreliable. alarms: runs \
         without such a pose whose map is called unreliable. walls: share of the walls hit that the map has. Then active and retracted closures, \
         right and wrong ones. NEES over its degrees of freedom (1 is right) of the pose given out, links and closures: medians."
    );
    for outcome in worst(outcomes) {
        println!(
            "seed {}: {}, {}, odometry {}, {}, {}: {:.2} m off, {:.2} m in the map, {:.2} m and not said",
            outcome.seed,
            outcome.building,
            outcome.sensor,
            outcome.odometry,
            outcome.event,
            if outcome.thinned_m > 0.0 {
                format!("a scan each {:.1} m", outcome.thinned_m)
            } else {
                "10 Hz".into()
            },
            outcome.max_error_m,
            outcome.max_error_placed_m,
            outcome.max_error_unsaid_m,
        );
    }
}

/// Figures of a group of runs.
struct Summary {
    runs: usize,
    wrong: usize,
    silent: usize,
    false_alarms: usize,
    mean_m: f64,
    placed_percent: f64,
    walls_percent: f64,
    closures: [usize; 2],
    retracted: [usize; 2],
    nees: [Option<f64>; 3],
}

impl Summary {
    fn new(group: &[&Outcome]) -> Self {
        let mean = |of: fn(&Outcome) -> f64| group.iter().map(|o| of(o)).sum::<f64>() / group.len() as f64;
        let sum = |of: fn(&Outcome) -> [usize; 2]| {
            group.iter().map(|o| of(o)).fold([0; 2], |sum, two| [sum[0] + two[0], sum[1] + two[1]])
        };
        let nees = |of: fn(&Outcome) -> Option<f64>| median(group.iter().filter_map(|o| of(o)).collect());
        Self {
            runs: group.len(),
            wrong: group.iter().filter(|o| o.is_wrong()).count(),
            silent: group.iter().filter(|o| o.is_silent()).count(),
            false_alarms: group.iter().filter(|o| o.is_false_alarm()).count(),
            mean_m: mean(|o| o.mean_error_m),
            placed_percent: 100.0 * mean(|o| o.placed_share),
            walls_percent: 100.0 * mean(|o| o.walls_share),
            closures: sum(|o| o.closures),
            retracted: sum(|o| o.retracted),
            nees: [nees(|o| o.nees), nees(|o| o.edge_nees[0]), nees(|o| o.edge_nees[1])],
        }
    }

    fn line(&self, name: &str) -> String {
        let ([right, wrong], [right_back, wrong_back]) = (self.closures, self.retracted);
        let [pose, links, closures] =
            self.nees.map(|nees| nees.map_or("-".into(), |nees| format!("{nees:.2}")));
        format!(
            "{name:<28} {:>5} {:>5} {:>6} {:>6} {:>7.3} {:>6.1} {:>7.1} {right:>6} {wrong:>6} {right_back:>5} {wrong_back:>5} \
             {pose:>8} {links:>6} {closures:>8}",
            self.runs,
            self.wrong,
            self.silent,
            self.false_alarms,
            self.mean_m,
            self.placed_percent,
            self.walls_percent
        )
    }
}

/// Returns all outcomes as JSON.
pub fn json(outcomes: &[Outcome]) -> Value {
    json!(outcomes)
}
