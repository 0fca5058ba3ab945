//! The live bridge process: the tokio tasks that call its components, the TCP port and the control socket.

use super::feeds::Feed;
use super::{BridgeProcess, PeriodicTasks, page};
use crate::clock::now;
use crate::config::RobotSource;
use crate::event_loop;
use crate::nasa_tlx;
use crate::offered_room;
use crate::ports::Ports;
use crate::process::control::files::{FileThread, FileWorker};
use crate::process::{Error, ProcessLoop, control, ros2};
use crate::progress::{ProgressCounter, WatchedThread};
use crate::run::Run;
use crate::shared_memory::{Listener, Participant};
use crate::stop::Stop;
use crate::storage::DiskStorage;
use ::bridge::{PageListeners, serve_clients};
use msg::Role;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::Notify;
use tokio::task::{JoinHandle, spawn_local};

/// Period at which the process checks whether it is to stop.
const STOP_POLL_PERIOD: Duration = Duration::from_millis(100);

/// Runs the bridge process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let listeners = PageListeners::open(&run.config.bridge.page);
    let participant = run.attach(Role::Bridge, None)?;
    let mut result = Ok(());
    event_loop::run(Box::pin(async { result = serve(&participant, run, stop, listeners).await }))?;
    result
}

async fn serve(
    participant: &Participant,
    run: &Run,
    stop: &Stop,
    listeners: PageListeners,
) -> Result<(), Error> {
    let BridgeProcess { bridge, feeds, periodic_tasks, operator_acted } =
        BridgeProcess::open(participant, run, DiskStorage, FileThread::start)?;
    let mut tasks = start_feeds(feeds)?;
    let is_in_ros = run.config.bridge.dds.enabled;
    let endpoint = is_in_ros.then(|| ros2::open(run, stop, &bridge)).transpose()?;
    if run.config.bridge.page.enabled {
        let room = (run.config.world == RobotSource::Simulator).then(|| offered_room::file(run));
        let (config, save_tlx) = (run.config.bridge.page.clone(), nasa_tlx::saver(run));
        let run_id = page::run_id(run.pid, run.begun);
        let page = page::serve(bridge.clone(), config, run_id, room, Some(save_tlx), listeners);
        tasks.push(spawn_local(page));
    }
    tasks.push(spawn_local(control::serve(control::listen(run)?, periodic_tasks.control.clone())));
    tasks.push(spawn_local(run_periodic_tasks(periodic_tasks, operator_acted)));
    let progress = run.progress(Role::Bridge, None, WatchedThread::Main);
    serve_clients(bridge, inherited_listener()?, now, stop_requested(stop.clone(), progress)).await;
    if let Some(endpoint) = endpoint {
        endpoint.task.abort();
        endpoint.leave().await;
    }
    tasks.iter().for_each(JoinHandle::abort);
    Ok(())
}

/// Starts tasks that call each feed whenever its channel is written or it is due.
pub fn start_feeds(feeds: Vec<Feed<Listener>>) -> Result<Vec<JoinHandle<()>>, Error> {
    let steps = feeds.into_iter().map(|Feed { listener, step }| (listener, step)).collect();
    let cannot_wait = |why| format!("cannot wait for a channel's notifications: {why}");
    Ok(event_loop::start(steps).map_err(cannot_wait)?)
}

/// Returns the socket that the launcher listens on and passes down as standard input.
fn inherited_listener() -> std::io::Result<TcpListener> {
    let listener = std::net::TcpListener::from(std::io::stdin().as_fd().try_clone_to_owned()?);
    listener.local_addr().map_err(|why| {
        std::io::Error::other(format!(
            "standard input is not a listening socket ({why}); start the bridge with `mr-slam up`"
        ))
    })?;
    listener.set_nonblocking(true)?;
    TcpListener::from_std(listener)
}

/// Waits until the process is asked to stop, and counts the calling thread's progress meanwhile.
pub async fn stop_requested(stop: Stop, mut progress: ProgressCounter) {
    while !stop.requested() {
        progress.advance();
        event_loop::sleep_until(now().next_multiple(STOP_POLL_PERIOD)).await;
    }
}

/// Runs the periodic tasks whenever they are due, and at once when an operator acted: an emergency stop is saved before the process
/// can die. It is a task of its own, so that robots stop in time whatever clients do.
async fn run_periodic_tasks<P: Ports, W: FileWorker>(
    mut periodic_tasks: PeriodicTasks<P, W>,
    operator_acted: Rc<Notify>,
) {
    loop {
        let due = periodic_tasks.step();
        tokio::select! {
            () = event_loop::sleep_until(due) => {}
            () = operator_acted.notified() => {}
        }
    }
}
