//! Many robots behind a router, two of which come late: outages of a robot, of the base and of the router, and another base.

use crate::Options;
use crate::fleets::{Cells, Fleet, LIMIT, known_cells, until};
use crate::machines::{PATIENCE, PROGRAM, STANDING, Site, Usage, f1, map_name, time_to_catch_up};
use crate::network::{Link, Network, Side};
use merge::Merger;
use mr_slam::config::FleetConfig;
use mr_slam::control::{self, Request};
use msg::{Pose2, RobotId};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Robots that are out of reach at first.
const LATE: usize = 2;
/// Longest time until the merged map shows what the robots' maps do: it is drawn anew at most twice a second.
const MERGED: Duration = Duration::from_secs(30);

/// Robots with their base.
struct Machines<'a> {
    site: &'a Site,
    base: Fleet,
    robots: Vec<Fleet>,
}

impl Machines<'_> {
    fn catch_up(&mut self, what: &str) -> f64 {
        time_to_catch_up(what, &mut self.base, self.robots.iter_mut().enumerate())
    }

    fn request(&self, request: Request) {
        for robot in &self.robots {
            control::ask(&robot.run, request, PATIENCE).expect("an answer");
        }
    }

    /// Lets the robots explore for this time without what `cut` has cut, and stand at its end.
    fn explore(&self, time: Duration) {
        self.request(Request::Release);
        // The stop has ended the exploration.
        self.robots.iter().for_each(explore_again);
        std::thread::sleep(time);
        self.request(Request::Stop);
        std::thread::sleep(STANDING);
    }

    /// Cuts links for a time in which the robots explore, and prints how long the base needs when they are back.
    fn outage(&mut self, what: &str, side: Side, time: Duration) {
        self.site.network.set_up(side, false);
        self.explore(time);
        let missing = self.missing();
        self.site.network.set_up(side, true);
        print_outage(what, missing, self.catch_up(what));
    }

    /// Returns the number of cells in which the base's maps differ from the robots' own.
    fn missing(&mut self) -> usize {
        let mut missing = 0;
        for (index, robot) in self.robots.iter_mut().enumerate() {
            let (own, theirs) = (robot.cells(&map_name(0)), self.base.cells(&map_name(index)));
            missing += own.iter().filter(|(at, cell)| theirs.get(at) != Some(cell)).count();
        }
        missing
    }

    /// Returns the F1 of the merged map against what one machine merges of the robots' own maps, with the same transforms.
    fn f1(&mut self) -> f64 {
        let mut best: f64 = 0.0;
        let begun = Instant::now();
        while best < 0.999 && begun.elapsed() < MERGED {
            let transforms = self.base.observer().map_transforms().copied();
            let merged = self.base.cells("merged_map");
            if let Some(transforms) = transforms {
                let starts: Vec<Option<Pose2>> =
                    transforms.robots[..self.robots.len()].iter().map(|robot| robot.known_pose()).collect();
                best = best.max(f1(&merged, &self.merge(&starts)));
            }
            std::thread::sleep(STANDING / 10);
        }
        best
    }

    fn merge(&mut self, starts: &[Option<Pose2>]) -> Cells {
        let mut merger = Merger::new(&self.base.run.config.merge, starts);
        for (robot, fleet) in RobotId::first(starts.len()).zip(&mut self.robots) {
            fleet.observer().show_maps(|name, map| {
                if name == map_name(0) {
                    merger.update_map(robot, map).expect("a map");
                }
            });
        }
        merger.update_stale_tiles();
        known_cells(merger.merged())
    }

    /// Waits until the base knows where all robots' maps lie, and returns how long it took, seconds.
    fn time_to_merge(&mut self) -> Option<f64> {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            let known = |transforms: &msg::MapTransforms| {
                transforms.robots[..self.robots.len()].iter().all(|robot| robot.known_pose().is_some())
            };
            if self.base.observer().map_transforms().is_some_and(known) {
                return Some(begun.elapsed().as_secs_f64());
            }
            std::thread::sleep(STANDING / 10);
        }
        None
    }
}

/// Measures and prints a fleet on links of this rate and loss.
pub fn measure(link: Link, options: &Options) {
    let names: Vec<String> = (1..=options.robots).map(|number| format!("robot{number}")).collect();
    let starts = starts(options.robots);
    let network = Network::open(link, options.robots, true).expect("it was permitted before");
    let site = Site::new(network, names, true, &options.protocol);
    let late: Vec<usize> = (options.robots - LATE.min(options.robots - 1)..options.robots).collect();
    late.iter().for_each(|index| site.network.set_up(Side::Robot(*index), false));

    let router = site.start_router();
    let base_config =
        if options.are_starts_known { config(&starts) } else { "[fleet]\nstarts_known = false\n".into() };
    let base_file = write(&site, "base", &base_config);
    let base = site.start_base("first_base", &["--config", &base_file]);
    let robots = (0..options.robots).map(|index| {
        let file = write(&site, &site.names[index], &config(&starts[index..=index]));
        site.start_robot(index, &["--config", &file])
    });
    let mut machines = Machines { site: &site, base, robots: robots.collect() };
    for index in 0..late[0] {
        let has_map = || (machines.base.cells(&map_name(index)).len() > 100).then_some(());
        until("the base has a map", LIMIT, has_map);
    }
    println!(
        "{} robots behind a router, {} of them late; {} Mbit/s, loss {} %; outages of {:.0} s; starts known: {}",
        options.robots,
        late.len(),
        link.mbit_s,
        link.loss_percent,
        options.outage.as_secs_f64(),
        options.are_starts_known
    );

    let usage = usage(&machines, late[0], options.seconds);
    println!(
        "sent by a robot, kB/s: {:.2} ({}); on the wire {:.2}",
        usage.bytes() / 1e3,
        usage.kinds(),
        usage.wire_bytes / 1e3
    );
    println!(
        "a robot's processes without its simulator: {:.1} % of a core, {:.0} MB",
        usage.cpu_s * 1e2,
        usage.memory / 1e6
    );
    assert!(
        late.iter().all(|index| machines.base.cells(&map_name(*index)).is_empty()),
        "they were out of reach"
    );
    late.iter().for_each(|index| site.network.set_up(Side::Robot(*index), true));
    machines.explore(Duration::from_secs(1));
    println!("caught up after two robots came late, s: {:.1}", machines.catch_up("the late robots' maps"));
    machines.outage("robot 1 was cut off", Side::Robot(0), options.outage);
    machines.outage("the base was cut off", Side::Base, options.outage);
    drop(router);
    machines.explore(options.outage);
    let missing = machines.missing();
    let _router = site.start_router();
    print_outage("the router was killed", missing, machines.catch_up("the router is back"));
    compare_and_replace_base(machines, &base_file);
}

/// Compares the merged map, and replaces the base by another one.
fn compare_and_replace_base(mut machines: Machines<'_>, base_file: &str) {
    match machines.time_to_merge() {
        Some(seconds) => println!("all maps merged; waited s: {seconds:.1}"),
        None => println!("not all maps are merged within {PATIENCE:?}"),
    }
    println!("F1 of the merged map against the robots' own maps merged on one machine: {:.4}", machines.f1());

    let Machines { site, base, robots } = machines;
    base.kill();
    let begun = Instant::now();
    let base = site.start_base("second_base", &["--config", base_file]);
    let mut machines = Machines { site, base, robots };
    machines.catch_up("another base has all maps");
    println!("another base, from its start: whole map after s: {:.1}", begun.elapsed().as_secs_f64());
}

/// Lets a robot explore again.
fn explore_again(robot: &Fleet) {
    let mut command = Command::new(PROGRAM);
    command.args(["explore", "--no-wait", "--run-dir"]).arg(&robot.run.dir).stdout(Stdio::null());
    let is_done = command.status().is_ok_and(|status| status.success());
    assert!(is_done, "{} does not explore", robot.run.dir.display());
}

fn print_outage(what: &str, missing: usize, seconds: f64) {
    println!("{what}: {missing} cells were missing; caught up after s: {seconds:.1}");
}

/// Returns the mean of what the robots before `count` use, per second.
fn usage(machines: &Machines<'_>, count: usize, seconds: f64) -> Usage {
    let read = || -> Vec<Usage> {
        let robots = machines.robots[..count].iter().enumerate();
        robots.map(|(index, robot)| Usage::read(machines.site, index, robot)).collect()
    };
    let (begun, before) = (Instant::now(), read());
    std::thread::sleep(Duration::from_secs_f64(seconds));
    let (after, seconds) = (read(), begun.elapsed().as_secs_f64());
    let each: Vec<Usage> =
        after.iter().zip(&before).map(|(after, before)| after.since(before, seconds)).collect();
    Usage::mean(&each)
}

/// Returns starts of this many robots in the default room.
fn starts(robots: usize) -> Vec<Pose2> {
    let mut config = FleetConfig::default();
    config.fleet.robots = robots;
    let room = mr_slam::world::room(&config).expect("the default room");
    mr_slam::world::starts(&config, &room).expect("places for all robots")
}

fn config(starts: &[Pose2]) -> String {
    let starts: Vec<String> =
        starts.iter().map(|pose| format!("[{:?}, {:?}, {:?}]", pose.x_m, pose.y_m, pose.yaw_rad)).collect();
    format!("[fleet]\nrobots = {}\nstarts = [{}]\n", starts.len(), starts.join(", "))
}

fn write(site: &Site, name: &str, text: &str) -> String {
    let path = site.folder.path().join(format!("{name}.toml"));
    std::fs::write(&path, text).expect("a file");
    path.display().to_string()
}
