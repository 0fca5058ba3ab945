//! A bridge with an artificial fleet: three robots on circles, at the rates of real ones.
//!
//! It serves clients and probes without the fleet's processes: `cargo run -p bridge --example serve -- --port 10000`.

use bridge::{Bridge, BridgeConfig, FleetMessage, process_clock, serve};
use bytemuck::Zeroable;
use msg::{
    Clock, FleetStats, GridHeader, GridView, Header, Odometry, Pose2, PoseEstimate, RobotFrame,
    RobotFrameTransform, RobotId, Scan, Stamp, Transforms,
};
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::task::LocalSet;
use tokio::time::{MissedTickBehavior, interval};

const ROBOTS: usize = 3;
/// Cells along a side of the maps.
const SIDE: u32 = 200;

fn main() -> std::io::Result<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let port =
        arguments.iter().skip_while(|a| *a != "--port").nth(1).and_then(|p| p.parse().ok()).unwrap_or(10_000);
    let quiet = arguments.iter().any(|a| a == "--no-fleet");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, async move {
        let bridge = Bridge::new(BridgeConfig::default(), ROBOTS, |robot, command| {
            println!("{robot}: {:.3} m/s, {:.3} rad/s", command.linear_m_s, command.angular_rad_s);
        });
        let bridge = Rc::new(bridge.map_err(std::io::Error::other)?);
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).await?;
        println!("ros_tcp on {}", listener.local_addr()?);
        if !quiet {
            tokio::task::spawn_local(fleet(bridge.clone()));
        }
        serve(bridge, listener, process_clock, std::future::pending()).await;
        Ok(())
    })
}

/// 100 ticks a second: clock at every one, transforms at 20 Hz, scans at 10 Hz, maps and statistics at 1 Hz.
async fn fleet(bridge: Rc<Bridge>) {
    let begin = Instant::now();
    let mut ticks = interval(Duration::from_millis(10));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let cells = vec![0_i8; (SIDE * SIDE) as usize];
    for tick in 0_u64.. {
        ticks.tick().await;
        let header = Header { stamp: Stamp(begin.elapsed().as_nanos() as i64), ..Header::default() };
        bridge.publish(FleetMessage::Clock(&Clock { header }));
        for robot in RobotId::first(ROBOTS) {
            let yaw = 0.2 * header.stamp.seconds();
            let place = Pose2::new(yaw.sin(), 1.0 - yaw.cos() + robot.number() as f64, yaw);
            if tick % 5 == robot.index() as u64 {
                bridge.publish(FleetMessage::Transforms(robot, &transforms(header, place)));
                bridge.publish(FleetMessage::Odometry(
                    robot,
                    &Odometry { header, odom_from_base: place, ..Odometry::default() },
                ));
            }
            if tick % 10 == robot.index() as u64 {
                bridge.publish(FleetMessage::Scan(robot, &scan(header)));
                let state = msg::TrackingState::Tracking as u32;
                bridge.publish(FleetMessage::PoseEstimate(
                    robot,
                    &PoseEstimate { header, state, ..PoseEstimate::default() },
                ));
            }
        }
        if tick % 100 == 7 {
            maps(&bridge, header, &cells);
        }
    }
}

fn transforms(header: Header, place: Pose2) -> Transforms {
    let (sin, cos) = (place.yaw_rad / 2.0).sin_cos();
    let mut message = Transforms { header, len: 2, ..Transforms::default() };
    message.transforms[0] = RobotFrameTransform {
        parent_frame: RobotFrame::Odom as u32,
        child_frame: RobotFrame::BaseFootprint as u32,
        translation_m: [place.x_m, place.y_m, 0.0],
        rotation_xyzw: [0.0, 0.0, sin, cos],
    };
    message.transforms[1] = RobotFrameTransform {
        parent_frame: RobotFrame::BaseFootprint as u32,
        child_frame: RobotFrame::BaseScan as u32,
        translation_m: [-0.032, 0.0, 0.182],
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
    };
    message
}

fn scan(header: Header) -> Scan {
    let mut scan = Scan { header, len: 180, range_min_m: 0.12, range_max_m: 3.5, ..Scan::zeroed() };
    scan.angle_min_rad = -0.785;
    scan.angle_increment_rad = 1.57 / 179.0;
    scan.ranges_m[..180].fill(1.5);
    scan
}

fn maps(bridge: &Bridge, header: Header, cells: &[i8]) {
    let shape = GridHeader { header, width: SIDE, height: SIDE, resolution_m: 0.05, ..GridHeader::default() };
    let Some(map) = GridView::new(&shape, cells) else { return };
    RobotId::first(ROBOTS).for_each(|robot| bridge.publish(FleetMessage::Map(robot, map)));
    bridge.publish(FleetMessage::MergedMap(map));
    bridge.publish(FleetMessage::Stats(&FleetStats {
        header,
        robot_count: ROBOTS as u32,
        ..FleetStats::default()
    }));
}
