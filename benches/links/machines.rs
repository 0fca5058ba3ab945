//! Machines with keys: a base, robots that explore, a router; and what they cost and send.

use crate::fleets::{Cells, Fleet, until};
use crate::network::{Network, Side};
use link_transport::keys::{KeyOwner, create_authority, create_key};
use mr_slam::process::link::LinkReport;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};

/// Cells with this probability of an obstacle, percent, or more are occupied.
const OCCUPIED: i8 = 65;
/// Longest time in which a base must have caught up, and a stop must be on the robot.
pub const PATIENCE: Duration = Duration::from_secs(120);
/// Time until the map of a robot that stands changes no more.
pub const STANDING: Duration = Duration::from_secs(3);
/// Ticks of the operating system's counters of processor time in one second.
const TICKS_S: f64 = 100.0;
/// The program that is measured.
pub const PROGRAM: &str = env!("CARGO_BIN_EXE_mr-slam");
const PORT: u16 = 7447;

/// Where machines run and keep their files.
pub struct Site {
    pub network: Network,
    pub folder: tempfile::TempDir,
    pub names: Vec<String>,
    has_router: bool,
    /// Protocol below Zenoh, `quic` or `tls`.
    protocol: String,
}

impl Site {
    /// Creates the keys of all machines.
    pub fn new(network: Network, names: Vec<String>, has_router: bool, protocol: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let keys = folder.path().join("keys");
        create_authority(&keys).expect("an authority");
        let robots = names.iter().map(|name| KeyOwner::Robot(name.clone()));
        for owner in [KeyOwner::Base, KeyOwner::Router].into_iter().chain(robots) {
            create_key(&keys, &owner).expect("a key");
        }
        Self { network, folder, names, has_router, protocol: protocol.into() }
    }

    fn key(&self, owner: &KeyOwner) -> String {
        owner.folder(&self.folder.path().join("keys")).display().to_string()
    }

    fn hub(&self, side: Side) -> String {
        format!("{}/{}:{PORT}", self.protocol, self.network.hub_address(side))
    }

    fn start(&self, side: Side, name: &str, endpoint: &str, args: &[&str]) -> Fleet {
        Fleet::start_command(self.network.command(side, PROGRAM), self.folder.path(), name, endpoint, args)
    }

    /// Starts a base whose run has this name.
    pub fn start_base(&self, name: &str, more: &[&str]) -> Fleet {
        let (names, key) = (self.names.join(","), self.key(&KeyOwner::Base));
        let (option, endpoint) = match self.has_router {
            true => ("--router", self.hub(Side::Base)),
            false => ("--listen", format!("{}/0.0.0.0:{PORT}", self.protocol)),
        };
        let args = ["base", "--names", &names, option, &endpoint, "--keys", &key];
        self.start(Side::Base, name, &endpoint, &[&args, more].concat())
    }

    /// Starts the robot of this index, which explores.
    pub fn start_robot(&self, index: usize, more: &[&str]) -> Fleet {
        let name = self.names[index].as_str();
        let (side, key) = (Side::Robot(index), self.key(&KeyOwner::Robot(name.into())));
        let endpoint = self.hub(side);
        let args = ["robot", "--name", name, "--base", &endpoint, "--keys", &key, "--explore"];
        self.start(side, name, &endpoint, &[&args, more].concat())
    }

    /// Starts the router.
    pub fn start_router(&self) -> RouterProcess {
        let mut command = self.network.command(Side::Router, PROGRAM);
        command.args([
            "router",
            "--names",
            &self.names.join(","),
            "--listen",
            &format!("{}/0.0.0.0:{PORT}", self.protocol),
        ]);
        command.args(["--keys", &self.key(&KeyOwner::Router)]);
        RouterProcess(command.spawn().expect("a router"))
    }
}

/// A router, which is killed when it is dropped.
pub struct RouterProcess(Child);

impl Drop for RouterProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns the name of the robot's map at a base.
pub fn map_name(index: usize) -> String {
    format!("robot{}_map", index + 1)
}

/// Returns whether the base has a robot's map cell by cell.
pub fn has_map(base: &mut Fleet, index: usize, robot: &mut Fleet) -> bool {
    let own = robot.cells("robot1_map");
    own.len() > 100 && base.cells(&map_name(index)) == own
}

/// Returns how long it takes from now until the base has the maps of all of these robots, seconds.
pub fn time_to_catch_up<'a>(
    what: &str,
    base: &mut Fleet,
    robots: impl IntoIterator<Item = (usize, &'a mut Fleet)>,
) -> f64 {
    let begun = Instant::now();
    for (index, robot) in robots {
        until(what, PATIENCE, || has_map(base, index, robot).then_some(()));
    }
    begun.elapsed().as_secs_f64()
}

/// Bytes that a robot has sent by kind, and on the wire, and processor time and memory of its processes.
#[derive(Clone, Debug, Default)]
pub struct Usage {
    pub kinds: BTreeMap<String, f64>,
    pub wire_bytes: f64,
    pub cpu_s: f64,
    /// Memory, bytes: each process's own, and its part of what it shares.
    pub memory: f64,
}

impl Usage {
    /// Reads the counters of a robot. Its simulator does not count.
    pub fn read(site: &Site, index: usize, robot: &Fleet) -> Self {
        let report = LinkReport::read(&robot.run.dir).unwrap_or_default();
        let kinds = report.peers.into_iter().flat_map(|peer| peer.bytes);
        let mut usage = Self {
            kinds: kinds.map(|(name, bytes)| (name, bytes as f64)).collect(),
            wire_bytes: site.network.sent_bytes(Side::Robot(index)) as f64,
            ..Self::default()
        };
        for pid in robot.processes() {
            let proc = Path::new("/proc").join(pid.as_raw_nonzero().to_string());
            let read = |name: &str| std::fs::read_to_string(proc.join(name)).unwrap_or_default();
            if read("cmdline").contains("worker\0sim\0") {
                continue;
            }
            // After the name in brackets: state is field 3, user time 14, system time 15.
            let stat = read("stat");
            let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
            let ticks =
                |field: usize| fields.get(field - 3).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
            usage.cpu_s += (ticks(14) + ticks(15)) / TICKS_S;
            let rollup = read("smaps_rollup");
            let pss = rollup.lines().find_map(|line| line.strip_prefix("Pss:")?.split_whitespace().next());
            usage.memory += pss.and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(0.0) * 1024.0;
        }
        usage
    }

    /// Returns the rates since `before`, per second; memory stays what it is.
    pub fn since(&self, before: &Self, seconds: f64) -> Self {
        let kind = |(name, bytes): (&String, &f64)| {
            (name.clone(), (bytes - before.kinds.get(name).unwrap_or(&0.0)) / seconds)
        };
        Self {
            kinds: self.kinds.iter().map(kind).collect(),
            wire_bytes: (self.wire_bytes - before.wire_bytes) / seconds,
            cpu_s: (self.cpu_s - before.cpu_s) / seconds,
            memory: self.memory,
        }
    }

    /// Returns the mean of several robots'.
    pub fn mean(all: &[Self]) -> Self {
        let mut mean = Self::default();
        let count = all.len() as f64;
        for usage in all {
            usage.kinds.iter().for_each(|(name, bytes)| {
                *mean.kinds.entry(name.clone()).or_default() += bytes / count;
            });
            mean.wire_bytes += usage.wire_bytes / count;
            mean.cpu_s += usage.cpu_s / count;
            mean.memory += usage.memory / count;
        }
        mean
    }

    /// Returns the bytes of all messages.
    pub fn bytes(&self) -> f64 {
        self.kinds.values().sum()
    }

    /// Formats the bytes by kind, kB.
    pub fn kinds(&self) -> String {
        let kinds: Vec<String> =
            self.kinds.iter().map(|(name, bytes)| format!("{name} {:.2}", bytes / 1e3)).collect();
        kinds.join(", ")
    }
}

/// Returns the F1 of the occupied cells of one map against another's, cell by cell.
pub fn f1(map: &Cells, reference: &Cells) -> f64 {
    let is_occupied = |cells: &Cells, at: &(i64, i64)| cells.get(at).is_some_and(|cell| *cell >= OCCUPIED);
    let count = |cells: &Cells| cells.keys().filter(|at| is_occupied(cells, at)).count() as f64;
    let both = map.keys().filter(|at| is_occupied(map, at) && is_occupied(reference, at)).count() as f64;
    2.0 * both / (count(map) + count(reference)).max(1.0)
}
