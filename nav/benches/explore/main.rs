//! Bench of coordinated exploration, in virtual time and repeatable: how long fleets need to see generated rooms.
//!
//! The robots, their LiDARs of 90 degrees and their contacts are the simulator's. Poses are exact, and the map is drawn from
//! the simulated scans with these poses: errors of SLAM and merging are left out, so that many runs are cheap. `navigated` is what a
//! fleet runs: the coordinator with `nav::FleetNavigator`. The others share one driver (`driver.rs`), `coordinated` is the coordinator with it.
//! The reachable floor is what a robot's body with its margin can cover.
//!
//! ```text
//! cargo bench -p nav --bench explore -- [--worlds office,flat] [--robots 1,3] [--seeds 1..3] [--starts near|far|both]
//!     [--methods navigated,burgard,greedy,tour,coordinated] [--limit SECONDS] [--until SHARE]
//!     [--out FOLDER] [--jobs N] [--set pocket_m2=3,switch_cost_s=8]
//! ```
//! `--set` changes parameters of the coordinator (`CoordinationConfig`). A run ends at the coverage `--until`, 0.9995 if it is not given; 0.991 leaves out what comes after `T99`.
//! No number was tuned on these worlds yet. When one is, keep seeds 11 and above apart. `--out` gets `explore.json`, curves of
//! coverage, and a picture of each run that did not see 99 %.

mod burgard;
mod driver;
mod methods;
mod picture;
mod report;
mod run;
mod world;

use methods::Kind;
use nav::CoordinationConfig;
use run::{Case, Outcome};
use sim::RoomKind;
use std::path::PathBuf;
use std::sync::Mutex;
use world::Starts;

/// What is run, from the command line.
struct Options {
    worlds: Vec<RoomKind>,
    robots: Vec<usize>,
    seeds: std::ops::RangeInclusive<u64>,
    starts: Vec<Starts>,
    methods: Vec<Kind>,
    limit_s: usize,
    until: f64,
    config: CoordinationConfig,
    out: Option<PathBuf>,
    draw_all: bool,
    jobs: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            worlds: RoomKind::ALL.to_vec(),
            robots: vec![3],
            seeds: 1..=3,
            starts: vec![Starts::Near],
            methods: vec![Kind::Navigated, Kind::Burgard, Kind::Greedy],
            limit_s: 4000,
            until: 0.9995,
            config: CoordinationConfig::default(),
            out: None,
            draw_all: false,
            jobs: 1,
        }
    }
}

fn main() {
    let options = match parse(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(why) => {
            eprintln!("explore: {why}");
            std::process::exit(2);
        }
    };
    let cases = cases(&options);
    let (next, done) = (Mutex::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..options.jobs.max(1) {
            scope.spawn(|| {
                loop {
                    let index = {
                        let mut next = next.lock().expect("no thread panics while it holds the lock");
                        *next += 1;
                        *next - 1
                    };
                    let Some(case) = cases.get(index) else { return };
                    let Some(outcome) = run_case(*case, &options) else { continue };
                    done.lock().expect("no thread panics while it holds the lock").push((index, outcome));
                }
            });
        }
    });
    let mut done = done.into_inner().expect("all threads have ended");
    done.sort_by_key(|(index, _)| *index);
    let outcomes: Vec<Outcome> = done.into_iter().map(|(_, outcome)| outcome).collect();
    report::print(&outcomes);
    if let Some(out) = &options.out {
        let json = report::json(&outcomes);
        let written = std::fs::create_dir_all(out)
            .and_then(|()| std::fs::write(out.join("explore.json"), json))
            .and_then(|()| picture::write_curves(&out.join("coverage.png"), &outcomes));
        if let Err(why) = written {
            eprintln!("explore: {}: {why}", out.display());
        }
    }
}

fn cases(options: &Options) -> Vec<Case> {
    let mut cases = Vec::new();
    for room in &options.worlds {
        for robots in &options.robots {
            for starts in &options.starts {
                for seed in options.seeds.clone() {
                    for method in &options.methods {
                        let (room, robots, starts, method) = (*room, *robots, *starts, *method);
                        let Options { limit_s, until: enough, config, .. } = *options;
                        cases.push(Case { room, seed, robots, starts, method, limit_s, enough, config });
                    }
                }
            }
        }
    }
    cases
}

fn run_case(case: Case, options: &Options) -> Option<Outcome> {
    match run::run(case) {
        Ok((outcome, world)) => {
            eprintln!("{}", report::line(&outcome));
            let is_failure = outcome.times_s[2].is_none() || !outcome.contacts.is_empty();
            if let Some(out) = options.out.as_ref().filter(|_| is_failure || options.draw_all) {
                let name = format!(
                    "{}-{}-{}-{:?}-{}.png",
                    case.room.name(),
                    case.seed,
                    case.robots,
                    case.starts,
                    case.method.name()
                );
                let written = std::fs::create_dir_all(out)
                    .and_then(|()| picture::write_run(&out.join(name.to_lowercase()), &world));
                if let Err(why) = written {
                    eprintln!("explore: {}: {why}", out.display());
                }
            }
            Some(outcome)
        }
        Err(why) => {
            eprintln!("explore: {case:?}: {why}");
            None
        }
    }
}

/// Sets a parameter of the coordinator, `NAME=VALUE`.
fn set(config: &mut CoordinationConfig, pair: &str) -> Result<(), String> {
    let (name, value) = pair.split_once('=').ok_or_else(|| format!("--set {pair}: expected NAME=VALUE"))?;
    let parameter = match name {
        "unknown_depth_m" => &mut config.unknown_depth_m,
        "sweep_share" => &mut config.sweep_share,
        "gain_min_m2" => &mut config.gain_min_m2,
        "gain_last_share" => &mut config.gain_last_share,
        "pocket_m2" => &mut config.pocket_m2,
        "makespan_weight_m2" => &mut config.makespan_weight_m2,
        "switch_cost_s" => &mut config.switch_cost_s,
        "replan_period_s" => &mut config.replan_period_s,
        _ => return Err(format!("--set {name}: no such parameter of CoordinationConfig")),
    };
    *parameter = value.parse().map_err(|why| format!("--set {name}={value}: {why}"))?;
    Ok(())
}

fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Options, String> {
    let mut options = Options::default();
    while let Some(argument) = arguments.next() {
        if argument == "--bench" {
            continue;
        }
        if argument == "--draw-all" {
            options.draw_all = true;
            continue;
        }
        let value = arguments.next().ok_or_else(|| format!("{argument} needs a value"))?;
        let number = |text: &str| text.parse::<u64>().map_err(|why| format!("{argument} {value}: {why}"));
        let mut names = value.split(',');
        match argument.as_str() {
            "--worlds" => {
                let kind = |name: &str| RoomKind::from_name(name).ok_or_else(|| format!("no world {name}"));
                options.worlds = names.map(kind).collect::<Result<_, _>>()?;
            }
            "--robots" => {
                options.robots = names.map(|n| number(n).map(|n| n as usize)).collect::<Result<_, _>>()?;
            }
            "--seeds" => {
                let (from, to) = value.split_once("..").unwrap_or((&value, &value));
                options.seeds = number(from)?..=number(to)?;
            }
            "--starts" => {
                options.starts = match value.as_str() {
                    "near" => vec![Starts::Near],
                    "far" => vec![Starts::Far],
                    "both" => vec![Starts::Near, Starts::Far],
                    _ => return Err(format!("--starts {value}: expected near, far or both")),
                };
            }
            "--methods" => {
                let kind = |name: &str| {
                    let kind = Kind::ALL.into_iter().find(|kind| kind.name() == name);
                    kind.ok_or_else(|| format!("no method {name}"))
                };
                options.methods = names.map(kind).collect::<Result<_, _>>()?;
            }
            "--limit" => options.limit_s = number(&value)? as usize,
            "--until" => options.until = value.parse().map_err(|why| format!("{argument} {value}: {why}"))?,
            "--set" => names.try_for_each(|pair| set(&mut options.config, pair))?,
            "--jobs" => options.jobs = number(&value)? as usize,
            "--out" => options.out = Some(PathBuf::from(&value)),
            _ => {
                return Err(format!(
                    "unknown option {argument}; see the header of nav/benches/explore/main.rs"
                ));
            }
        }
    }
    Ok(options)
}
