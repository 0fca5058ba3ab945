//! The room that a headset offers as the simulators' world, while it waits for the operator's answer.

use serde::{Deserialize, Serialize};
use std::net::IpAddr;
use thiserror::Error;

/// A room that waits for the operator's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoomOffer {
    /// Who offers it.
    pub address: IpAddr,
    /// Size of the room's file.
    pub bytes: usize,
}

/// Why a room cannot be offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum OfferError {
    /// The fleet's robots are not simulated here.
    #[error("the robots of this fleet are not simulated: it has no room to replace")]
    NotSimulated,
    /// Another address has offered a room that nobody has answered.
    #[error("the room of {0} waits for an answer already")]
    Waiting(IpAddr),
}
