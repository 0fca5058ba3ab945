//! The operator's page in the bridge process: its port, and the files that the program embeds.

use crate::certificate;
use crate::clock::now;
use crate::page_files::PAGE_FILES;
use ::bridge::{Bridge, PageConfig, PageContent, PageListeners, SaveRoom, SaveTlx, TlsAcceptor, serve_page};
use msg::Monotonic;
use std::io::{self, Write as _};
use std::net::TcpListener as StdListener;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Duration;
use tokio::net::TcpListener;

/// Pause after the port could not be opened: another process may hold it for a while.
const BIND_PAUSE: Duration = Duration::from_secs(1);

/// Returns the identity of a run, which no other run has: of its launcher, not of the bridge, which may start again.
pub fn run_id(launcher_pid: u32, begun: Monotonic) -> String {
    format!("{launcher_pid}-{}", begun.0)
}

/// Serves the page in clear and encrypted until the task is ended. A port of `PageListeners` that is not open yet is tried again.
///
/// Rooms that browsers offer are saved in `room_file`; without one they are refused. `save_tlx` saves answers about workload,
/// likewise. Pages begin anew when `run_id` changes.
pub async fn serve(
    bridge: Rc<Bridge>,
    config: PageConfig,
    run_id: String,
    room_file: Option<PathBuf>,
    save_tlx: Option<SaveTlx>,
    PageListeners { plain, encrypted }: PageListeners,
) {
    let content = PageContent { files: PAGE_FILES, save_room: room_file.map(save_room), save_tlx, run_id };
    let plain = serve_on(bridge.clone(), &config, content.clone(), plain, None);
    let encrypted = async {
        if !config.https.enabled {
            return;
        }
        match certificate::load(&config.https) {
            Ok(acceptor) => {
                serve_on(bridge, &config, content, encrypted, Some(acceptor)).await;
            }
            Err(why) => tracing::warn!("no operator's page over HTTPS: {why}"),
        }
    };
    tokio::join!(plain, encrypted);
}

/// Serves the page on one port, encrypted if there is an acceptor. A port that is not `open` yet is tried each second.
async fn serve_on(
    bridge: Rc<Bridge>,
    config: &PageConfig,
    content: PageContent,
    open: Option<StdListener>,
    encryption: Option<TlsAcceptor>,
) {
    let (address, port) = match encryption {
        Some(_) => (config.https.address, config.https.port),
        None => (config.address, config.port),
    };
    let mut is_reported = false;
    let mut open = open.and_then(|listener| TcpListener::from_std(listener).ok());
    let listener = loop {
        if let Some(listener) = open.take() {
            break listener;
        }
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
    serve_page(bridge, listener, encryption, config, content, now, std::future::pending()).await;
}

/// Returns what saves an offered room into a file, on a thread of its own.
fn save_room(path: PathBuf) -> SaveRoom {
    Rc::new(move |bytes| {
        let path = path.clone();
        Box::pin(async move {
            let write = move || formats::atomic::write(&path, |file| file.write_all(&bytes));
            tokio::task::spawn_blocking(write).await.map_err(io::Error::other)?
        })
    })
}
