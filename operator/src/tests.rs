//! The operator against the real bridge, with a small world behind it, over TCP on loopback.

use super::rehearsal::World;
use super::*;
use bridge::{Bridge, BridgeConfig, process_clock, serve};
use std::cell::RefCell;
use std::net::SocketAddr;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::mpsc;
use tokio::net::TcpListener;
use tokio::task::LocalSet;

fn args(port: u16) -> OperatorArgs {
    OperatorArgs {
        mode: OperatorMode::Tour,
        host: "127.0.0.1".into(),
        port,
        robots: None,
        seconds: Some(60.0),
        turn_seconds: Some(0.5),
        all_at_once: false,
        seed: 1,
        json: false,
        launcher_pid: None,
    }
}

/// A world behind a bridge on a thread of its own, until `enough` of it.
struct Fleet {
    port: u16,
    thread: std::thread::JoinHandle<()>,
}

fn fleet(robots: usize, stop: Arc<AtomicBool>, enough: impl Fn(&World) -> bool + Send + 'static) -> Fleet {
    let (ready, port) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        LocalSet::new().block_on(&runtime, async move {
            let world = Rc::new(RefCell::new(World::new(robots, 3)));
            let obeying = world.clone();
            let bridge = Bridge::new(BridgeConfig::default(), robots, move |robot, command| {
                obeying.borrow_mut().obey(robot, &command);
            });
            let bridge = Rc::new(bridge.unwrap());
            let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await.unwrap();
            ready.send(listener.local_addr().unwrap().port()).unwrap();
            let (over, until) = tokio::sync::oneshot::channel::<()>();
            let serving = tokio::task::spawn_local(serve(bridge.clone(), listener, process_clock, async {
                let _ = until.await;
            }));
            live(&bridge, &world, &stop, enough).await;
            let _ = over.send(());
            serving.await.unwrap();
        });
    });
    Fleet { port: port.recv().unwrap(), thread }
}

/// 20 steps a second: all the fleet would send.
async fn live(bridge: &Bridge, world: &RefCell<World>, stop: &AtomicBool, enough: impl Fn(&World) -> bool) {
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    let mut enough_at = None;
    for step in 0_u64.. {
        ticks.tick().await;
        let now = Stamp(step as i64 * 50_000_000);
        world.borrow_mut().step(step);
        world.borrow().tell(bridge, step, now);
        if enough_at.is_none() && enough(&world.borrow()) {
            enough_at = Some(step);
            stop.store(true, Ordering::Relaxed);
        }
        // Some more, so that the operator's last word arrives.
        if enough_at.is_some_and(|at| step > at + 20) {
            return;
        }
    }
}

#[test]
fn drives_the_robots_of_a_bridge_one_after_the_other() {
    let stop = Arc::new(AtomicBool::new(false));
    let turned = |world: &World| (0..2).all(|i| world.turned_rad(i).abs() > 0.3);
    let fleet = fleet(2, stop.clone(), turned);
    let report = run(&args(fleet.port), &stop).unwrap();
    fleet.thread.join().unwrap();
    assert!(report.seconds < 60.0, "not both robots moved: {report:?}");
    assert_eq!(report.robots.iter().map(|r| r.robot).collect::<Vec<_>>(), [1, 2]);
    assert!(report.robots.iter().all(|r| r.turns >= 1), "{report:?}");
    assert!(report.commands > 10);
    let link = &report.link;
    assert_eq!((link.connections, link.undecodable, link.tf.lost), (1, 0, 0));
    assert_eq!(link.scans.len(), 2);
    assert!(link.scans.iter().all(|s| s.scans.lost == 0 && s.scans.received > 5), "{:?}", link.scans);
    // odom -> base_footprint of each; map -> map_K -> odom_K of each.
    assert_eq!((link.tf.streams, link.slam_tf.streams), (2, 4));
    assert!(report.map.unwrap().free_m2 > 0.5);
    assert!(report.notices.is_empty(), "{:?}", report.notices);
    assert!(serde_json::to_string(&report).unwrap().contains("jitter_ms"));
    assert!(report.to_string().contains("merged map"));
}

#[test]
fn drives_all_robots_at_once() {
    let stop = Arc::new(AtomicBool::new(false));
    let turned = |world: &World| (0..3).all(|i| world.turned_rad(i).abs() > 0.3);
    let fleet = fleet(3, stop.clone(), turned);
    let report = run(&OperatorArgs { all_at_once: true, ..args(fleet.port) }, &stop).unwrap();
    fleet.thread.join().unwrap();
    assert!(report.seconds < 60.0, "not all robots moved: {report:?}");
    assert_eq!(report.robots.len(), 3);
    assert!(report.notices.is_empty(), "{:?}", report.notices);
}

#[test]
fn says_what_is_missing() {
    let stop = AtomicBool::new(false);
    let short = |port| OperatorArgs { seconds: Some(0.3), ..args(port) };
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let error = run(&short(nobody), &stop).unwrap_err();
    assert!(matches!(error, OperatorError::NoLink { port, .. } if port == nobody), "{error}");
    assert!(error.to_string().contains("mr-slam up"), "{error}");
    let error = run(&OperatorArgs { seconds: Some(f64::NAN), ..args(nobody) }, &stop).unwrap_err();
    assert!(error.to_string().contains("--seconds is NaN"), "{error}");
}
