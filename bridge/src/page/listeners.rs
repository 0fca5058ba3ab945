//! Ports of the operator's page that are open before the bridge is ready.

use crate::PageConfig;
use std::net::{IpAddr, TcpListener};

/// Ports of the page that were opened before the bridge was ready: browsers that connect meanwhile wait, instead of being refused.
#[derive(Default)]
pub struct PageListeners {
    /// Port of the page in clear.
    pub plain: Option<TcpListener>,
    /// Port of the encrypted page.
    pub encrypted: Option<TcpListener>,
}

impl PageListeners {
    /// Opens the ports of a configuration as far as they are free; the others are to be tried again.
    pub fn open(config: &PageConfig) -> Self {
        let listen = |is_wanted: bool, address: IpAddr, port: u16| {
            let listener = is_wanted.then(|| TcpListener::bind((address, port)))?.ok()?;
            listener.set_nonblocking(true).ok().map(|()| listener)
        };
        let https = &config.https;
        Self {
            plain: listen(config.enabled, config.address, config.port),
            encrypted: listen(config.enabled && https.enabled, https.address, https.port),
        }
    }
}
