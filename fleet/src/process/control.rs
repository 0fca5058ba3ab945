//! The bridge's control socket, for the operator at the laptop: see [`crate::control`].

pub mod files;
mod permission_files;
pub mod saved_state;

use crate::clock::now;
use crate::control::{self, LINE_MAX, Reply, Request};
use crate::run::Run;
use crate::storage::Storage;
use ::bridge::{AddressListFull, Bridge, PeerAddressError, check_peer_address};
use files::{ControlFiles, FileJob, FileReport, FileWorker};
use msg::Monotonic;
use permission_files::PermissionFiles;
use reports::BridgeState;
use saved_state::{BridgeSnapshot, SavedFiles};
use std::cell::RefCell;
use std::io;
use std::rc::Rc;
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::oneshot::{self, error::TryRecvError};
use tokio::time::timeout;

/// How long one exchange may take; the next one waits meanwhile.
const EXCHANGE_MAX: Duration = Duration::from_secs(1);
/// Pause after accept(2) failed, as it does when file descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);
/// Period at which the stop's file is read. `mr-slam stop` asks the bridge as well; the file counts if that fails.
const STOP_FILE_POLL_PERIOD: Duration = Duration::from_millis(200);

/// What is said of a request that was done, and that the thread of the files has no room for.
const NOT_IN_FILES: &str = "a restarted bridge may not know it";

/// A request was not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum RequestError {
    /// Too many requests wait for the files.
    #[error("the disk of the run's folder does not answer; try again")]
    DiskBusy,
    /// No client has the address.
    #[error(transparent)]
    Address(#[from] PeerAddressError),
    /// As many addresses are listed as are kept.
    #[error(transparent)]
    ListFull(#[from] AddressListFull),
    /// No connection is the one that was named.
    #[error("no such client is connected, see `mr-slam clients`")]
    NoSuchClient,
}

/// Applies the operator's requests, and keeps in files what must outlive one bridge process.
pub struct Control<W> {
    bridge: Rc<Bridge>,
    files: W,
    run_begun: Monotonic,
    /// The update of the files that is under way.
    update: Option<oneshot::Receiver<FileReport>>,
    /// What the newest update has saved.
    submitted: Option<BridgeSnapshot>,
    /// When the stop's file is read again, even if nothing is to be saved.
    poll_due: Monotonic,
    /// Number of stops found in the files that the bridge has set.
    stops_applied: u64,
    /// Why the newest update is not in the files, if it is not.
    not_saved: Option<String>,
}

/// Applies to the bridge what the files of its run say, and returns them.
pub fn restore_files<S: Storage>(bridge: &Bridge, run: &Run, storage: S, now: Monotonic) -> ControlFiles<S> {
    let permissions = PermissionFiles::new(run, storage.clone());
    permissions.allow(bridge);
    let saved = SavedFiles::restore(bridge, run, storage, now);
    permissions.deny(bridge);
    ControlFiles { saved, permissions }
}

impl<W: FileWorker> Control<W> {
    /// Creates the control of a bridge whose files are restored.
    pub fn new(bridge: Rc<Bridge>, run: &Run, files: W) -> Self {
        Self {
            bridge,
            files,
            run_begun: run.begun,
            update: None,
            submitted: None,
            poll_due: Monotonic(0),
            stops_applied: 0,
            not_saved: None,
        }
    }

    /// Has saved what has changed, and sets the emergency stop if `mr-slam stop` has written it. Never waits for the disk.
    /// Call it often.
    pub fn update_files(&mut self, now: Monotonic) {
        self.finish_update();
        if self.update.is_some() {
            return;
        }
        let snapshot = self.snapshot(now);
        if now >= self.poll_due || self.submitted.as_ref() != Some(&snapshot) {
            self.poll_due = now.next_multiple(STOP_FILE_POLL_PERIOD);
            self.update = Some(self.submit_update(snapshot));
            self.finish_update();
        }
    }

    fn snapshot(&self, now: Monotonic) -> BridgeSnapshot {
        BridgeSnapshot::take(&self.bridge, self.run_begun, self.stops_applied, now)
    }

    fn submit_update(&mut self, snapshot: BridgeSnapshot) -> oneshot::Receiver<FileReport> {
        self.submitted = Some(snapshot.clone());
        self.files.submit(FileJob::Update(snapshot))
    }

    /// Takes the report of the update that is under way, if it has come.
    fn finish_update(&mut self) {
        match self.update.as_mut().map(oneshot::Receiver::try_recv) {
            Some(Ok(report)) => self.apply_report(&report),
            Some(Err(TryRecvError::Empty)) | None => return,
            // It was refused: it is tried again at once.
            Some(Err(TryRecvError::Closed)) => self.submitted = None,
        }
        self.update = None;
    }

    fn apply_report(&mut self, report: &FileReport) {
        self.not_saved = report.result.as_ref().err().map(ToString::to_string);
        if self.not_saved.is_some() {
            // What could not be written is tried again at once.
            self.submitted = None;
        }
        if report.stops_found > self.stops_applied {
            self.stops_applied = report.stops_found;
            self.bridge.stop_robots();
        }
    }

    /// Applies a request at this time: pauses of navigation are numbered by it, above goals that other programs have sent before.
    fn apply(&self, request: Request, now: Monotonic) -> Result<(), RequestError> {
        self.bridge.tick(now);
        match request {
            Request::State => {}
            Request::Allow(address) => self.bridge.allow(check_peer_address(address)?)?,
            Request::Deny(address) => self.bridge.deny(check_peer_address(address)?)?,
            Request::AnswerRoom => self.bridge.answer_room(),
            Request::Stop => self.bridge.stop_robots(),
            Request::Release => self.bridge.release_stop(),
            Request::Drop(which) if self.bridge.drop_clients(which) == 0 => {
                return Err(RequestError::NoSuchClient);
            }
            Request::Drop(_) => {}
        }
        Ok(())
    }

    fn bridge_state(&self, now: Monotonic) -> BridgeState {
        BridgeState {
            stopped: self.bridge.is_stopped(),
            interruptions: self.bridge.interruptions(),
            driven_by_client: self.bridge.is_driven_by_client(now),
            selected: self.bridge.selected_robot().number(),
            waiting: self.bridge.waiting_addresses(),
            unlisted_requests: self.bridge.unlisted_requests(),
            allowed: self.bridge.allowed_addresses(),
            denied: self.bridge.denied_addresses(),
            clients: self.bridge.clients(now),
            room_offer: self.bridge.room_offer(),
            batteries: self.bridge.batteries(now),
            not_saved: self.not_saved.clone(),
        }
    }
}

/// Applies a request and returns the state after it. A stop is set before anything else; other changes wait for the disk. What was
/// done and could not be saved is in [`BridgeState::not_saved`].
pub async fn answer<W: FileWorker>(
    control: &RefCell<Control<W>>,
    request: Request,
    clock: impl Fn() -> Monotonic,
) -> Reply {
    let changed = change(control, request, &clock).await;
    let is_withdrawn = matches!(changed, Err(RequestError::ListFull(AddressListFull::Denied(_))));
    let (busy, refused) = match changed {
        Ok(busy) => (busy, None),
        // Its permission is withdrawn, in the files too.
        Err(why) if is_withdrawn => (None, Some(why.to_string())),
        Err(why) => return Err(why.to_string()),
    };
    let mut unsaved: Vec<String> = busy.map(|busy| format!("{NOT_IN_FILES}: {busy}")).into_iter().collect();
    if let Request::Allow(address) | Request::Deny(address) = request {
        let may_drive = matches!(request, Request::Allow(_));
        let report = control.borrow_mut().files.submit(FileJob::Remember { address, may_drive });
        let result = report
            .await
            .map_or_else(|_| Err(io::Error::other(RequestError::DiskBusy)), |report| report.result);
        let after = if may_drive { "may ask for its permission again" } else { "may drive" };
        unsaved.extend(result.err().map(|why| format!("{why}; after a restart {address} {after}")));
    }
    if let Some(why) = refused {
        return Err(why);
    }
    let mut state = control.borrow().bridge_state(clock());
    unsaved.extend(state.not_saved.take());
    state.not_saved = (!unsaved.is_empty()).then(|| unsaved.join("; "));
    Ok(state)
}

/// Applies a request. Returns why its outcome is not in the files if nobody could write them; what the disk refused is in
/// [`Control::not_saved`].
///
/// Errors: the request is not applied, but for a denial without a place among the denied, which withdraws the permission.
async fn change<W: FileWorker>(
    control: &RefCell<Control<W>>,
    request: Request,
    clock: impl Fn() -> Monotonic,
) -> Result<Option<RequestError>, RequestError> {
    match request {
        Request::State => return Ok(None),
        // Nobody drives on, or keeps a connection, while the disk is slow.
        Request::Stop | Request::Deny(_) | Request::Drop(_) => {}
        // What was written on the disk before this request comes first.
        _ => save(control, clock()).await?,
    }
    let applied = control.borrow().apply(request, clock());
    if matches!(applied, Err(RequestError::ListFull(AddressListFull::Denied(_)))) {
        // The permission is withdrawn, which must be saved.
        let _ = save(control, clock()).await;
    }
    applied?;
    Ok(save(control, clock()).await.err())
}

/// Brings the files and the bridge together, and waits for it. Errors: the job was refused; [`Control::not_saved`] has what the disk
/// refused.
async fn save<W: FileWorker>(control: &RefCell<Control<W>>, now: Monotonic) -> Result<(), RequestError> {
    let report = {
        let mut control = control.borrow_mut();
        let snapshot = control.snapshot(now);
        control.submit_update(snapshot)
    };
    let report = report.await.map_err(|_| RequestError::DiskBusy)?;
    control.borrow_mut().apply_report(&report);
    Ok(())
}

/// Opens the control socket. An earlier bridge process may have left its socket file behind.
pub fn listen(run: &Run) -> io::Result<UnixListener> {
    let path = control::socket(run);
    let _ = std::fs::remove_file(&path);
    UnixListener::bind(path)
}

/// Answers requests one after the other.
pub async fn serve(listener: UnixListener, control: Rc<RefCell<Control<impl FileWorker>>>) {
    loop {
        match listener.accept().await {
            // A peer that sends no valid request in time is disconnected.
            Ok((stream, _)) => drop(timeout(EXCHANGE_MAX, exchange(stream, &control)).await),
            Err(_) => tokio::time::sleep(ACCEPT_PAUSE).await,
        }
    }
}

async fn exchange(mut stream: UnixStream, control: &RefCell<Control<impl FileWorker>>) -> io::Result<()> {
    let (read, mut write) = stream.split();
    let mut line = String::new();
    BufReader::new(read.take(LINE_MAX)).read_line(&mut line).await?;
    let reply: Reply = match serde_json::from_str(&line) {
        Ok(request) => answer(control, request, now).await,
        Err(why) => Err(format!("not a request: {why}")),
    };
    let answer = serde_json::to_string(&reply)? + "\n";
    write.write_all(answer.as_bytes()).await
}

#[cfg(test)]
mod tests;
