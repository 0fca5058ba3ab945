//! A link between two network namespaces that can be cut. It needs the rights of the system's administrator.

use crate::fleet::Fleet;
use std::process::Command;

/// Returns the address of the operator behind the link. Each run of the bench has a subnet of its own.
pub fn operator_address() -> String {
    address(2)
}

/// Returns the address of this machine on the link.
fn own_address() -> String {
    address(1)
}

fn address(host: u8) -> String {
    format!("10.213.{}.{host}", std::process::id() % 256)
}

/// A pair of virtual network devices, one of them in a namespace of its own.
pub struct CutLink {
    namespace: String,
    device: String,
}

impl CutLink {
    /// Creates the link, or says why not.
    pub fn open() -> Result<Self, String> {
        let number = std::process::id() % 10_000;
        let link = Self { namespace: format!("safety{number}"), device: format!("safety{number}a") };
        let (namespace, device, peer) = (&*link.namespace, &*link.device, &*format!("safety{number}b"));
        ip(&["netns", "add", namespace])?;
        ip(&["link", "add", device, "type", "veth", "peer", "name", peer])?;
        ip(&["link", "set", peer, "netns", namespace])?;
        ip(&["address", "add", &format!("{}/24", own_address()), "dev", device])?;
        let inside = ["netns", "exec", namespace, "ip"];
        let address = format!("{}/24", operator_address());
        ip(&[&inside[..], &["address", "add", &address, "dev", peer]].concat())?;
        ip(&[&inside[..], &["link", "set", peer, "up"]].concat())?;
        link.connect()?;
        Ok(link)
    }

    /// Makes the link pass packets.
    pub fn connect(&self) -> Result<(), String> {
        ip(&["link", "set", &self.device, "up"])
    }

    /// Makes the link drop every packet; neither side is told.
    pub fn cut(&self) -> Result<(), String> {
        ip(&["link", "set", &self.device, "down"])
    }

    /// Returns where an operator behind the link connects.
    pub fn address(&self, fleet: &Fleet) -> String {
        format!("{}:{}", own_address(), fleet.port)
    }

    /// Returns a command that runs a program behind the link.
    pub fn command(&self, program: &std::path::Path) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespace]).arg(program);
        command
    }
}

impl Drop for CutLink {
    fn drop(&mut self) {
        // Both fail if the link was not made.
        let _ = ip(&["link", "delete", &self.device]);
        let _ = ip(&["netns", "delete", &self.namespace]);
    }
}

fn ip(words: &[&str]) -> Result<(), String> {
    let ended = Command::new("ip").args(words).output().map_err(|why| format!("ip: {why}"))?;
    let text = String::from_utf8_lossy(&ended.stderr).trim().to_owned();
    if ended.status.success() { Ok(()) } else { Err(format!("ip {}: {text}", words.join(" "))) }
}
