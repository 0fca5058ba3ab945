//! Who may watch and who may drive.

use crate::config::{BridgeConfig, Permission};
use std::collections::BTreeSet;
use std::net::IpAddr;

/// Addresses that may wait for an answer at one time; more are told to come again.
const WAITING_MAX: usize = 32;

/// Addresses whose no is remembered; more would be asked about again.
const DENIED_MAX: usize = 1024;

/// What an address may do, and who has asked.
#[derive(Debug)]
pub struct Access {
    watch: Permission,
    drive: Permission,
    trust_loopback: bool,
    allowed: BTreeSet<IpAddr>,
    /// Who has got a no, and is not shown again.
    denied: BTreeSet<IpAddr>,
    waiting: Vec<IpAddr>,
}

impl Access {
    /// As configured.
    pub fn new(config: &BridgeConfig) -> Self {
        Self {
            watch: config.watch,
            drive: config.drive,
            trust_loopback: config.trust_loopback,
            allowed: config.allow.iter().map(IpAddr::to_canonical).collect(),
            denied: BTreeSet::new(),
            waiting: Vec::new(),
        }
    }

    fn trusts(&self, address: IpAddr) -> bool {
        let address = address.to_canonical();
        (self.trust_loopback && address.is_loopback()) || self.allowed.contains(&address)
    }

    /// Whether it may subscribe.
    pub fn may_watch(&self, address: IpAddr) -> bool {
        self.watch == Permission::Anyone || self.trusts(address)
    }

    /// Whether it may publish to the fleet.
    pub fn may_drive(&self, address: IpAddr) -> bool {
        self.drive == Permission::Anyone || self.trusts(address)
    }

    /// Notes that an address wants what it may not, for the person at the laptop to see.
    pub fn ask(&mut self, address: IpAddr) {
        let address = address.to_canonical();
        let asked = self.waiting.contains(&address) || self.denied.contains(&address);
        if !asked && self.waiting.len() < WAITING_MAX {
            self.waiting.push(address);
        }
    }

    /// Who has asked and got no answer yet, first come first.
    pub fn waiting(&self) -> &[IpAddr] {
        &self.waiting
    }

    /// Who has got a yes.
    pub fn allowed(&self) -> impl Iterator<Item = IpAddr> + '_ {
        self.allowed.iter().copied()
    }

    /// The person's yes.
    pub fn allow(&mut self, address: IpAddr) {
        let address = address.to_canonical();
        self.waiting.retain(|waiting| *waiting != address);
        self.denied.remove(&address);
        self.allowed.insert(address);
    }

    /// The person's no: no longer shown, and not let in.
    pub fn deny(&mut self, address: IpAddr) {
        let address = address.to_canonical();
        self.waiting.retain(|waiting| *waiting != address);
        self.allowed.remove(&address);
        if self.denied.len() < DENIED_MAX {
            self.denied.insert(address);
        }
    }
}
