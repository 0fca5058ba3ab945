//! What browsers send with a request of their own: the room that a headset offers, while it waits for the operator's answer, and answers
//! to the form of workload.

use super::Bridge;
use crate::access::{Action, PermissionError};
use crate::room_offer::{OfferError, RoomOffer};
use std::net::IpAddr;

impl Bridge {
    /// Returns the room that waits for an answer.
    pub fn room_offer(&self) -> Option<RoomOffer> {
        self.core.borrow().access.room_offer()
    }

    /// Forgets the room that waits: the operator has accepted or refused it.
    pub fn answer_room(&self) {
        self.core.borrow_mut().access.set_room_offer(None);
    }

    /// Returns whether an address may offer a room now.
    pub(crate) fn check_room_offer(&self, address: IpAddr) -> Result<(), OfferError> {
        let core = self.core.borrow();
        match core.access.room_offer() {
            _ if core.world.is_some() => Err(OfferError::NotSimulated),
            Some(offer) if offer.address != address => Err(OfferError::Waiting(offer.address)),
            _ => Ok(()),
        }
    }

    /// Returns whether an address has the permission for a request of its own: it is not denied.
    pub(crate) fn check_permission(&self, action: Action, address: IpAddr) -> Result<(), PermissionError> {
        self.core.borrow_mut().access.check(action, address)
    }

    /// Records a room that was saved.
    pub(crate) fn record_room_offer(&self, offer: RoomOffer) {
        self.core.borrow_mut().access.set_room_offer(Some(offer));
        let RoomOffer { address, bytes } = offer;
        let megabytes = bytes as f64 / 1e6;
        self.report_event(format!(
            "{address} offers its room ({megabytes:.1} MB) as the simulators' world: mr-slam room accept, or refuse"
        ));
    }
}
