//! The operator's page as the launcher sees it: a free port for it, and its URL.

use crate::certificate::{self, CertificateError};
use crate::command::output::note;
use crate::config::FleetConfig;
use bridge::BridgeConfig;
use bridge::ros::Dialect;
use qrcode::render::unicode::Dense1x2;
use qrcode::{EcLevel, QrCode};
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
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
            Self::Port(port) => {
                (page.enabled, page.port) = (true, port);
                if port == 0 {
                    page.https.port = 0;
                }
            }
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

/// Replaces the page's ports by ones that are free: the configured, or else any. Returns why a part of it is left out.
///
/// The bridge opens the ports, each time that it is started. Browsers read ROS 2's encoding alone.
pub fn choose_ports(config: &mut FleetConfig) -> Result<(), CertificateError> {
    let is_readable = config.bridge.payloads == Dialect::Ros2;
    let page = &mut config.bridge.page;
    page.enabled &= is_readable;
    if !page.enabled {
        return Ok(());
    }
    match free_port(page.address, page.port) {
        Ok(port) => page.port = port,
        Err(_) => page.enabled = false,
    }
    let https = &mut page.https;
    if !https.enabled {
        return Ok(());
    }
    match free_port(https.address, https.port) {
        Ok(port) => https.port = port,
        Err(_) => https.enabled = false,
    }
    match certificate::load(https) {
        // Without its own files it is left out: the page in clear needs none.
        Err(why) if !https.has_own_certificate() => {
            https.enabled = false;
            note(&format!("no operator's page over HTTPS: {why}"));
            Ok(())
        }
        result => result.map(drop),
    }
}

/// Returns the port if it is free, or else any that is.
fn free_port(address: IpAddr, port: u16) -> io::Result<u16> {
    let bind = |port: u16| TcpListener::bind((address, port)).and_then(|listener| listener.local_addr());
    bind(port).or_else(|_| bind(0)).map(|address| address.port())
}

/// Returns the page's URL, or `None` if there is no page.
pub fn url(config: &FleetConfig) -> Option<String> {
    let page = &config.bridge.page;
    page.enabled.then(|| match page.address.is_loopback() {
        true => format!("http://localhost:{}", page.port),
        false => format!("http://{}", SocketAddr::from((page.address, page.port))),
    })
}

/// Returns the page's URL for a headset in the same network, or `None` if it is not served over HTTPS.
pub fn https_url(config: &FleetConfig) -> Option<String> {
    let BridgeConfig { page, .. } = &config.bridge;
    let address = match page.https.address {
        address if address.is_unspecified() => network_address()?,
        address => address,
    };
    let is_served = page.enabled && page.https.enabled;
    is_served.then(|| format!("https://{}", SocketAddr::from((address, page.https.port))))
}

/// Returns the address that this machine has in the network it would send to others from. Nothing is sent.
fn network_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    socket.connect((ELSEWHERE, 9)).ok()?;
    Some(socket.local_addr().ok()?.ip()).filter(|address| !address.is_loopback())
}

/// An address that nobody has (RFC 5737).
const ELSEWHERE: Ipv4Addr = Ipv4Addr::new(192, 0, 2, 1);

/// Returns the lines that say where the page is; with a QR code if a terminal of this size, columns and rows, can show it.
pub fn describe(config: &FleetConfig, size: Option<(u16, u16)>, is_coloured: bool) -> Vec<String> {
    let mut lines: Vec<_> = url(config).map(|url| format!("operator's page: {url}")).into_iter().collect();
    let Some(url) = https_url(config) else { return lines };
    lines.push(format!("on a headset:    {url} (accept its certificate once)"));
    let code = size.and_then(|size| qr_code(&url, size));
    lines.extend(code.map(|code| if is_coloured { white_on_black(&code) } else { code }));
    lines
}

/// Draws a text as a QR code, two modules to a character; `None` if the terminal is too small for it.
fn qr_code(text: &str, (columns, rows): (u16, u16)) -> Option<String> {
    let code = QrCode::with_error_correction_level(text, EcLevel::L).ok()?;
    let drawn = code.render::<Dense1x2>().dark_color(Dense1x2::Light).light_color(Dense1x2::Dark).build();
    let (width, height) = (drawn.lines().next()?.chars().count(), drawn.lines().count());
    (width <= columns.into() && height + LINES_BESIDE <= rows.into()).then_some(drawn)
}

/// Gives each line of a QR code its colours: in those of a terminal with a light background, cameras would see its negative.
fn white_on_black(code: &str) -> String {
    code.lines().map(|line| format!("{WHITE_ON_BLACK}{line}{RESET}")).collect::<Vec<_>>().join("\n")
}

/// Escape sequence for bright white text on black (ECMA-48, select graphic rendition).
const WHITE_ON_BLACK: &str = "\x1b[97;40m";
/// Escape sequence that ends all colours.
const RESET: &str = "\x1b[0m";
/// Lines of a terminal that a QR code leaves to the live table.
const LINES_BESIDE: usize = 12;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_taken_is_replaced_by_a_free_one() {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = taken.local_addr().unwrap().port();
        let mut config = FleetConfig::default();
        (config.bridge.page.enabled, config.bridge.page.port) = (true, port);
        config.bridge.page.https.enabled = false;
        choose_ports(&mut config).unwrap();
        let chosen = config.bridge.page.port;
        assert!(chosen != port && chosen != 0);
        assert_eq!(url(&config), Some(format!("http://localhost:{chosen}")));
        "off".parse::<PageChoice>().unwrap().apply(&mut config);
        assert_eq!(url(&config), None);
        assert_eq!("8090".parse(), Ok(PageChoice::Port(8090)));
        assert_eq!("on".parse::<PageChoice>(), Err(PageChoiceError));
    }

    #[test]
    fn a_qr_code_is_drawn_where_it_fits() {
        let mut config = FleetConfig::default();
        let page = &mut config.bridge.page;
        (page.https.address, page.https.port) = ([192, 168, 1, 20].into(), 8443);
        let lines = describe(&config, Some((80, 40)), false);
        assert!(lines[1].contains("https://192.168.1.20:8443"), "{lines:?}");
        let code = &lines[2];
        assert!(code.contains('▀') && code.lines().count() <= 20, "{code}");
        let coloured = &describe(&config, Some((80, 40)), true)[2];
        assert!(
            coloured.lines().all(|line| line.starts_with(WHITE_ON_BLACK) && line.ends_with(RESET)),
            "{coloured}"
        );
        for (columns, rows) in [(20, 40), (80, 20)] {
            assert_eq!(describe(&config, Some((columns, rows)), true).len(), 2, "{columns} x {rows}");
        }
        assert_eq!(describe(&config, None, false).len(), 2, "no terminal");
        config.bridge.page.https.enabled = false;
        assert_eq!(describe(&config, Some((80, 40)), true).len(), 1);
    }
}
