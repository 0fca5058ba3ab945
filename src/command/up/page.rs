//! The operator's page as the launcher sees it: a free port for it, and its URL.

use crate::config::FleetConfig;
use bridge::ros::Dialect;
use std::net::{SocketAddr, TcpListener};
use std::str::FromStr;

/// What `--page` says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PageChoice {
    /// The page is not served.
    Off,
    /// The page is served on this port; 0: any free port.
    Port(u16),
}

impl PageChoice {
    /// Overrides the configuration.
    pub fn apply(self, config: &mut FleetConfig) {
        let page = &mut config.bridge.page;
        match self {
            Self::Off => page.enabled = false,
            Self::Port(port) => (page.enabled, page.port) = (true, port),
        }
    }
}

/// The value of `--page` is no port.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a port, 0 to 65535, or `off`")]
pub struct PageChoiceError;

impl FromStr for PageChoice {
    type Err = PageChoiceError;

    fn from_str(text: &str) -> Result<Self, PageChoiceError> {
        match text {
            "off" => Ok(Self::Off),
            port => port.parse().map(Self::Port).map_err(|_| PageChoiceError),
        }
    }
}

/// Replaces the page's port by one that is free: the configured one, or else any. Without one the page is left out.
///
/// The bridge opens the port, each time that it is started. Browsers read ROS 2's encoding alone.
pub fn choose_port(config: &mut FleetConfig) {
    let is_readable = config.bridge.payloads == Dialect::Ros2;
    let page = &mut config.bridge.page;
    page.enabled &= is_readable;
    if !page.enabled {
        return;
    }
    let bind = |port: u16| TcpListener::bind((page.address, port)).and_then(|listener| listener.local_addr());
    match bind(page.port).or_else(|_| bind(0)) {
        Ok(address) => page.port = address.port(),
        Err(_) => page.enabled = false,
    }
}

/// Returns the page's URL, or `None` if there is no page.
pub fn url(config: &FleetConfig) -> Option<String> {
    let page = &config.bridge.page;
    page.enabled.then(|| match page.address.is_loopback() {
        true => format!("http://localhost:{}", page.port),
        false => format!("http://{}", SocketAddr::from((page.address, page.port))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_taken_is_replaced_by_a_free_one() {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = taken.local_addr().unwrap().port();
        let mut config = FleetConfig::default();
        (config.bridge.page.enabled, config.bridge.page.port) = (true, port);
        choose_port(&mut config);
        let chosen = config.bridge.page.port;
        assert!(chosen != port && chosen != 0);
        assert_eq!(url(&config), Some(format!("http://localhost:{chosen}")));
        "off".parse::<PageChoice>().unwrap().apply(&mut config);
        assert_eq!(url(&config), None);
        assert_eq!("8090".parse(), Ok(PageChoice::Port(8090)));
        assert_eq!("on".parse::<PageChoice>(), Err(PageChoiceError));
    }
}
