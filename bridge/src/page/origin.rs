//! Which web pages may talk to the bridge: checks against DNS rebinding and against WebSockets of foreign pages.

use std::net::IpAddr;
use thiserror::Error;

/// Why a request is refused for where it comes from.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OriginError {
    /// The request has no Host, or several.
    #[error("the request must have one Host")]
    NoHost,
    /// The host is a name that anybody could point at this address.
    #[error("the host '{0}' is not served here; use localhost or this machine's address")]
    Host(String),
    /// Another web page wants to connect.
    #[error("pages of '{0}' may not connect; bridge.page.origins allows them")]
    Origin(String),
}

/// Checks that the request was addressed to this machine: by its address, or as localhost on loopback.
///
/// A foreign name that resolves to this machine (DNS rebinding) would make a foreign page one of this origin.
pub fn check_host(host: Option<&str>, local: IpAddr) -> Result<(), OriginError> {
    let host = host.ok_or(OriginError::NoHost)?;
    let refused = || OriginError::Host(shorten(host));
    let name = host_name(host).ok_or_else(refused)?;
    let is_loopback = local.to_canonical().is_loopback();
    let is_here = match name.parse::<IpAddr>() {
        Ok(address) => {
            let address = address.to_canonical();
            address == local.to_canonical() || (is_loopback && address.is_loopback())
        }
        Err(_) => is_loopback && name.eq_ignore_ascii_case("localhost"),
    };
    is_here.then_some(()).ok_or_else(refused)
}

/// Checks that a WebSocket is opened by the page of this port, by an allowed page, or by no page at all.
///
/// `host` has passed [`check_host`]. Browsers send the origin with every WebSocket; other programs need none.
pub fn check_origin(origin: Option<&str>, host: &str, allowed: &[String]) -> Result<(), OriginError> {
    let Some(origin) = origin else { return Ok(()) };
    let of_scheme =
        |scheme: &str| origin.strip_prefix(scheme).is_some_and(|of| of.eq_ignore_ascii_case(host));
    let is_own = of_scheme("http://") || of_scheme("https://");
    let is_allowed = allowed.iter().any(|known| known.eq_ignore_ascii_case(origin));
    (is_own || is_allowed).then_some(()).ok_or_else(|| OriginError::Origin(shorten(origin)))
}

/// Returns the name or address of `name:port`, without the brackets of an IPv6 address.
fn host_name(host: &str) -> Option<&str> {
    let (name, port) = match host.strip_prefix('[') {
        Some(rest) => {
            let (address, rest) = rest.split_once(']')?;
            (address, if rest.is_empty() { None } else { Some(rest.strip_prefix(':')?) })
        }
        None => match host.split_once(':') {
            Some((name, port)) => (name, Some(port)),
            None => (host, None),
        },
    };
    let is_port = port.is_none_or(|port| port.parse::<u16>().is_ok());
    (is_port && !name.is_empty()).then_some(name)
}

/// Characters of a foreign text that are quoted in an error.
const QUOTED_MAX: usize = 80;

fn shorten(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(QUOTED_MAX).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LOOPBACK: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn a_name_that_is_not_this_machines_is_refused() {
        for good in ["localhost", "localhost:8080", "LocalHost:1", "127.0.0.1:8080", "[::1]:8080", "[::1]"] {
            assert_eq!(check_host(Some(good), LOOPBACK), Ok(()), "{good}");
        }
        for bad in [
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "192.168.1.20:8080",
            "",
            ":8080",
            "localhost:99999",
            "localhost:80:80",
            "[::1",
            "[::1]x",
            "localhost:",
            "127.0.0.1.evil.example",
        ] {
            assert!(check_host(Some(bad), LOOPBACK).is_err(), "{bad}");
        }
        assert_eq!(check_host(None, LOOPBACK), Err(OriginError::NoHost));
        let lan = IpAddr::from([192, 168, 1, 20]);
        assert_eq!(check_host(Some("192.168.1.20:8080"), lan), Ok(()));
        for bad in ["localhost:8080", "127.0.0.1:8080", "laptop:8080"] {
            assert!(check_host(Some(bad), lan).is_err(), "{bad} came from another machine");
        }
    }

    #[test]
    fn only_the_own_page_and_allowed_pages_may_connect() {
        let allowed = ["https://app.foxglove.dev".to_owned()];
        let check = |origin| check_origin(origin, "localhost:8080", &allowed);
        assert_eq!(check(None), Ok(()), "no browser");
        assert_eq!(check(Some("http://localhost:8080")), Ok(()));
        assert_eq!(check(Some("https://app.foxglove.dev")), Ok(()));
        for foreign in [
            "http://evil.example",
            "http://localhost:3000",
            "http://localhost",
            "http://127.0.0.1:8080",
            "null",
            "file://",
            "",
            "http://localhost:8080.evil.example",
            "http://localhost:8080/",
            "localhost:8080",
        ] {
            assert!(check(Some(foreign)).is_err(), "{foreign}");
        }
    }

    proptest! {
        #[test]
        fn no_name_but_localhost_and_no_address_but_loopback_passes(host in "\\PC{0,40}") {
            let passes = check_host(Some(&host), LOOPBACK).is_ok();
            let name = host_name(&host).unwrap_or("");
            let is_loopback = name.parse::<IpAddr>().is_ok_and(|a| a.to_canonical().is_loopback());
            prop_assert_eq!(passes, name.eq_ignore_ascii_case("localhost") || is_loopback);
        }
    }
}
