//! Access control by address, for watching and for driving.

use crate::config::{BridgeConfig, Permission};
use std::collections::BTreeSet;
use std::fmt;
use std::net::IpAddr;
use thiserror::Error;

/// Addresses that may wait for permission at a time; further requests are not shown to the operator.
const WAITING_MAX: usize = 32;
/// Refused addresses that are remembered; the operator is asked about further ones again.
const DENIED_MAX: usize = 1024;

/// What an address asks to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Subscribe to topics.
    Watch,
    /// Publish to the fleet.
    Drive,
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Watch => "watch",
            Self::Drive => "drive",
        })
    }
}

/// An address has no permission yet; the operator has been asked for it.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{address} may not {action} yet: press `a` at the laptop, or run `mr-slam allow {address}` there")]
pub struct PermissionError {
    address: IpAddr,
    action: Action,
}

/// The permissions of addresses, and the addresses that wait for one.
#[derive(Debug)]
pub struct AccessControl {
    watch: Permission,
    drive: Permission,
    trust_loopback: bool,
    allowed: BTreeSet<IpAddr>,
    /// Addresses that the operator has refused and is not asked about again.
    denied: BTreeSet<IpAddr>,
    waiting: Vec<IpAddr>,
}

impl AccessControl {
    /// Creates the permissions that the configuration gives.
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

    /// Returns whether an address may do this.
    pub fn may(&self, action: Action, address: IpAddr) -> bool {
        let permission = match action {
            Action::Watch => self.watch,
            Action::Drive => self.drive,
        };
        permission == Permission::Anyone || self.trusts(address)
    }

    /// Fails if an address may not do this, and records its request for the operator.
    pub fn check(&mut self, action: Action, address: IpAddr) -> Result<(), PermissionError> {
        if self.may(action, address) {
            return Ok(());
        }
        self.add_request(address);
        Err(PermissionError { address, action })
    }

    fn add_request(&mut self, address: IpAddr) {
        let address = address.to_canonical();
        let is_known = self.waiting.contains(&address) || self.denied.contains(&address);
        if !is_known && self.waiting.len() < WAITING_MAX {
            self.waiting.push(address);
        }
    }

    /// Returns the addresses that wait for the operator's answer, in order of their requests.
    pub fn waiting(&self) -> &[IpAddr] {
        &self.waiting
    }

    /// Returns the addresses on the allow list.
    pub fn allowed(&self) -> impl Iterator<Item = IpAddr> + '_ {
        self.allowed.iter().copied()
    }

    /// Allows an address to watch and drive.
    pub fn allow(&mut self, address: IpAddr) {
        let address = address.to_canonical();
        self.waiting.retain(|waiting| *waiting != address);
        self.denied.remove(&address);
        self.allowed.insert(address);
    }

    /// Withdraws an address's permission, or refuses its request.
    pub fn deny(&mut self, address: IpAddr) {
        let address = address.to_canonical();
        self.waiting.retain(|waiting| *waiting != address);
        self.allowed.remove(&address);
        if self.denied.len() < DENIED_MAX {
            self.denied.insert(address);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_asks_once_and_drives_when_the_operator_allows_it() {
        let address = IpAddr::from([192, 168, 1, 20]);
        let mut access = AccessControl::new(&BridgeConfig::default());
        let error = access.check(Action::Drive, address).unwrap_err();
        assert!(error.to_string().contains("mr-slam allow 192.168.1.20"), "{error}");
        assert!(access.check(Action::Drive, address).is_err());
        assert_eq!(access.waiting(), [address]);
        access.allow(address);
        assert_eq!(access.check(Action::Drive, address), Ok(()));
        assert!(access.waiting().is_empty());
        access.deny(address);
        assert!(access.check(Action::Drive, address).is_err());
        assert!(access.waiting().is_empty(), "the operator is not asked again");
    }
}
