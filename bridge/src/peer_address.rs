//! Addresses that a client can have, for the lists of who may drive.

use std::net::{IpAddr, Ipv4Addr};
use thiserror::Error;

/// Largest number of addresses that are allowed, and of those that are denied. Each more is refused: none is forgotten for another one.
pub const ADDRESSES_MAX: usize = 1024;

/// An address that no client has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "{address} is {what}, which no client has; expected the address of one machine, such as 192.168.1.20"
)]
pub struct PeerAddressError {
    /// The address that was given.
    pub address: IpAddr,
    /// Kind of the address.
    pub what: &'static str,
}

/// Returns the address as connections have it; refuses one that no connection can come from.
pub fn check_peer_address(address: IpAddr) -> Result<IpAddr, PeerAddressError> {
    let what = match address.to_canonical() {
        peer if peer.is_unspecified() => "the unspecified address",
        peer if peer.is_multicast() => "a multicast address",
        IpAddr::V4(Ipv4Addr::BROADCAST) => "the broadcast address",
        // RFC 1122: 0.0.0.0/8 is this network.
        IpAddr::V4(peer) if peer.octets()[0] == 0 => "an address of no machine",
        peer => return Ok(peer),
    };
    Err(PeerAddressError { address, what })
}

/// Text that is no client's address.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PeerTextError {
    /// It is no address.
    #[error("'{0}' is not an IP address; expected one such as 192.168.1.20 or fd00::20")]
    Text(String),
    /// It is an address that no client has.
    #[error(transparent)]
    Address(#[from] PeerAddressError),
}

/// Parses the address of a client.
pub fn parse_peer_address(text: &str) -> Result<IpAddr, PeerTextError> {
    let address = text.parse().map_err(|_| PeerTextError::Text(text.into()))?;
    Ok(check_peer_address(address)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_connection_comes_from_is_refused_in_each_notation() {
        let never =
            ["0.0.0.0", "0.1.2.3", "::", "224.0.0.1", "239.255.255.250", "255.255.255.255", "ff02::1"];
        for text in never.into_iter().chain(["::ffff:0.0.0.0", "::ffff:224.0.0.1", "::ffff:255.255.255.255"])
        {
            let error = parse_peer_address(text).unwrap_err().to_string();
            assert!(error.starts_with(text) && error.contains("192.168.1.20"), "{error}");
        }
        for text in ["", "localhost", "10.0.0", "10.0.0.7:80", "10.0.0.0/8", "*"] {
            assert_eq!(parse_peer_address(text), Err(PeerTextError::Text(text.into())));
        }
        for text in ["10.0.0.7", "127.0.0.1", "169.254.1.1", "::1", "fe80::1", "fd00::20"] {
            assert_eq!(parse_peer_address(text).unwrap().to_string(), text);
        }
        assert_eq!(parse_peer_address("::ffff:10.0.0.7").unwrap().to_string(), "10.0.0.7");
    }
}
