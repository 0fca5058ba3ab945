//! The bridge's ear for the person at the laptop: see [`crate::control`].

use crate::allowed;
use crate::control::{self, BridgeState, ClientView, LINE_MAX, Reply, Request};
use crate::run::Run;
use ::bridge::{Bridge, ClientStatus};
use std::io;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{UnixListener, UnixStream};
use tokio::time::timeout;

/// How long one exchange may take; the next waits meanwhile.
const EXCHANGE_MAX: Duration = Duration::from_secs(1);
/// Pause after accept(2) failed, as it does when descriptors run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// What outlives one bridge process: who may drive, and that the fleet is stopped.
pub struct Control {
    bridge: Rc<Bridge>,
    allowed: Option<PathBuf>,
    /// Exists while the emergency stop is set.
    stop_mark: PathBuf,
    stopped: bool,
}

impl Control {
    /// Brings the bridge up to what was said before it began.
    pub fn new(bridge: Rc<Bridge>, run: &Run) -> Self {
        let allowed = run.config.bridge.remember.then(|| allowed::file(run));
        if let Some(path) = &allowed {
            match allowed::read(path) {
                Ok((addresses, unsound)) => {
                    addresses.into_iter().for_each(|address| bridge.allow(address));
                    unsound.iter().for_each(|line| {
                        eprintln!("{}: `{line}` is no address, and is passed over", path.display())
                    });
                }
                Err(why) => eprintln!("{}: {why}; nobody is remembered", path.display()),
            }
        }
        let stop_mark = run.dir.join("stopped");
        let stopped = stop_mark.exists();
        if stopped {
            bridge.stop();
        }
        Self { bridge, allowed, stop_mark, stopped }
    }

    /// Notes whether the fleet is stopped, whoever did it: a bridge that is started again must know. Call it often.
    pub fn look(&mut self) {
        let stopped = self.bridge.stopped();
        if stopped != self.stopped {
            self.stopped = stopped;
            let noted = match stopped {
                true => std::fs::write(&self.stop_mark, "The emergency stop is set.\n"),
                false => std::fs::remove_file(&self.stop_mark),
            };
            if let Err(why) = noted {
                eprintln!(
                    "{}: {why}; a bridge that is started again will not know",
                    self.stop_mark.display()
                );
            }
        }
    }

    fn obey(&mut self, request: Request) -> Reply {
        match request {
            Request::State => {}
            Request::Allow(address) => self.bridge.allow(address),
            Request::Deny(address) => self.bridge.deny(address),
            Request::Stop => self.bridge.stop(),
            Request::Release => self.bridge.release(),
        }
        self.look();
        if let (Request::Allow(address) | Request::Deny(address), Some(path)) = (request, &self.allowed) {
            let may_drive = matches!(request, Request::Allow(_));
            allowed::remember(path, address, may_drive)
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
            stopped: self.bridge.stopped(),
            selected: self.bridge.selected().number(),
            waiting: self.bridge.waiting(),
            allowed: self.bridge.allowed(),
            clients: self.bridge.clients().into_iter().map(client).collect(),
        }
    }
}

/// Where requests come in. The bridge before may have left its socket behind.
pub fn listen(run: &Run) -> io::Result<UnixListener> {
    let path = control::socket(run);
    let _ = std::fs::remove_file(&path);
    UnixListener::bind(path)
}

/// Answers one request after the other.
pub async fn serve(listener: UnixListener, control: Rc<std::cell::RefCell<Control>>) {
    loop {
        match listener.accept().await {
            // Whoever does not speak in time, or sense, is let go.
            Ok((stream, _)) => drop(timeout(EXCHANGE_MAX, exchange(stream, &control)).await),
            Err(_) => tokio::time::sleep(ACCEPT_PAUSE).await,
        }
    }
}

async fn exchange(mut stream: UnixStream, control: &std::cell::RefCell<Control>) -> io::Result<()> {
    let (read, mut write) = stream.split();
    let mut line = String::new();
    BufReader::new(read.take(LINE_MAX)).read_line(&mut line).await?;
    let reply: Reply = match serde_json::from_str(&line) {
        Ok(request) => control.borrow_mut().obey(request),
        Err(why) => Err(format!("no request: {why}")),
    };
    let answer = serde_json::to_string(&reply)? + "\n";
    write.write_all(answer.as_bytes()).await
}
