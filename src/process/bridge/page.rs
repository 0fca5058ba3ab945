//! The operator's page in the bridge process: its port, and the files that the program embeds.

use crate::clock::now;
use crate::page_files::PAGE_FILES;
use ::bridge::{Bridge, PageConfig, serve_page};
use std::rc::Rc;
use std::time::Duration;
use tokio::net::TcpListener;

/// Pause after the port could not be opened: another process may hold it for a while.
const BIND_PAUSE: Duration = Duration::from_secs(1);

/// Serves the page until the task is ended. A port that is taken is tried again each second.
pub async fn serve(bridge: Rc<Bridge>, config: PageConfig) {
    let place = (config.address, config.port);
    let mut is_reported = false;
    let listener = loop {
        match TcpListener::bind(place).await {
            Ok(listener) => break listener,
            Err(why) if !is_reported => {
                is_reported = true;
                tracing::warn!("no operator's page: cannot listen on {}:{}: {why}", place.0, place.1);
            }
            Err(_) => {}
        }
        tokio::time::sleep(BIND_PAUSE).await;
    };
    serve_page(bridge, listener, &config, PAGE_FILES, now, std::future::pending()).await;
}
