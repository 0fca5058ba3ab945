//! Permissions of addresses, as the operator reads and changes them.

use super::Bridge;
use crate::access::{Action, AddressListFull, DRIVE_PERMITTED};
use crate::command::name;
use crate::router::{Client, ClientId};
use std::net::{IpAddr, SocketAddr};

impl Bridge {
    /// Returns the addresses that wait for permission.
    pub fn waiting_addresses(&self) -> Vec<IpAddr> {
        self.core.borrow().access.waiting().to_vec()
    }

    /// Returns the addresses on the allow list.
    pub fn allowed_addresses(&self) -> Vec<IpAddr> {
        self.core.borrow().access.allowed().collect()
    }

    /// Returns the addresses that the operator has denied.
    pub fn denied_addresses(&self) -> Vec<IpAddr> {
        self.core.borrow().access.denied().collect()
    }

    /// Returns how many requests for permission of addresses were not listed, since the list of those that wait is full.
    pub fn unlisted_requests(&self) -> u64 {
        self.core.borrow().access.unlisted_requests()
    }

    /// Allows an address to watch and drive.
    ///
    /// # Errors
    /// As many addresses are allowed as are kept. Nothing is changed.
    pub fn allow(&self, address: IpAddr) -> Result<(), AddressListFull> {
        self.update(|core| {
            core.access.allow(address)?;
            core.update_services();
            let is_same = |peer: SocketAddr| peer.ip().to_canonical() == address.to_canonical();
            let there: Vec<ClientId> =
                core.router.clients().filter(|client| is_same(client.peer)).map(|client| client.id).collect();
            for id in there {
                core.router.send_notice(id, name::LOG, DRIVE_PERMITTED.into());
            }
            Ok(())
        })
    }

    /// Withdraws an address's permission; the robots that it drove, sent to goals or lets explore stop.
    ///
    /// # Errors
    /// As many addresses are denied as are kept. The permission is withdrawn and its robots stop, but it may ask again.
    pub fn deny(&self, address: IpAddr) -> Result<(), AddressListFull> {
        self.update(|core| {
            let result = core.access.deny(address);
            core.update_services();
            let is_stopped = |client: &&Client| {
                let peer = client.peer.ip();
                peer.to_canonical() == address.to_canonical() || !core.access.may(Action::Drive, peer)
            };
            let there: Vec<ClientId> =
                core.router.clients().filter(is_stopped).map(|client| client.id).collect();
            there.into_iter().for_each(|id| core.stop_robots_of(id));
            core.pause_robots_of(address);
            result
        })
    }
}
