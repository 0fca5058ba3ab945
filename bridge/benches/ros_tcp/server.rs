//! The bridge that the bench measures.

use bridge::{Bridge, BridgeConfig, process_clock, serve};
use std::net::{Ipv4Addr, SocketAddr};
use std::rc::Rc;
use std::sync::mpsc;
use std::thread;
use std::time::Instant;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tokio::task::LocalSet;

/// Robots of the bridge's fleet.
pub const ROBOTS: usize = 3;
/// Something to do on the bridge's thread.
pub type Job = Box<dyn FnOnce(&Bridge) + Send>;

/// A bridge on a thread of its own that runs jobs.
pub struct Server {
    /// Where it listens.
    pub address: SocketAddr,
    /// Jobs for its thread.
    pub jobs: UnboundedSender<Job>,
    /// When each velocity reached the robots.
    pub commands: mpsc::Receiver<Instant>,
}

impl Server {
    pub fn start() -> Self {
        let (command_times, commands) = mpsc::channel();
        let (jobs, mut todo) = unbounded_channel::<Job>();
        let (send_address, address) = mpsc::channel();
        thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            LocalSet::new().block_on(&runtime, async move {
                let on_command = move |_, _| {
                    let _ = command_times.send(Instant::now());
                };
                let bridge = Rc::new(Bridge::new(BridgeConfig::default(), ROBOTS, on_command).unwrap());
                let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
                send_address.send(listener.local_addr().unwrap()).unwrap();
                tokio::task::spawn_local(serve(
                    bridge.clone(),
                    listener,
                    process_clock,
                    std::future::pending(),
                ));
                while let Some(job) = todo.recv().await {
                    job(&bridge);
                }
            });
        });
        Self { address: address.recv().unwrap(), jobs, commands }
    }

    /// Runs a question on the bridge's thread and waits for its answer.
    pub fn ask<T: Send + 'static>(&self, question: impl FnOnce(&Bridge) -> T + Send + 'static) -> T {
        let (send, answer) = mpsc::channel();
        let job: Job = Box::new(move |bridge| drop(send.send(question(bridge))));
        self.jobs.send(job).unwrap();
        answer.recv().unwrap()
    }
}
