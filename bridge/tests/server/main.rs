//! The TCP server from outside: real sockets on free ports, well-behaved clients and others.

mod client;
mod driving;
mod initial_pose;
mod noise;
mod robustness;
mod services;
mod slow;
mod topics;
mod world;

use bridge::{Bridge, BridgeConfig, process_clock, serve};
use msg::{Header, ROBOTS_MAX, RobotId, Stamp, VelocityCommand};
use std::cell::RefCell;
use std::net::{Ipv4Addr, SocketAddr};
use std::rc::Rc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::LocalSet;

/// A test that takes longer waits for something that never happens.
const TEST_MAX: Duration = Duration::from_secs(120);

/// A bridge that serves on a port, and the velocities that it has sent: robot, m/s, rad/s. Repeated ones are left out,
/// and so are zeros for a robot that stands.
pub(crate) struct Served {
    pub(crate) bridge: Rc<Bridge>,
    pub(crate) address: SocketAddr,
    pub(crate) commands: Rc<RefCell<Vec<(usize, f64, f64)>>>,
}

/// Runs a test against a bridge of two robots, on which velocities stay valid longer than a loaded machine pauses.
pub(crate) fn with_bridge(mut config: BridgeConfig, test: impl AsyncFnOnce(&Served)) {
    config.velocity.timeout_s = 10.0;
    serve_bridge(|on_command| Bridge::new(config, 2, on_command).unwrap(), test);
}

/// Receives the velocities that robots get.
pub(crate) type OnCommand = Box<dyn FnMut(RobotId, VelocityCommand)>;

/// Runs a test against a bridge.
pub(crate) fn serve_bridge(make: impl FnOnce(OnCommand) -> Bridge, test: impl AsyncFnOnce(&Served)) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    LocalSet::new().block_on(&runtime, async {
        let commands = Rc::new(RefCell::new(Vec::new()));
        let sink = commands.clone();
        let mut last = [(0.0, 0.0); ROBOTS_MAX];
        let on_command = move |robot: RobotId, command: VelocityCommand| {
            let velocity = (command.linear_m_s, command.angular_rad_s);
            if std::mem::replace(&mut last[robot.index()], velocity) != velocity {
                sink.borrow_mut().push((robot.number(), velocity.0, velocity.1));
            }
        };
        let bridge = Rc::new(make(Box::new(on_command)));
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let stopped = async move { drop(stopped.await) };
        let server = tokio::task::spawn_local(serve(bridge.clone(), listener, process_clock, stopped));
        let served = Served { bridge, address, commands };
        tokio::time::timeout(TEST_MAX, test(&served)).await.expect("the test takes too long");
        drop(stop);
        server.await.unwrap();
    });
}

pub(crate) fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

pub(crate) fn header(stamp: i64) -> Header {
    Header { stamp: Stamp(stamp), ..Default::default() }
}
