//! In steady state a message allocates nothing: neither on its way to two clients nor on its way in from one.

use bridge::command::{Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{Message, Twist, encode};
use bridge::{Bridge, BridgeConfig, FleetMessage, process_clock, serve, velocity_gate};
use bytemuck::Zeroable;
use msg::{Clock, FleetStats, GridHeader, GridView, Odometry, PoseEstimate, RobotId, Scan, Transforms};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::cell::Cell;
use std::net::{Ipv4Addr, SocketAddr};
use std::rc::Rc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::LocalSet;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const TOPICS: [(&str, &str); 7] = [
    ("/robot1/scan", "sensor_msgs/LaserScan"),
    ("/robot1/odom", "nav_msgs/Odometry"),
    ("/robot1/map", "nav_msgs/OccupancyGrid"),
    ("/robot1/slam_stats", "std_msgs/Float32MultiArray"),
    ("/tf", "tf2_msgs/TFMessage"),
    ("/clock", "rosgraph_msgs/Clock"),
    ("/cmd_vel", Twist::TYPE),
];
/// Frames of one round: one of each topic but the map, /tf has two.
const FRAMES: usize = TOPICS.len();
/// A map is sent every so many rounds: the bridge begins bulk frames only after pauses, which the test would wait for.
const ROUNDS_A_MAP: usize = 25;

struct Reader {
    stream: TcpStream,
    parser: Parser,
}

impl Reader {
    async fn connect(address: SocketAddr) -> Self {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.set_nodelay(true).unwrap();
        let mut out = Vec::new();
        for (topic, class) in TOPICS {
            let registration =
                Registration { topic: topic.into(), message_name: class.into(), ..Default::default() };
            Side::Client.write_command(&mut out, name::SUBSCRIBE, &registration);
        }
        let registration =
            Registration { topic: "/cmd_vel".into(), message_name: Twist::TYPE.into(), ..Default::default() };
        Side::Client.write_command(&mut out, name::PUBLISH, &registration);
        stream.write_all(&out).await.unwrap();
        let mut reader = Self { stream, parser: Parser::new(1 << 20) };
        reader.settle().await;
        reader
    }

    /// Reads all that the bridge has sent.
    async fn settle(&mut self) {
        let mut out = Vec::new();
        Side::Client.write_command(&mut out, name::TOPIC_LIST, &serde_json::json!({}));
        self.stream.write_all(&out).await.unwrap();
        while !self.next_is(b"__topic_list").await {}
    }

    async fn next_is(&mut self, name: &[u8]) -> bool {
        loop {
            if let Some(frame) = self.parser.next_frame().unwrap() {
                return frame.name == name;
            }
            let count = self.stream.read(self.parser.space()).await.unwrap();
            assert!(count > 0);
            self.parser.filled(count);
        }
    }
}

/// The test has no harness: the allocations of the harness's own thread would be counted too.
fn main() {
    a_message_in_steady_state_allocates_nothing();
}

fn a_message_in_steady_state_allocates_nothing() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    LocalSet::new().block_on(&runtime, async {
        let commands = Rc::new(Cell::new(0));
        let count = commands.clone();
        let on_command = move |robot: RobotId, _| {
            // The selected robot's; the others get the zeros of the start.
            count.set(count.get() + u32::from(robot.number() == 1));
        };
        let bridge = Rc::new(Bridge::new(BridgeConfig::default(), 3, on_command).unwrap());
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::task::spawn_local(serve(bridge.clone(), listener, process_clock, std::future::pending()));
        let mut readers = [Reader::connect(address).await, Reader::connect(address).await];

        let mut twist = Vec::new();
        Side::Client.write_with(&mut twist, "/cmd_vel", |out| encode(&Twist::default(), out));
        let scan = Box::new(Scan { len: 180, ..Scan::zeroed() });
        let cells = vec![0; 200 * 200];
        let robot = RobotId::new(1).unwrap();
        let stats = Box::new(FleetStats::default());
        // The robots' first zeros are over, which clients of /cmd_vel would receive.
        tokio::time::sleep(velocity_gate::STOP_REPEATED + Duration::from_millis(200)).await;
        for reader in &mut readers {
            reader.settle().await;
        }
        commands.set(0);
        let mut round = async |count: usize| {
            for index in 0..count {
                let maps = usize::from(index % ROUNDS_A_MAP == 0);
                bridge.publish(FleetMessage::Scan(robot, &scan));
                bridge.publish(FleetMessage::Odometry(robot, &Odometry::default()));
                let shape = GridHeader { width: 200, height: 200, resolution_m: 0.05, ..Default::default() };
                if maps > 0 {
                    bridge.publish(FleetMessage::Map(robot, GridView::new(&shape, &cells).unwrap()));
                }
                bridge.publish(FleetMessage::Stats(&stats));
                bridge.publish(FleetMessage::Transforms(robot, &Transforms::default()));
                bridge.publish(FleetMessage::PoseEstimate(robot, &PoseEstimate::default()));
                bridge.publish(FleetMessage::Clock(&Clock::default()));
                readers[0].stream.write_all(&twist).await.unwrap();
                for reader in &mut readers {
                    for _ in 0..FRAMES + maps {
                        reader.next_is(b"").await;
                    }
                }
            }
        };
        round(50).await;
        let region = Region::new(ALLOCATOR);
        round(500).await;
        let change = region.change();
        assert_eq!(
            (change.allocations, change.reallocations),
            (0, 0),
            "in 500 rounds of {FRAMES} messages and their maps"
        );
        assert_eq!(commands.get(), 550);
    });
}
