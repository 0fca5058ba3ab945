//! The robot's side: a peer that listens to `/robot1/cmd_vel` and records the time of each velocity.

use crate::fleet::Fleet;
use crate::operator::{RosTwist, node};
use bridge::command::{Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{Message, Twist, decode};
use msg::Monotonic;
use ros2_client::qos::QosProfile;
use ros2_client::{MessageTypeName, Name};
use std::error::Error;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Topic of the robot's velocities.
const TOPIC: &str = "/robot1/cmd_vel";
/// Largest frame on that topic, bytes.
const FRAME_MAX: usize = 1 << 20;
/// Pause between two looks for a velocity on DDS, and longest wait for one on TCP.
const LOOK: Duration = Duration::from_millis(1);
/// Pause between two attempts to connect to a bridge that is restarting.
const RECONNECT: Duration = Duration::from_millis(10);

/// A velocity that the robot got.
#[derive(Clone, Copy, Debug)]
pub struct Heard {
    /// When it came.
    pub at: Monotonic,
    /// Speed forward, m/s.
    pub linear_m_s: f64,
}

/// What a listening thread shares with the bench.
#[derive(Default)]
struct Shared {
    heard: Mutex<Vec<Heard>>,
    is_over: AtomicBool,
    is_listening: AtomicBool,
}

impl Shared {
    fn record(&self, linear_m_s: f64) {
        let heard = Heard { at: mr_slam::clock::now(), linear_m_s };
        self.heard.lock().unwrap_or_else(PoisonError::into_inner).push(heard);
    }

    fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }
}

/// A robot that listens until it is dropped.
pub struct Robot {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Robot {
    /// Begins to listen: over DDS to a fleet of ROS robots, otherwise over TCP.
    pub fn listen(fleet: &Fleet) -> Result<Self, Box<dyn Error>> {
        let shared = Arc::new(Shared::default());
        let (to, address, domain, is_ros) = (shared.clone(), fleet.address(), fleet.domain, fleet.is_ros);
        let thread = std::thread::spawn(move || {
            if is_ros {
                if let Err(why) = listen_dds(domain, &to) {
                    eprintln!("robot: {why}");
                }
                return;
            }
            while !to.is_over() {
                // The bridge may be restarting.
                if listen_tcp(&address, &to).is_err() {
                    std::thread::sleep(RECONNECT);
                }
            }
        });
        let robot = Self { shared, thread: Some(thread) };
        crate::wait("a robot that listens", || robot.shared.is_listening.load(Ordering::Relaxed))?;
        Ok(robot)
    }

    /// Returns what the robot has got so far.
    pub fn heard(&self) -> Vec<Heard> {
        self.shared.heard.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Relaxed);
        // A thread that panicked has said so.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn listen_tcp(address: &str, to: &Shared) -> Result<(), Box<dyn Error>> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(LOOK))?;
    let mut frame = Vec::new();
    let topic = Registration { topic: TOPIC.into(), message_name: Twist::TYPE.into(), ..Default::default() };
    Side::Client.write_command(&mut frame, name::SUBSCRIBE, &topic);
    stream.write_all(&frame)?;
    let mut parser = Parser::new(FRAME_MAX);
    while !to.is_over() {
        while let Some(frame) = parser.next_frame()? {
            to.is_listening.store(true, Ordering::Relaxed);
            if frame.name == TOPIC.as_bytes() {
                to.record(decode::<Twist>(frame.payload)?.linear[0]);
            }
        }
        match stream.read(parser.space()) {
            Ok(0) => return Err("the bridge has closed".into()),
            Ok(count) => parser.filled(count),
            Err(why) if why.kind() == std::io::ErrorKind::WouldBlock => {}
            Err(why) => return Err(why.into()),
        }
    }
    Ok(())
}

fn listen_dds(domain: u16, to: &Shared) -> Result<(), Box<dyn Error>> {
    let mut node = node(domain, "robot")?;
    let qos = QosProfile::subscription_default();
    let topic =
        node.create_topic(&Name::parse(TOPIC)?, MessageTypeName::new("geometry_msgs", "Twist"), &qos)?;
    let velocities = node.create_subscription::<RosTwist>(&topic, None)?;
    to.is_listening.store(true, Ordering::Relaxed);
    while !to.is_over() {
        while let Ok(Some((velocity, _))) = velocities.take() {
            to.record(velocity.0[0]);
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}
