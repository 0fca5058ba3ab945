//! The bridge's control socket, for the operator at the laptop: see [`crate::control`].

use crate::allowed;
use crate::clock::now;
use crate::control::{self, BridgeState, ClientView, LINE_MAX, Reply, Request};
use crate::run::Run;
use crate::storage::Storage;
use ::bridge::{Bridge, ClientStatus};
use std::io;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{UnixListener, UnixStream};
use tokio::time::timeout;

/// How long one exchange may take; the next one waits meanwhile.
const EXCHANGE_MAX: Duration = Duration::from_secs(1);
/// Pause after accept(2) failed, as it does when file descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);
/// Largest part of the emergency stop's file that is read, bytes: that it exists is enough.
const STOP_BYTES_MAX: u64 = 4096;

/// Applies the operator's requests, and keeps in files what must outlive one bridge process: the allow list and the
/// emergency stop.
pub struct Control<S> {
    bridge: Rc<Bridge>,
    storage: S,
    /// The file of the allow list; `None` if addresses are not remembered.
    allowed: Option<PathBuf>,
    /// A file that exists while the emergency stop is set.
    stop_file: PathBuf,
    /// Whether the file exists.
    stop_recorded: bool,
    /// Whether the person has been told that it cannot be recorded.
    has_warned: bool,
}

impl<S: Storage> Control<S> {
    /// Applies to the bridge what the files say.
    pub fn new(bridge: Rc<Bridge>, run: &Run, storage: S) -> Self {
        let allowed = run.config.bridge.remember.then(|| allowed::file(run));
        if let Some(path) = &allowed {
            match allowed::read(&storage, path) {
                Ok((addresses, unsound)) => {
                    addresses.into_iter().for_each(|address| bridge.allow(address));
                    unsound.iter().for_each(|line| {
                        tracing::warn!("{}: `{line}` is not an address and is ignored", path.display())
                    });
                }
                Err(why) => tracing::warn!("{}: {why}; no address is remembered", path.display()),
            }
        }
        let stop_file = run.dir.join("stopped");
        // A file that cannot be read may say that the stop is set.
        let stop_recorded = !matches!(storage.read(&stop_file, STOP_BYTES_MAX), Err(why) if why.kind() == io::ErrorKind::NotFound);
        if stop_recorded {
            bridge.stop_robots();
        }
        Self { bridge, storage, allowed, stop_file, stop_recorded, has_warned: false }
    }

    /// Records in a file whether the emergency stop is set: a restarted bridge must keep it. Call it often.
    pub fn record_stop(&mut self) {
        let is_stopped = self.bridge.is_stopped();
        if is_stopped == self.stop_recorded {
            return;
        }
        let result = match is_stopped {
            true => self.storage.write(&self.stop_file, b"The emergency stop is set.\n"),
            false => self.storage.remove(&self.stop_file),
        };
        match result {
            Ok(()) => (self.stop_recorded, self.has_warned) = (is_stopped, false),
            // It is tried again, and said once.
            Err(why) => {
                if !std::mem::replace(&mut self.has_warned, true) {
                    let path = self.stop_file.display();
                    tracing::warn!(
                        "{path}: {why}; a restarted bridge will not keep the emergency stop as it is"
                    );
                }
            }
        }
    }

    fn apply(&mut self, request: Request) -> Reply {
        match request {
            Request::State => {}
            Request::Allow(address) => self.bridge.allow(address),
            Request::Deny(address) => self.bridge.deny(address),
            Request::Stop => self.bridge.stop_robots(),
            Request::Release => self.bridge.release_stop(),
        }
        self.record_stop();
        if let (Request::Allow(address) | Request::Deny(address), Some(path)) = (request, &self.allowed) {
            let may_drive = matches!(request, Request::Allow(_));
            allowed::remember(&self.storage, path, address, may_drive)
                .map_err(|why| format!("done, but not for later runs: {}: {why}", path.display()))?;
        }
        Ok(self.bridge_state())
    }

    fn bridge_state(&self) -> BridgeState {
        let client = |status: ClientStatus| ClientView {
            address: status.peer,
            subscriptions: status.subscriptions,
            publications: status.publications,
            waiting_bytes: status.waiting_bytes,
            dropped: status.dropped,
            drives: status.drives.iter().map(|robot| robot.number()).collect(),
            clock: status.clock,
        };
        BridgeState {
            stopped: self.bridge.is_stopped(),
            selected: self.bridge.selected_robot().number(),
            waiting: self.bridge.waiting_addresses(),
            allowed: self.bridge.allowed_addresses(),
            clients: self.bridge.clients(now()).into_iter().map(client).collect(),
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
        Ok(request) => control.borrow_mut().apply(request),
        Err(why) => Err(format!("not a request: {why}")),
    };
    let answer = serde_json::to_string(&reply)? + "\n";
    write.write_all(answer.as_bytes()).await
}
