//! The bridge's control socket, for the operator at the laptop: see [`crate::control`].

pub mod saved_state;

use crate::allowed;
use crate::clock::now;
use crate::control::{self, BridgeState, LINE_MAX, Reply, Request};
use crate::run::Run;
use crate::storage::Storage;
use ::bridge::Bridge;
use msg::Monotonic;
use saved_state::{SavedFiles, denied_file};
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{UnixListener, UnixStream};
use tokio::time::timeout;

/// How long one exchange may take; the next one waits meanwhile.
const EXCHANGE_MAX: Duration = Duration::from_secs(1);
/// Pause after accept(2) failed, as it does when file descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Applies the operator's requests, and keeps in files what must outlive one bridge process.
pub struct Control<S> {
    bridge: Rc<Bridge>,
    storage: S,
    /// The file of the allow list; `None` if addresses are not remembered.
    allowed: Option<PathBuf>,
    /// The file of the addresses that may not drive.
    denied: PathBuf,
    files: SavedFiles<S>,
}

impl<S: Storage> Control<S> {
    /// Applies to the bridge what the files say.
    pub fn new(bridge: Rc<Bridge>, run: &Run, storage: S, now: Monotonic) -> Self {
        let allowed = run.config.bridge.remember.then(|| allowed::file(run));
        if let Some(path) = &allowed {
            read_addresses(&storage, path).into_iter().for_each(|address| bridge.allow(address));
        }
        let files = SavedFiles::restore(&bridge, run, storage.clone(), now);
        let denied = denied_file(run);
        read_addresses(&storage, &denied).into_iter().for_each(|address| bridge.deny(address));
        Self { bridge, storage, allowed, denied, files }
    }

    /// Saves in files what has changed, and sets the emergency stop if `mr-slam stop` has written it. Call it often.
    pub fn update_files(&mut self, now: Monotonic) {
        self.files.update(&self.bridge, now);
    }

    /// Applies a request and returns the state after it.
    pub fn apply(&mut self, request: Request, now: Monotonic) -> Reply {
        // What was written on the disk before this request comes first.
        self.update_files(now);
        match request {
            Request::State => {}
            Request::Allow(address) => self.bridge.allow(address),
            Request::Deny(address) => self.bridge.deny(address),
            Request::Stop => self.bridge.stop_robots(),
            Request::Release => self.bridge.release_stop(),
            Request::Drop(which) if self.bridge.drop_clients(which) == 0 => {
                return Err("no such client is connected, see `mr-slam clients`".into());
            }
            Request::Drop(_) => {}
        }
        self.update_files(now);
        if let Request::Allow(address) | Request::Deny(address) = request {
            self.remember(address, matches!(request, Request::Allow(_)))
                .map_err(|why| format!("done, but not for later: {why}"))?;
        }
        Ok(self.bridge_state(now))
    }

    /// Writes a permission into the files of those who may drive and of those who may not.
    fn remember(&self, address: IpAddr, may_drive: bool) -> io::Result<()> {
        let allowed = self.allowed.iter().map(|path| (path, may_drive));
        allowed.chain([(&self.denied, !may_drive)]).try_for_each(|(path, is_listed)| {
            allowed::remember(&self.storage, path, address, is_listed)
                .map_err(|why| io::Error::other(format!("{}: {why}", path.display())))
        })
    }

    fn bridge_state(&self, now: Monotonic) -> BridgeState {
        BridgeState {
            stopped: self.bridge.is_stopped(),
            selected: self.bridge.selected_robot().number(),
            waiting: self.bridge.waiting_addresses(),
            allowed: self.bridge.allowed_addresses(),
            clients: self.bridge.clients(now),
        }
    }
}

/// Reads a list of addresses, and reports what cannot be read.
fn read_addresses(storage: &impl Storage, path: &Path) -> Vec<IpAddr> {
    match allowed::read(storage, path) {
        Ok((addresses, unsound)) => {
            unsound.iter().for_each(|line| {
                tracing::warn!("{}: `{line}` is not an address and is ignored", path.display())
            });
            addresses
        }
        Err(why) => {
            tracing::warn!("{}: {why}; no address is taken from it", path.display());
            Vec::new()
        }
    }
}

/// Opens the control socket. An earlier bridge process may have left its socket file behind.
pub fn listen(run: &Run) -> io::Result<UnixListener> {
    let path = control::socket(run);
    let _ = std::fs::remove_file(&path);
    UnixListener::bind(path)
}

/// Answers requests one after the other.
pub async fn serve(listener: UnixListener, control: Rc<std::cell::RefCell<Control<impl Storage>>>) {
    loop {
        match listener.accept().await {
            // A peer that sends no valid request in time is disconnected.
            Ok((stream, _)) => drop(timeout(EXCHANGE_MAX, exchange(stream, &control)).await),
            Err(_) => tokio::time::sleep(ACCEPT_PAUSE).await,
        }
    }
}

async fn exchange(
    mut stream: UnixStream,
    control: &std::cell::RefCell<Control<impl Storage>>,
) -> io::Result<()> {
    let (read, mut write) = stream.split();
    let mut line = String::new();
    BufReader::new(read.take(LINE_MAX)).read_line(&mut line).await?;
    let reply: Reply = match serde_json::from_str(&line) {
        Ok(request) => control.borrow_mut().apply(request, now()),
        Err(why) => Err(format!("not a request: {why}")),
    };
    let answer = serde_json::to_string(&reply)? + "\n";
    write.write_all(answer.as_bytes()).await
}
