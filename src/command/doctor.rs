//! Tool `mr-slam doctor`, which checks what this machine permits and names a remedy for the rest.

use super::output;
use super::up::ros_variables;
use crate::channel::shared_memory_need;
use crate::clock;
use crate::config::FleetConfig;
use crate::resources;
use crate::shared_memory::SHARED_MEMORY;
use crate::time_slice;
use bridge::dds::{Discovery, DiscoveryVariables};
use clap::builder::RangedU64ValueParser;
use msg::{Monotonic, ROBOTS_MAX};
use rustix::process::{Resource, getrlimit};
use serde::Serialize;
use std::fmt;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::path::Path;
use std::time::Duration;

/// Check what this machine permits: timers, limits, network
#[derive(Clone, Debug, clap::Args)]
pub struct DoctorArgs {
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// Number of robots of the fleet that is to run [default: 3]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=msg::ROBOTS_MAX as u64))]
    pub robots: Option<usize>,
    /// TCP port that should be free
    #[arg(long, value_name = "P", default_value_t = 10_000)]
    pub port: u16,
}

/// Smallest receive buffer of a stock ROS 2 reader with which a map of 16 MB arrives in time, bytes. Fast DDS takes
/// the system's default size, and repairs slowly what does not fit.
const RECEIVE_BUFFER_MIN: u64 = 4 << 20;
/// Buffer size that our own readers and writers ask for, bytes.
const BUFFER_MAX_MIN: u64 = 4 << 20;
/// Locked memory for every process of a fleet, bytes.
const LOCKED_MEMORY_MIN: u64 = 256 << 20;
/// Number of sleeps in the measurement of the wake-up delay: two beyond the 99th percentile.
const SLEEPS: usize = 200;
/// Duration of each sleep.
const SLEEP: Duration = Duration::from_millis(5);
/// Largest acceptable wake-up delay at P99, milliseconds: a larger one shows in the TF jitter.
const WAKE_P99_MAX_MS: f64 = 2.0;
/// Number of CAP_IPC_LOCK in linux/capability.h.
const CAP_IPC_LOCK: u32 = 14;
/// Number of CAP_SYS_NICE in linux/capability.h.
const CAP_SYS_NICE: u32 = 23;
/// Multicast group of DDS discovery (RTPS 9.6.1.4.1); the test stays on this machine.
const DISCOVERY_GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// Outcome of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Nothing has to be done.
    Ok,
    /// The fleet works less well than it could.
    Warning,
}

/// One check and its outcome.
#[derive(Clone, Debug, Serialize)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// Outcome of the check.
    pub state: State,
    /// Value that was found, with units.
    pub found: String,
    /// Command or setting that helps; empty if nothing has to be done.
    pub advice: String,
}

impl Check {
    fn new(name: &'static str, good: bool, found: String, advice: &str) -> Self {
        let state = if good { State::Ok } else { State::Warning };
        let advice = if good { String::new() } else { advice.to_string() };
        Self { name, state, found, advice }
    }
}

/// Outcomes of all checks.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    /// Checks in the order in which they are printed.
    pub checks: Vec<Check>,
}

/// Runs all checks; takes about a second.
pub fn examine(port: u16, config: &FleetConfig) -> Findings {
    let [shared_memory, open_files, disk] = resources(config);
    let checks = vec![
        processors(),
        wake_up(),
        time_slices(),
        real_time(),
        locked_memory(),
        shared_memory,
        open_files,
        disk,
        port_free(port),
        loopback(),
        multicast(),
        ros_discovery(config, &ros_variables()),
        receive_buffer(),
        buffer_limit("udp receive limit", "rmem_max"),
        buffer_limit("udp send limit", "wmem_max"),
    ];
    Findings { checks }
}

/// Prints the outcomes. Warnings are no failure.
pub fn run(args: &DoctorArgs) -> std::io::Result<()> {
    let mut config = FleetConfig::default();
    config.fleet.robots = args.robots.unwrap_or(config.fleet.robots).clamp(1, ROBOTS_MAX);
    let findings = examine(args.port, &config);
    output::print_either(args.json, &findings, || findings.to_string() + "\n")
}

impl fmt::Display for Findings {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, Check { name, state, found, advice }) in self.checks.iter().enumerate() {
            let mark = if *state == State::Ok { "ok  " } else { "WARN" };
            write!(out, "{}{mark} {name:<18} {found}", if index == 0 { "" } else { "\n" })?;
            if !advice.is_empty() {
                write!(out, "\n     {:<18} -> {advice}", "")?;
            }
        }
        Ok(())
    }
}

fn processors() -> Check {
    let count = std::thread::available_parallelism().map_or(0, usize::from);
    Check::new("processors", count >= 2, format!("{count}"), "a fleet of three robots needs two")
}

/// Measures how late a sleeping thread wakes: no jitter can be smaller.
fn wake_up() -> Check {
    let slack = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1)).is_ok();
    let mut late_ms = Vec::with_capacity(SLEEPS);
    let begun = clock::now();
    for step in 1..=SLEEPS {
        let due = Monotonic(begun.0 + (SLEEP * step as u32).as_nanos() as u64);
        if let Some(left) = due.0.checked_sub(clock::now().0) {
            std::thread::sleep(Duration::from_nanos(left));
            late_ms.push(clock::now().since(due) as f64 * 1e-6);
        }
    }
    late_ms.sort_by(f64::total_cmp);
    let share = |p: f64| late_ms.get((late_ms.len() as f64 * p) as usize).copied().unwrap_or(f64::INFINITY);
    let (median, p99) = (share(0.5), share(0.99));
    let slack = if slack { "" } else { ", timer slack cannot be set" };
    let found = format!("median {median:.3} ms, P99 {p99:.3} ms late{slack}");
    Check::new(
        "timer wake-up",
        p99 <= WAKE_P99_MAX_MS,
        found,
        "other load or a busy host: see real-time priority",
    )
}

/// Checks whether a thread can have a time slice of its own.
fn time_slices() -> Check {
    // The setting applies to a thread of its own, which ends here.
    let slice = std::thread::spawn(|| {
        time_slice::request(time_slice::SLICE_MIN).and_then(|()| time_slice::granted())
    });
    let (is_short, found) = match slice.join() {
        Ok(Ok(Some(slice))) => (slice == time_slice::SLICE_MIN, format!("{slice:?}")),
        Ok(Ok(None)) => (false, "the system's alone".to_string()),
        Ok(Err(why)) => (false, format!("refused: {why}")),
        Err(_) => (false, "not known: the check itself failed".to_string()),
    };
    let advice = "Linux 6.12 or newer: robots and clients wait less for programs that compute";
    Check::new("time slices", is_short, found, advice)
}

fn limit(resource: Resource) -> u64 {
    getrlimit(resource).current.unwrap_or(u64::MAX)
}

/// Returns whether the process has a capability; root usually has all.
fn capable(bit: u32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask >> bit & 1 == 1)
}

fn real_time() -> Check {
    let (capable, most) = (capable(CAP_SYS_NICE), limit(Resource::Rtprio));
    let found = match (capable, most) {
        (true, _) => "permitted".to_string(),
        (false, 0) => "not permitted".to_string(),
        (false, most) => format!("up to priority {most}"),
    };
    let advice = "a line `@GROUP - rtprio 50` in /etc/security/limits.d/mr-slam.conf, and log in again";
    Check::new("real-time priority", capable || most > 0, found, advice)
}

fn locked_memory() -> Check {
    let (capable, most) = (capable(CAP_IPC_LOCK), limit(Resource::Memlock));
    let found = if capable || most == u64::MAX { "no limit".to_string() } else { megabytes(most) };
    let advice = "a line `@GROUP - memlock 1048576` in /etc/security/limits.d/mr-slam.conf";
    Check::new("locked memory", capable || most >= LOCKED_MEMORY_MIN, found, advice)
}

/// Checks what `up` checks before it starts a fleet: the same resources, for the fleet's size.
fn resources(config: &FleetConfig) -> [Check; 3] {
    let free = resources::free_bytes(Path::new(SHARED_MEMORY)).unwrap_or(0);
    let need = shared_memory_need(config.fleet.robots, config.world.is_external());
    let found = format!(
        "{} free; {} robots need {} to {}",
        megabytes(free),
        config.fleet.robots,
        megabytes(need.least),
        megabytes(need.most)
    );
    let check = |name, found, finding: Option<resources::Finding>| {
        let advice = finding.as_ref().map(|finding| finding.shortage.to_string()).unwrap_or_default();
        Check::new(name, finding.is_none(), found, &advice)
    };
    let files = resources::check_descriptors(config);
    let limit = format!("{} for each process", limit(Resource::Nofile));
    let here = Path::new(".");
    let room = match resources::free_bytes(here) {
        Some(free) => format!("{} free in this folder, where `runs/` is made", megabytes(free)),
        None => "it cannot be asked how much is free in this folder".into(),
    };
    [
        check("shared memory", found, resources::check_shared_memory(config)),
        check("open files", limit, files),
        check("disk", room, resources::check_disk(here, config)),
    ]
}

fn port_free(port: u16) -> Check {
    let bound = TcpListener::bind((Ipv4Addr::UNSPECIFIED, port));
    let found = match &bound {
        Ok(_) => format!("{port} is free"),
        Err(why) => format!("{port}: {why}"),
    };
    Check::new(
        "headset's port",
        bound.is_ok(),
        found,
        "stop the program that listens there, or choose another port: mr-slam up --port P",
    )
}

/// Sends a datagram to this process.
fn echo(receiver: &UdpSocket, to: SocketAddr, sender: &UdpSocket) -> std::io::Result<()> {
    receiver.set_read_timeout(Some(Duration::from_millis(500)))?;
    sender.send_to(b"mr-slam", to)?;
    receiver.recv(&mut [0; 16]).map(drop)
}

fn loopback() -> Check {
    let echoed = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|socket| {
        let to = socket.local_addr()?;
        echo(&socket, to, &socket)
    });
    let found = echoed.as_ref().map_or_else(ToString::to_string, |()| "UDP works".to_string());
    Check::new("loopback", echoed.is_ok(), found, "ROS 2 needs UDP on 127.0.0.1: ip link set lo up")
}

/// Checks multicast that does not leave the machine. ROS 2 finds other machines by it; on this one it is not needed.
fn multicast() -> Check {
    let echoed = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
        socket.join_multicast_v4(&DISCOVERY_GROUP, &Ipv4Addr::UNSPECIFIED)?;
        socket.set_multicast_ttl_v4(0)?;
        let to = SocketAddr::from((DISCOVERY_GROUP, socket.local_addr()?.port()));
        echo(&socket, to, &socket)
    });
    let found = echoed.as_ref().map_or_else(ToString::to_string, |()| "works".to_string());
    let advice = "ROS 2 on other machines will not find the fleet; on this machine it will";
    Check::new("multicast", echoed.is_ok(), found, advice)
}

/// Checks whether ROS 2's environment variables for discovery can be obeyed, and says what they come to.
fn ros_discovery(config: &FleetConfig, variables: &DiscoveryVariables) -> Check {
    let name = "ros 2 discovery";
    match Discovery::new(&config.bridge.dds, variables) {
        Ok(Discovery { domain, is_loopback_only, warning }) => {
            let whom = if is_loopback_only { "this machine alone" } else { "other machines too" };
            let advice = warning.unwrap_or_default();
            Check::new(name, advice.is_empty(), format!("domain {domain}, {whom}"), &advice)
        }
        Err(why) => {
            Check::new(name, false, "--ros-domain and --world ros will be refused".into(), &why.to_string())
        }
    }
}

fn sysctl(name: &str) -> Option<u64> {
    std::fs::read_to_string(format!("/proc/sys/net/core/{name}")).ok()?.trim().parse().ok()
}

fn receive_buffer() -> Check {
    let size = sysctl("rmem_default").unwrap_or(0);
    let advice = "maps over 1 MB reach ROS 2 tools late or not at all: \
                  sudo sysctl -w net.core.rmem_max=8388608 net.core.rmem_default=8388608";
    Check::new(
        "udp receive buffer",
        size >= RECEIVE_BUFFER_MIN,
        format!("{} by default", megabytes(size)),
        advice,
    )
}

fn buffer_limit(check: &'static str, name: &'static str) -> Check {
    let size = sysctl(name).unwrap_or(0);
    let advice = format!("sudo sysctl -w net.core.{name}=8388608");
    Check::new(check, size >= BUFFER_MAX_MIN, megabytes(size), &advice)
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 * 1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_warning_has_advice() {
        let findings = examine(0, &FleetConfig::default());
        assert!(findings.checks.len() >= 10);
        for check in &findings.checks {
            assert!(!check.found.is_empty(), "{check:?}");
            assert_eq!(check.state == State::Ok, check.advice.is_empty(), "{check:?}");
        }
        let named = |name| findings.checks.iter().find(|check| check.name == name).unwrap();
        assert_eq!(named("loopback").state, State::Ok);
    }

    #[test]
    fn a_port_in_use_is_a_warning() {
        let taken = TcpListener::bind("0.0.0.0:0").unwrap();
        let check = port_free(taken.local_addr().unwrap().port());
        assert_eq!(check.state, State::Warning);
        assert!(check.advice.contains("--port"));
    }
}
