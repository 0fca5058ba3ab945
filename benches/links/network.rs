//! Two network namespaces joined by a link with a rate and a loss, which can be cut. It needs the rights of the system's
//! administrator, and the commands `ip`, `tc` and `nft`.

use std::process::Command;

/// Which end of the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    Base,
    Robot,
}

/// A link between two namespaces.
pub struct Network {
    number: u32,
}

impl Network {
    /// Creates the link, or says why not.
    pub fn open(mbit_s: f64, loss_percent: u32) -> Result<Self, String> {
        let network = Self { number: std::process::id() % 10_000 };
        let [base, robot] = [Side::Base, Side::Robot].map(|side| network.namespace(side));
        run("ip", &["netns", "add", &base])?;
        run("ip", &["netns", "add", &robot])?;
        run(
            "ip",
            &["-n", &base, "link", "add", "wire", "type", "veth", "peer", "name", "wire", "netns", &robot],
        )?;
        for (side, namespace) in [(Side::Base, &base), (Side::Robot, &robot)] {
            let address = format!("{}/24", Self::address(side));
            run("ip", &["-n", namespace, "address", "add", &address, "dev", "wire"])?;
            run("ip", &["-n", namespace, "link", "set", "lo", "up"])?;
            run("ip", &["-n", namespace, "link", "set", "wire", "up"])?;
            let rate = format!("{}kbit", (mbit_s * 1000.0).round());
            // A queue of 0.1 s at this rate.
            let limit = ["rate", &rate, "burst", "16kb", "latency", "100ms"];
            run(
                "tc",
                &[&["-n", namespace, "qdisc", "add", "dev", "wire", "root", "tbf"], &limit[..]].concat(),
            )?;
            if loss_percent > 0 {
                let rules = format!(
                    "add table inet loss; add chain inet loss receive {{ type filter hook input priority 0; }}; \
                     add rule inet loss receive iifname wire numgen random mod 100 < {loss_percent} drop"
                );
                run("ip", &["netns", "exec", namespace, "nft", &rules])?;
            }
        }
        Ok(network)
    }

    fn namespace(&self, side: Side) -> String {
        let end = if side == Side::Base { "b" } else { "r" };
        format!("links{}{end}", self.number)
    }

    /// Returns the address of an end.
    pub fn address(side: Side) -> &'static str {
        if side == Side::Base { "10.214.0.1" } else { "10.214.0.2" }
    }

    /// Makes the link drop every packet, or pass them; neither end is told.
    pub fn set_up(&self, is_up: bool) -> Result<(), String> {
        let namespace = self.namespace(Side::Base);
        run("ip", &["-n", &namespace, "link", "set", "wire", if is_up { "up" } else { "down" }])
    }

    /// Returns a command that runs a program at an end.
    pub fn command(&self, side: Side, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespace(side), program]);
        command
    }

    /// Returns the bytes that the robot's end has sent, with all that Zenoh, TLS, TCP and IP add.
    pub fn robot_bytes(&self) -> u64 {
        let path = "/sys/class/net/wire/statistics/tx_bytes";
        let read = self.command(Side::Robot, "cat").arg(path).output().ok();
        read.and_then(|output| String::from_utf8(output.stdout).ok()?.trim().parse().ok()).unwrap_or(0)
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for side in [Side::Base, Side::Robot] {
            // It fails if the namespace was not made.
            let _ = run("ip", &["netns", "delete", &self.namespace(side)]);
        }
    }
}

fn run(program: &str, words: &[&str]) -> Result<(), String> {
    let ended = Command::new(program).args(words).output().map_err(|why| format!("{program}: {why}"))?;
    let text = String::from_utf8_lossy(&ended.stderr).trim().to_owned();
    if ended.status.success() { Ok(()) } else { Err(format!("{program} {}: {text}", words.join(" "))) }
}
