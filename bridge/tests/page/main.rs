//! The operator's page from outside: HTTP requests and WebSockets on a real port.

mod battery;
mod browser;
mod driving;
mod http;
mod https;
mod room;
mod services;
mod tlx;
mod topics;

use bridge::{
    Bridge, BridgeConfig, PageConfig, PageContent, PageFile, TlxAnswer, TlxError, process_clock, serve,
    serve_page,
};
use msg::{RobotId, VelocityCommand};
use std::cell::RefCell;
use std::future::{pending, ready};
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::pin::Pin;
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};
use tokio::task::LocalSet;

/// The page of the tests.
const FILES: &[PageFile] =
    &[PageFile { path: "/", content_type: "text/html; charset=utf-8", bytes: b"<!doctype html>" }];

thread_local! {
    /// The newest room that was saved, on the bridge's thread.
    static SAVED_ROOM: RefCell<Option<Vec<u8>>> = const { RefCell::new(None) };
    /// The newest answer about workload that was saved.
    static SAVED_TLX: RefCell<Option<TlxAnswer>> = const { RefCell::new(None) };
}

fn content() -> PageContent {
    let save = |room: Vec<u8>| -> Pin<Box<dyn Future<Output = io::Result<()>>>> {
        SAVED_ROOM.set(Some(room));
        Box::pin(ready(Ok(())))
    };
    let save_tlx = |answer: TlxAnswer| -> Pin<Box<dyn Future<Output = Result<(), TlxError>>>> {
        SAVED_TLX.set(Some(answer));
        Box::pin(ready(Ok(())))
    };
    PageContent {
        files: FILES,
        save_room: Some(Rc::new(save)),
        save_tlx: Some(Rc::new(save_tlx)),
        run_id: "7-42".into(),
    }
}

/// Something to do on the bridge's thread.
type Job = Box<dyn FnOnce(&Bridge) + Send>;
/// Where velocities for robots go.
type CommandSink = Box<dyn FnMut(RobotId, VelocityCommand)>;

/// A bridge on a thread of its own.
pub(crate) struct Served {
    /// Address of the page.
    pub(crate) page: SocketAddr,
    /// Address of the page over HTTPS.
    pub(crate) encrypted: SocketAddr,
    /// Velocities that robots have got: robot, m/s, rad/s.
    pub(crate) velocities: Arc<Mutex<Vec<(usize, f64, f64)>>>,
    jobs: Option<mpsc::UnboundedSender<Job>>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    /// Starts a bridge of two robots.
    pub(crate) fn start(config: BridgeConfig) -> Self {
        let page_config = config.page.clone();
        Self::start_bridge(page_config, |on_command| Bridge::new(config, 2, on_command).unwrap())
    }

    /// Starts the bridge that `make` returns for the sink of its velocities.
    pub(crate) fn start_bridge(
        page_config: PageConfig,
        make: impl FnOnce(CommandSink) -> Bridge + Send + 'static,
    ) -> Self {
        let velocities = Arc::new(Mutex::new(Vec::new()));
        let (jobs, received) = mpsc::unbounded_channel();
        let (send_address, address) = std::sync::mpsc::channel();
        let sink = velocities.clone();
        let on_command = move |robot: RobotId, command: VelocityCommand| {
            sink.lock().unwrap().push((robot.number(), command.linear_m_s, command.angular_rad_s));
        };
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            LocalSet::new().block_on(&runtime, async {
                let bridge = Rc::new(make(Box::new(on_command)));
                let tcp = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
                let page = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
                let encrypted = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
                send_address.send((page.local_addr().unwrap(), encrypted.local_addr().unwrap())).unwrap();
                let (of_bridge, of_config) = (bridge.clone(), page_config.clone());
                let encrypted = tokio::task::spawn_local(async move {
                    let acceptor = Some(https::acceptor());
                    serve_page(
                        of_bridge,
                        encrypted,
                        acceptor,
                        &of_config,
                        content(),
                        process_clock,
                        pending(),
                    )
                    .await;
                });
                let (stop, stopped) = oneshot::channel::<()>();
                let stopped = async move { drop(stopped.await) };
                let server = tokio::task::spawn_local(serve(bridge.clone(), tcp, process_clock, stopped));
                let jobs = run_jobs(bridge.clone(), received);
                serve_page(bridge, page, None, &page_config, content(), process_clock, jobs).await;
                encrypted.abort();
                drop(stop);
                server.await.unwrap();
            });
        });
        let (page, encrypted) = address.recv().unwrap();
        Self { page, encrypted, velocities, jobs: Some(jobs), thread: Some(thread) }
    }

    /// Does something on the bridge's thread, and waits until it is done.
    pub(crate) fn with<T: Send + 'static>(&self, job: impl FnOnce(&Bridge) -> T + Send + 'static) -> T {
        let (send, done) = std::sync::mpsc::channel();
        let job: Job = Box::new(move |bridge| drop(send.send(job(bridge))));
        assert!(self.jobs.as_ref().unwrap().send(job).is_ok());
        done.recv_timeout(browser::WAIT_MAX).unwrap()
    }

    /// Waits until the velocities that robots have got are as wanted.
    pub(crate) fn wait_for(&self, is_wanted: impl Fn(&[(usize, f64, f64)]) -> bool) {
        let begun = std::time::Instant::now();
        while !is_wanted(&self.velocities.lock().unwrap()) {
            assert!(begun.elapsed() < browser::WAIT_MAX, "{:?}", self.velocities.lock().unwrap());
            std::thread::yield_now();
        }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        drop(self.jobs.take());
        let result = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || result.is_none_or(|result| result.is_ok()));
    }
}

async fn run_jobs(bridge: Rc<Bridge>, mut jobs: mpsc::UnboundedReceiver<Job>) {
    while let Some(job) = jobs.recv().await {
        job(&bridge);
    }
}
