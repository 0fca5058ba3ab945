//! The room that a browser offers: a headset's scan, which becomes the simulators' world if the operator accepts it.
//!
//! It comes as the body of `POST /room`. Nothing reads it here: it is passed on as bytes, and the operator's tool checks it.

use super::http::text_response;
use crate::access::{Action, PermissionError};
use crate::bridge::Bridge;
use crate::connection::Stream;
use crate::room_offer::{OfferError, RoomOffer};
use std::cell::Cell;
use std::future::Future;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::rc::Rc;
use std::time::Duration;
use thiserror::Error;
use tokio::io::Interest;
use tokio::time::timeout;

/// Path of the request.
pub const ROOM_PATH: &str = "/room";
/// Largest room, bytes: ten times the largest scan of one room that is known.
pub const ROOM_BYTES_MAX: usize = 16 << 20;
/// A room must be here after this time: 16 MB at 7 Mbit/s.
const ROOM_TIMEOUT: Duration = Duration::from_secs(20);
/// Bytes read at a time.
const READ_BYTES: usize = 64 << 10;

/// Saves an offered room, replacing an earlier one. Must not block the thread.
pub type SaveRoom = Rc<dyn Fn(Vec<u8>) -> Pin<Box<dyn Future<Output = io::Result<()>>>>>;

/// Why a room is not taken.
#[derive(Debug, Error)]
pub(super) enum RoomError {
    /// It may not be offered now.
    #[error(transparent)]
    Offer(#[from] OfferError),
    /// The address is denied.
    #[error(transparent)]
    Denied(#[from] PermissionError),
    /// Another room is being received.
    #[error("another room is being received; try again")]
    Busy,
    /// The room did not come whole.
    #[error("the room did not come within {} s", ROOM_TIMEOUT.as_secs())]
    Slow,
    /// The room cannot be saved.
    #[error("the room cannot be saved: {0}")]
    Save(#[from] io::Error),
}

/// Receives rooms, one at a time.
pub(super) struct RoomReceiver {
    save: Option<SaveRoom>,
    is_busy: Cell<bool>,
}

/// Frees the receiver when it is dropped.
struct Busy<'a>(&'a Cell<bool>);

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.0.set(false);
    }
}

impl RoomReceiver {
    /// Creates a receiver. Without `save`, rooms are refused.
    pub fn new(save: Option<SaveRoom>) -> Self {
        Self { save, is_busy: Cell::new(false) }
    }

    /// Receives a room of `length` bytes, of which `first` are here already; returns the response.
    pub async fn receive(
        &self,
        bridge: &Bridge,
        stream: &impl Stream,
        address: IpAddr,
        first: Vec<u8>,
        length: usize,
    ) -> Vec<u8> {
        match self.offer(bridge, stream, address, first, length).await {
            Ok(()) => text_response("202 Accepted", "the room waits for the operator's answer"),
            Err(error) => {
                let status = match error {
                    RoomError::Denied(_) => "403 Forbidden",
                    RoomError::Offer(_) => "409 Conflict",
                    RoomError::Busy => "503 Service Unavailable",
                    RoomError::Slow => "408 Request Timeout",
                    RoomError::Save(_) => "500 Internal Server Error",
                };
                text_response(status, &error.to_string())
            }
        }
    }

    async fn offer(
        &self,
        bridge: &Bridge,
        stream: &impl Stream,
        address: IpAddr,
        first: Vec<u8>,
        length: usize,
    ) -> Result<(), RoomError> {
        let address = address.to_canonical();
        let save = self.save.as_ref().ok_or(OfferError::NotSimulated)?;
        bridge.check_permission(Action::OfferRoom, address)?;
        bridge.check_room_offer(address)?;
        if self.is_busy.replace(true) {
            return Err(RoomError::Busy);
        }
        let _busy = Busy(&self.is_busy);
        let body = timeout(ROOM_TIMEOUT, read_body(stream, first, length));
        let body = body.await.map_err(|_| RoomError::Slow)?.map_err(|_| RoomError::Slow)?;
        // It may have been denied meanwhile.
        bridge.check_permission(Action::OfferRoom, address)?;
        save(body).await?;
        bridge.record_room_offer(RoomOffer { address, bytes: length });
        Ok(())
    }
}

/// Reads a body of `length` bytes, of which `body` are here already.
pub(super) async fn read_body(stream: &impl Stream, mut body: Vec<u8>, length: usize) -> io::Result<Vec<u8>> {
    // Nothing may follow: a connection serves one request.
    body.truncate(length);
    let mut buffer = vec![0; READ_BYTES];
    while body.len() < length {
        stream.ready(Interest::READABLE).await?;
        let space = buffer.len().min(length - body.len());
        match stream.try_read(&mut buffer[..space]) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => body.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(error),
        }
    }
    Ok(body)
}
