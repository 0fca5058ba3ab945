//! A bridge on a thread of its own, with a test world in place of simulators, SLAM and merging.

use bridge::{Bridge, BridgeConfig, FleetMessage, RobotNames, process_clock, serve};
use msg::{Pose2, RobotFrame, RobotFrameTransform, RobotId, Scan, Stamp, Transforms};
use nav::Twist;
use nav::test_world::{RANGE_MAX_M, RANGE_MIN_M, TestWorld, beam_angle_rad};
use std::cell::RefCell;
use std::net::SocketAddr;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::LocalSet;

/// Period of the world's steps.
const PERIOD: Duration = Duration::from_millis(50);
/// Steps between two scans of a robot, and between two merged maps.
const SCAN_STEPS: u64 = 2;
const MAP_STEPS: u64 = 20;
/// Steps after the end of the test in which the operator's last command arrives.
const LAST_STEPS: u64 = 20;

pub(super) struct Fleet {
    pub(super) port: u16,
    pub(super) thread: std::thread::JoinHandle<()>,
}

/// Starts a bridge and its world; sets `stop` once the world is as `is_done` says.
pub(super) fn spawn_fleet(
    names: RobotNames,
    stop: Arc<AtomicBool>,
    is_done: impl Fn(&TestWorld) -> bool + Send + 'static,
) -> Fleet {
    spawn_fleet_with(BridgeConfig::default(), names, stop, move |world, _| is_done(world))
}

/// Starts a bridge with a configuration; `is_done` is asked at each step of the world.
pub(super) fn spawn_fleet_with(
    config: BridgeConfig,
    names: RobotNames,
    stop: Arc<AtomicBool>,
    is_done: impl Fn(&TestWorld, &Bridge) -> bool + Send + 'static,
) -> Fleet {
    let (ready, port) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        LocalSet::new().block_on(&runtime, async move {
            let world = Rc::new(RefCell::new(TestWorld::new(names.count(), 3)));
            let driven = world.clone();
            let bridge = Bridge::new(config, names, move |robot, command| {
                let (linear_m_s, angular_rad_s) = (command.linear_m_s, command.angular_rad_s);
                driven.borrow_mut().set_velocity(robot, Twist { linear_m_s, angular_rad_s });
            });
            let bridge = Rc::new(bridge.unwrap());
            let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await.unwrap();
            ready.send(listener.local_addr().unwrap().port()).unwrap();
            let (over, until) = tokio::sync::oneshot::channel::<()>();
            let serving = tokio::task::spawn_local(serve(bridge.clone(), listener, process_clock, async {
                let _ = until.await;
            }));
            run_world(&bridge, &world, &stop, is_done).await;
            let _ = over.send(());
            serving.await.unwrap();
        });
    });
    Fleet { port: port.recv().unwrap(), thread }
}

async fn run_world(
    bridge: &Bridge,
    world: &RefCell<TestWorld>,
    stop: &AtomicBool,
    is_done: impl Fn(&TestWorld, &Bridge) -> bool,
) {
    let mut ticks = tokio::time::interval(PERIOD);
    let mut done_at = None;
    for step in 0_u64.. {
        ticks.tick().await;
        let now = Stamp(step as i64 * PERIOD.as_nanos() as i64);
        world.borrow_mut().move_robots();
        if step.is_multiple_of(SCAN_STEPS) {
            world.borrow_mut().scan_and_map();
        }
        publish_world(&world.borrow(), bridge, step, now);
        if done_at.is_none() && is_done(&world.borrow(), bridge) {
            done_at = Some(step);
            stop.store(true, Ordering::Relaxed);
        }
        if done_at.is_some_and(|at| step > at + LAST_STEPS) {
            return;
        }
    }
}

/// Publishes what simulators, SLAM and merging would. Odometry is perfect, and all map frames are one.
fn publish_world(world: &TestWorld, bridge: &Bridge, step: u64, now: Stamp) {
    let header = msg::Header { stamp: now, ..Default::default() };
    let mut map_transforms = msg::MapTransforms { header, ..Default::default() };
    bridge.publish(FleetMessage::Clock(&msg::Clock { header }));
    for (i, robot) in RobotId::first(world.robot_count()).enumerate() {
        map_transforms.robots[i].known = 1;
        bridge.publish(FleetMessage::Transforms(robot, &transforms(header, world.pose(i))));
        if step.is_multiple_of(SCAN_STEPS) {
            bridge.publish(FleetMessage::Scan(robot, &scan(header, world.ranges_m(i))));
            let pose_estimate = msg::PoseEstimate { header, ..Default::default() };
            bridge.publish(FleetMessage::PoseEstimate(robot, &pose_estimate));
        }
    }
    bridge.publish(FleetMessage::MapTransforms(&map_transforms));
    if step.is_multiple_of(MAP_STEPS) {
        bridge.publish(FleetMessage::MergedMap(world.map().view()));
    }
}

fn transforms(header: msg::Header, odom_from_base: Pose2) -> Transforms {
    let (translation_m, rotation_xyzw) = bridge::ros::write::spatial(odom_from_base);
    let mut message = Transforms { header, len: 1, ..Default::default() };
    let (parent, child) = (RobotFrame::Odom as u32, RobotFrame::BaseFootprint as u32);
    message.transforms[0] =
        RobotFrameTransform { parent_frame: parent, child_frame: child, translation_m, rotation_xyzw };
    message
}

fn scan(header: msg::Header, ranges_m: &[f32]) -> Scan {
    let mut scan = Scan {
        header,
        angle_min_rad: beam_angle_rad(0) as f32,
        angle_increment_rad: (beam_angle_rad(1) - beam_angle_rad(0)) as f32,
        time_increment_s: 0.0,
        scan_time_s: 0.1,
        range_min_m: RANGE_MIN_M as f32,
        range_max_m: RANGE_MAX_M as f32,
        len: ranges_m.len() as u32,
        mount_known: 0,
        base_from_scan: msg::Pose2::IDENTITY,
        ranges_m: [f32::NAN; msg::BEAMS_MAX],
    };
    scan.ranges_m[..ranges_m.len()].copy_from_slice(ranges_m);
    scan
}
