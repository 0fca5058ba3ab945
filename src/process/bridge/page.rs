//! The operator's page in the bridge process: its port, and the files that the program embeds.

use crate::certificate;
use crate::clock::now;
use crate::page_files::PAGE_FILES;
use ::bridge::{Bridge, PageConfig, TlsAcceptor, serve_page};
use std::net::IpAddr;
use std::rc::Rc;
use std::time::Duration;
use tokio::net::TcpListener;

/// Pause after the port could not be opened: another process may hold it for a while.
const BIND_PAUSE: Duration = Duration::from_secs(1);

/// Serves the page in clear and encrypted until the task is ended.
pub async fn serve(bridge: Rc<Bridge>, config: PageConfig) {
    let plain = serve_on(bridge.clone(), &config, config.address, config.port, None);
    let encrypted = async {
        if !config.https.enabled {
            return;
        }
        match certificate::load(&config.https) {
            Ok(acceptor) => {
                serve_on(bridge, &config, config.https.address, config.https.port, Some(acceptor)).await;
            }
            Err(why) => tracing::warn!("no operator's page over HTTPS: {why}"),
        }
    };
    tokio::join!(plain, encrypted);
}

/// Serves the page on one port. A port that is taken is tried again each second.
async fn serve_on(
    bridge: Rc<Bridge>,
    config: &PageConfig,
    address: IpAddr,
    port: u16,
    encryption: Option<TlsAcceptor>,
) {
    let mut is_reported = false;
    let listener = loop {
        match TcpListener::bind((address, port)).await {
            Ok(listener) => break listener,
            Err(why) if !is_reported => {
                is_reported = true;
                tracing::warn!("no operator's page: cannot listen on {address}:{port}: {why}");
            }
            Err(_) => {}
        }
        tokio::time::sleep(BIND_PAUSE).await;
    };
    serve_page(bridge, listener, encryption, config, PAGE_FILES, now, std::future::pending()).await;
}
