//! Endpoints of the link on the command line, such as `quic/192.168.1.10:7447`.

use std::fmt;
use std::net::{IpAddr, ToSocketAddrs};
use std::str::FromStr;

/// Reason why an endpoint is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EndpointError {
    /// It is not of the expected form.
    #[error(
        "`{0}` is no endpoint; expected quic/HOST:PORT, tls/HOST:PORT or tcp/HOST:PORT, such as quic/192.168.1.10:7447"
    )]
    Form(String),
    /// It is on another machine, and nothing is encrypted.
    #[error(
        "`{0}` is not this machine's loopback address, and tcp/ is not encrypted: anybody in the network could drive the \
         robots; use quic/ or tls/ with keys (`mr-slam keys`), or give --unencrypted if that is acceptable"
    )]
    Unencrypted(String),
}

/// Protocol below Zenoh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// QUIC over UDP, encrypted, with certificates on both sides. A lost packet delays its own priority alone.
    Quic,
    /// TLS over TCP, with certificates on both sides, where UDP is not let through.
    Tls,
    /// TCP, not encrypted.
    Tcp,
}

impl Protocol {
    const ALL: [Self; 3] = [Self::Quic, Self::Tls, Self::Tcp];

    /// Name in endpoints and in Zenoh's configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quic => "quic",
            Self::Tls => "tls",
            Self::Tcp => "tcp",
        }
    }

    /// Whether both sides show certificates, and nothing is sent as plain text.
    pub fn is_encrypted(self) -> bool {
        self != Self::Tcp
    }
}

/// Address of the base with its protocol.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Protocol below Zenoh.
    pub protocol: Protocol,
    /// Host and port.
    address: String,
}

impl Endpoint {
    /// Returns the endpoint at the same host and port with another protocol.
    pub fn with_protocol(&self, protocol: Protocol) -> Self {
        Self { protocol, ..self.clone() }
    }

    /// Checks that nothing unencrypted leaves this machine, unless that is accepted.
    pub fn check(&self, is_unencrypted_accepted: bool) -> Result<(), EndpointError> {
        if self.protocol.is_encrypted() || is_unencrypted_accepted {
            return Ok(());
        }
        // A name that cannot be resolved yet may be any machine's.
        let is_local = self
            .address
            .to_socket_addrs()
            .is_ok_and(|mut addresses| addresses.all(|address| IpAddr::is_loopback(&address.ip())));
        if is_local { Ok(()) } else { Err(EndpointError::Unencrypted(self.to_string())) }
    }
}

impl FromStr for Endpoint {
    type Err = EndpointError;

    fn from_str(text: &str) -> Result<Self, EndpointError> {
        let wrong = || EndpointError::Form(text.into());
        let (protocol, address) = text.split_once('/').ok_or_else(wrong)?;
        let protocol = Protocol::ALL.into_iter().find(|known| known.name() == protocol).ok_or_else(wrong)?;
        let (host, port) = address.rsplit_once(':').ok_or_else(wrong)?;
        // Characters of names and addresses alone: the text becomes part of a configuration.
        let is_host = |c: char| c.is_ascii_alphanumeric() || "-._:[]".contains(c);
        if host.is_empty() || !host.chars().all(is_host) || port.parse::<u16>().is_err() {
            return Err(wrong());
        }
        Ok(Self { protocol, address: address.into() })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.protocol.name(), self.address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_text_leaves_the_machine_only_if_that_is_accepted() {
        let check = |text: &str, accepted| text.parse::<Endpoint>().unwrap().check(accepted);
        assert!(check("tcp/127.0.0.1:7447", false).is_ok() && check("tcp/[::1]:7447", false).is_ok());
        let why = check("tcp/192.0.2.1:7447", false).unwrap_err().to_string();
        assert!(why.contains("--unencrypted") && why.contains("192.0.2.1"), "{why}");
        assert!(check("tcp/192.0.2.1:7447", true).is_ok());
        assert!(check("tls/192.0.2.1:7447", false).is_ok() && check("quic/192.0.2.1:7447", false).is_ok());
        assert!(check("tcp/0.0.0.0:7447", false).is_err(), "all networks");
        assert!(check("tcp/no.such.host.invalid:7447", false).is_err(), "it may be any machine's");
    }

    #[test]
    fn other_texts_are_no_endpoints() {
        for text in [
            "192.0.2.1:7447",
            "udp/192.0.2.1:7447",
            "tcp/:1",
            "tcp/a",
            "tcp/a:99999",
            "tls/a\"]:1",
            "tcp/a b:1",
        ] {
            assert!(matches!(text.parse::<Endpoint>(), Err(EndpointError::Form(_))), "{text}");
        }
    }
}
