//! Network namespaces of a base, of robots and of a router, joined by links with a rate and a loss, which can be cut. It needs
//! the rights of the system's administrator, and the commands `ip`, `tc` and `nft`.

use std::process::Command;

/// Machine with a network of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    Base,
    /// Between base and robots.
    Router,
    /// Robot of this index.
    Robot(usize),
}

impl Side {
    /// Number of the machine's own network.
    fn number(self) -> usize {
        match self {
            Self::Base => 100,
            Self::Router => 101,
            Self::Robot(index) => index + 1,
        }
    }
}

/// Rate and loss of a link, in both directions.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    pub mbit_s: f64,
    pub loss_percent: u32,
}

/// Machines that all have a link to one of them, the hub: the base, or a router.
pub struct Network {
    /// Tells the namespaces of two benches apart.
    number: u32,
    hub: Side,
    others: Vec<Side>,
}

impl Network {
    /// Creates the links, or says why not.
    pub fn open(link: Link, robots: usize, has_router: bool) -> Result<Self, String> {
        let hub = if has_router { Side::Router } else { Side::Base };
        let robots = (0..robots).map(Side::Robot);
        let others = robots.chain(has_router.then_some(Side::Base)).collect();
        let network = Self { number: std::process::id() % 10_000, hub, others };
        run("ip", &["netns", "add", &network.namespace(hub)])?;
        run("ip", &["-n", &network.namespace(hub), "link", "set", "lo", "up"])?;
        for side in &network.others {
            network.add(*side, link)?;
        }
        Ok(network)
    }

    fn add(&self, side: Side, link: Link) -> Result<(), String> {
        let (namespace, hub) = (self.namespace(side), self.namespace(self.hub));
        let port = self.port(side);
        run("ip", &["netns", "add", &namespace])?;
        run("ip", &["-n", &namespace, "link", "set", "lo", "up"])?;
        let wire = ["link", "add", "wire", "type", "veth", "peer", "name", &port, "netns", &hub];
        run("ip", &[&["-n", &namespace], &wire[..]].concat())?;
        for (namespace, device, end) in [(&hub, port.as_str(), 1), (&namespace, "wire", 2)] {
            let address = format!("10.214.{}.{end}/24", side.number());
            run("ip", &["-n", namespace, "address", "add", &address, "dev", device])?;
            run("ip", &["-n", namespace, "link", "set", device, "up"])?;
            let rate = format!("{}kbit", (link.mbit_s * 1000.0).round());
            // A queue of 0.1 s at this rate.
            let limit = ["rate", &rate, "burst", "16kb", "latency", "100ms"];
            run(
                "tc",
                &[&["-n", namespace, "qdisc", "add", "dev", device, "root", "tbf"], &limit[..]].concat(),
            )?;
            if link.loss_percent > 0 {
                let rules = format!(
                    "add table inet {device}; add chain inet {device} receive {{ type filter hook input priority 0; }}; \
                     add rule inet {device} receive iifname {device} numgen random mod 100 < {} drop",
                    link.loss_percent
                );
                run("ip", &["netns", "exec", namespace, "nft", &rules])?;
            }
        }
        Ok(())
    }

    fn namespace(&self, side: Side) -> String {
        format!("links{}n{}", self.number, side.number())
    }

    /// Returns the name of the hub's device to a machine.
    fn port(&self, side: Side) -> String {
        format!("wire{}", side.number())
    }

    /// Returns the address at which a machine reaches the hub.
    pub fn hub_address(&self, side: Side) -> String {
        format!("10.214.{}.1", side.number())
    }

    /// Makes the link to a machine drop every packet, or pass them.
    pub fn set_up(&self, side: Side, is_up: bool) {
        let state = if is_up { "up" } else { "down" };
        run("ip", &["-n", &self.namespace(self.hub), "link", "set", &self.port(side), state])
            .expect("a link can be cut and mended");
    }

    /// Returns a command that runs a program on a machine.
    pub fn command(&self, side: Side, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespace(side), program]);
        command
    }

    /// Returns the bytes that a machine has sent, with all that Zenoh, TLS, TCP and IP add.
    pub fn sent_bytes(&self, side: Side) -> u64 {
        let path = "/sys/class/net/wire/statistics/tx_bytes";
        let read = self.command(side, "cat").arg(path).output().ok();
        read.and_then(|output| String::from_utf8(output.stdout).ok()?.trim().parse().ok()).unwrap_or(0)
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for side in self.others.iter().chain([&self.hub]) {
            // It fails if the namespace was not made.
            let _ = run("ip", &["netns", "delete", &self.namespace(*side)]);
        }
    }
}

fn run(program: &str, words: &[&str]) -> Result<(), String> {
    let ended = Command::new(program).args(words).output().map_err(|why| format!("{program}: {why}"))?;
    let text = String::from_utf8_lossy(&ended.stderr).trim().to_owned();
    if ended.status.success() { Ok(()) } else { Err(format!("{program} {}: {text}", words.join(" "))) }
}
