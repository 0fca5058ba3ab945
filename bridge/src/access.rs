//! Access control by address, for watching and for driving.

use crate::config::{BridgeConfig, Permission};
use crate::room_offer::RoomOffer;
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
    /// Set the emergency stop.
    Stop,
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Watch => "watch",
            Self::Drive => "drive",
            Self::Stop => "set the emergency stop",
        })
    }
}

/// Why an address may not do something.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PermissionError {
    /// The operator has been asked.
    #[error(
        "{address} may not {action} yet: press `a` at the laptop, or run `mr-slam allow {address}` there"
    )]
    NotAllowed {
        /// Address that asked.
        address: IpAddr,
        /// What it asked to do.
        action: Action,
    },
    /// The operator has denied it.
    #[error(
        "{address} may not {action}: it is denied; `mr-slam allow {address}` at the laptop allows it again"
    )]
    Denied {
        /// Address that asked.
        address: IpAddr,
        /// What it asked to do.
        action: Action,
    },
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
    /// The room that waits for the operator's answer.
    room_offer: Option<RoomOffer>,
    /// Whether what the clients see was recorded: nothing moves then.
    pub is_replay: bool,
}

impl AccessControl {
    /// Returns the room that waits for the operator's answer.
    pub fn room_offer(&self) -> Option<RoomOffer> {
        self.room_offer
    }

    /// Replaces the room that waits; `None`: it was answered.
    pub fn set_room_offer(&mut self, offer: Option<RoomOffer>) {
        self.room_offer = offer;
    }

    /// Creates the permissions that the configuration gives.
    pub fn new(config: &BridgeConfig) -> Self {
        Self {
            watch: config.watch,
            drive: config.drive,
            trust_loopback: config.trust_loopback,
            allowed: config.allow.iter().map(IpAddr::to_canonical).collect(),
            denied: BTreeSet::new(),
            waiting: Vec::new(),
            room_offer: None,
            is_replay: false,
        }
    }

    fn trusts(&self, address: IpAddr) -> bool {
        let address = address.to_canonical();
        (self.trust_loopback && address.is_loopback()) || self.allowed.contains(&address)
    }

    /// Returns whether an address may do this.
    ///
    /// Everybody may set the emergency stop but a denied address: it could keep the fleet stopped. What the operator has denied
    /// comes before every permission to drive.
    pub fn may(&self, action: Action, address: IpAddr) -> bool {
        let is_denied = self.denied.contains(&address.to_canonical());
        let permission = match action {
            Action::Watch => self.watch,
            Action::Drive | Action::Stop if is_denied => return false,
            Action::Drive => self.drive,
            Action::Stop => return true,
        };
        permission == Permission::Anyone || self.trusts(address)
    }

    /// Fails if an address may not do this, and records its request for the operator.
    pub fn check(&mut self, action: Action, address: IpAddr) -> Result<(), PermissionError> {
        if self.may(action, address) {
            return Ok(());
        }
        self.add_request(address);
        let is_denied = self.denied.contains(&address.to_canonical());
        Err(if is_denied && action != Action::Watch {
            PermissionError::Denied { address, action }
        } else {
            PermissionError::NotAllowed { address, action }
        })
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

    /// Returns the addresses that the operator has denied.
    pub fn denied(&self) -> impl Iterator<Item = IpAddr> + '_ {
        self.denied.iter().copied()
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

    #[test]
    fn a_denied_address_neither_drives_nor_stops_the_fleet() {
        let (denied, other) = (IpAddr::from([192, 168, 1, 20]), IpAddr::from([192, 168, 1, 21]));
        let config = BridgeConfig { drive: Permission::Anyone, allow: vec![denied], ..Default::default() };
        let mut access = AccessControl::new(&config);
        access.deny(denied);
        for action in [Action::Drive, Action::Stop] {
            let error = access.check(action, denied).unwrap_err().to_string();
            assert!(error.contains("it is denied"), "{error}");
            assert_eq!(access.check(action, other), Ok(()));
        }
        let strict = AccessControl::new(&BridgeConfig::default());
        assert!(strict.may(Action::Stop, other), "who may not drive may stop");
        assert_eq!(access.check(Action::Watch, denied), Ok(()));
    }
}
