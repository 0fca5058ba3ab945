//! Access control by address, for watching and for driving.

use crate::config::{BridgeConfig, Permission};
use crate::peer_address::ADDRESSES_MAX;
use crate::room_offer::RoomOffer;
use std::collections::BTreeSet;
use std::fmt;
use std::net::IpAddr;
use thiserror::Error;

/// Addresses that may wait for permission at a time; further requests are not shown to the operator.
const WAITING_MAX: usize = 32;

/// What an address asks to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Subscribe to topics.
    Watch,
    /// Publish to the fleet.
    Drive,
    /// Set the emergency stop.
    Stop,
    /// Offer a room as the simulators' world.
    OfferRoom,
    /// Send an answer to the form of workload.
    AnswerForm,
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Watch => "watch",
            Self::Drive => "drive",
            Self::Stop => "set the emergency stop",
            Self::OfferRoom => "offer a room",
            Self::AnswerForm => "send an answer to the form",
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
    /// The list of those that wait is full.
    #[error(
        "{address} may not {action} yet, and {WAITING_MAX} addresses wait already: run `mr-slam allow {address}` at the laptop"
    )]
    NotListed {
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

/// Text for a client that may drive from now on.
pub(crate) const DRIVE_PERMITTED: &str = "you may drive now";

/// Returns what a text of the bridge to a client says of its permission to drive; `None`: nothing. Clients on TCP get it in no other way.
pub fn drive_permission(text: &str) -> Option<bool> {
    if text.contains(DRIVE_PERMITTED) {
        return Some(true);
    }
    text.contains(&format!("may not {}", Action::Drive)).then_some(false)
}

/// Why an address cannot be added to a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum AddressListFull {
    /// As many addresses are allowed as are kept.
    #[error(
        "{0} is not allowed: {ADDRESSES_MAX} addresses are allowed already, the limit; take one off the list with `mr-slam deny ADDRESS`"
    )]
    Allowed(IpAddr),
    /// As many addresses are denied as are kept.
    #[error(
        "{0} has no permission now, but is NOT denied and may ask again: {ADDRESSES_MAX} addresses are denied already, the limit; take one \
         off the list with `mr-slam allow ADDRESS`, or start the fleet without --trust-lan, so that only addresses that you allow drive"
    )]
    Denied(IpAddr),
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
    /// Requests of addresses that are not listed, since the list of those that wait is full.
    unlisted_requests: u64,
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
            unlisted_requests: 0,
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
            Action::OfferRoom | Action::AnswerForm => return !is_denied,
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
        let is_listed = self.add_request(address);
        let is_denied = self.denied.contains(&address.to_canonical());
        Err(if is_denied && action != Action::Watch {
            PermissionError::Denied { address, action }
        } else if !is_listed {
            PermissionError::NotListed { address, action }
        } else {
            PermissionError::NotAllowed { address, action }
        })
    }

    /// Lists an address among those that wait, unless it is denied. Returns false if the list is full, and counts the request.
    fn add_request(&mut self, address: IpAddr) -> bool {
        let address = address.to_canonical();
        if self.waiting.contains(&address) || self.denied.contains(&address) {
            return true;
        }
        let is_listed = self.waiting.len() < WAITING_MAX;
        if is_listed {
            self.waiting.push(address);
        } else {
            self.unlisted_requests = self.unlisted_requests.saturating_add(1);
        }
        is_listed
    }

    /// Removes an address from those that wait. There is room again: who is not listed asks again.
    fn answer_request(&mut self, address: IpAddr) {
        self.waiting.retain(|waiting| *waiting != address);
        if self.waiting.len() < WAITING_MAX {
            self.unlisted_requests = 0;
        }
    }

    /// Returns how many requests of addresses were not listed, since the list of those that wait is full.
    pub fn unlisted_requests(&self) -> u64 {
        self.unlisted_requests
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
    ///
    /// # Errors
    /// As many addresses are allowed as are kept. Nothing is changed.
    pub fn allow(&mut self, address: IpAddr) -> Result<(), AddressListFull> {
        let address = address.to_canonical();
        if !self.allowed.contains(&address) && self.allowed.len() >= ADDRESSES_MAX {
            return Err(AddressListFull::Allowed(address));
        }
        self.answer_request(address);
        self.denied.remove(&address);
        self.allowed.insert(address);
        Ok(())
    }

    /// Withdraws an address's permission, or refuses its request, with the room that it offers.
    ///
    /// # Errors
    /// As many addresses are denied as are kept. The permission is withdrawn, but the address may ask again.
    pub fn deny(&mut self, address: IpAddr) -> Result<(), AddressListFull> {
        let address = address.to_canonical();
        self.answer_request(address);
        self.allowed.remove(&address);
        self.room_offer = self.room_offer.filter(|offer| offer.address.to_canonical() != address);
        if !self.denied.contains(&address) && self.denied.len() >= ADDRESSES_MAX {
            return Err(AddressListFull::Denied(address));
        }
        self.denied.insert(address);
        Ok(())
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
        access.allow(address).unwrap();
        assert_eq!(access.check(Action::Drive, address), Ok(()));
        assert!(access.waiting().is_empty());
        access.deny(address).unwrap();
        assert!(access.check(Action::Drive, address).is_err());
        assert!(access.waiting().is_empty(), "the operator is not asked again");
    }

    #[test]
    fn a_client_understands_each_refusal_to_drive_and_the_permission() {
        let address = IpAddr::from([192, 168, 1, 20]);
        let of = |action| {
            [
                PermissionError::NotAllowed { address, action },
                PermissionError::NotListed { address, action },
                PermissionError::Denied { address, action },
            ]
        };
        for (action, expected) in [(Action::Drive, Some(false)), (Action::Watch, None), (Action::Stop, None)]
        {
            assert!(of(action).iter().all(|why| drive_permission(&why.to_string()) == expected), "{action}");
        }
        assert_eq!(drive_permission(DRIVE_PERMITTED), Some(true));
        assert_eq!(drive_permission("robot2 is driven by 192.168.1.20"), None);
    }

    #[test]
    fn a_denied_address_neither_drives_nor_stops_the_fleet() {
        let (denied, other) = (IpAddr::from([192, 168, 1, 20]), IpAddr::from([192, 168, 1, 21]));
        let config = BridgeConfig { drive: Permission::Anyone, allow: vec![denied], ..Default::default() };
        let mut access = AccessControl::new(&config);
        access.deny(denied).unwrap();
        for action in [Action::Drive, Action::Stop] {
            let error = access.check(action, denied).unwrap_err().to_string();
            assert!(error.contains("it is denied"), "{error}");
            assert_eq!(access.check(action, other), Ok(()));
        }
        let strict = AccessControl::new(&BridgeConfig::default());
        assert!(strict.may(Action::Stop, other), "who may not drive may stop");
        assert_eq!(access.check(Action::Watch, denied), Ok(()));
        for action in [Action::OfferRoom, Action::AnswerForm] {
            assert!(access.check(action, denied).unwrap_err().to_string().contains("it is denied"));
            assert_eq!(access.check(action, other), Ok(()));
        }
    }

    fn numbered(number: usize) -> IpAddr {
        IpAddr::from([10, 0, (number / 256) as u8, (number % 256) as u8])
    }

    #[test]
    fn a_full_list_is_said_and_keeps_all_that_are_on_it() {
        let config = BridgeConfig { drive: Permission::Anyone, ..Default::default() };
        let mut access = AccessControl::new(&config);
        (0..ADDRESSES_MAX).for_each(|number| access.deny(numbered(number)).unwrap());
        let more = numbered(ADDRESSES_MAX);
        let error = access.deny(more).unwrap_err().to_string();
        assert!(error.contains("NOT denied") && error.contains("mr-slam allow"), "{error}");
        assert_eq!(access.deny(numbered(0)), Ok(()), "it is denied already");
        assert!((0..ADDRESSES_MAX).all(|number| !access.may(Action::Drive, numbered(number))));
        access.allow(numbered(0)).unwrap();
        assert_eq!(access.deny(more), Ok(()), "there is room again");
        assert!(!access.may(Action::Drive, more));

        let mut access = AccessControl::new(&BridgeConfig::default());
        (0..ADDRESSES_MAX).for_each(|number| access.allow(numbered(number)).unwrap());
        let error = access.allow(more).unwrap_err().to_string();
        assert!(error.contains("not allowed") && error.contains("mr-slam deny"), "{error}");
        assert_eq!((access.allowed().count(), access.may(Action::Drive, more)), (ADDRESSES_MAX, false));
    }

    #[test]
    fn requests_that_are_not_listed_are_counted_until_there_is_room() {
        let mut access = AccessControl::new(&BridgeConfig::default());
        for number in 0..WAITING_MAX {
            assert!(access.check(Action::Drive, numbered(number)).is_err());
        }
        let more = numbered(WAITING_MAX);
        let error = access.check(Action::Drive, more).unwrap_err().to_string();
        assert!(!error.contains("press `a`") && error.contains("mr-slam allow 10.0.0.32"), "{error}");
        assert_eq!((access.waiting().len(), access.unlisted_requests()), (WAITING_MAX, 1));
        access.deny(numbered(0)).unwrap();
        assert_eq!(access.unlisted_requests(), 0);
        assert!(access.check(Action::Drive, more).is_err());
        assert_eq!(access.waiting().last(), Some(&more));
    }

    #[test]
    fn the_room_of_a_denied_address_makes_room_for_another_one() {
        let mut access = AccessControl::new(&BridgeConfig::default());
        let address = numbered(7);
        access.set_room_offer(Some(RoomOffer { address, bytes: 1 }));
        access.deny(numbered(8)).unwrap();
        assert!(access.room_offer().is_some());
        access.deny(address).unwrap();
        assert_eq!(access.room_offer(), None);
    }
}
