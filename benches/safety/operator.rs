//! The operator, in a process of its own: it sends velocities at 20 Hz, prints the time of each, and obeys words on its
//! standard input.

use crate::link::CutLink;
use bridge::command::{Registration, name};
use bridge::frame::Side;
use bridge::ros::{Bool, Message, Twist, encode};
use msg::Monotonic;
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::{Context, Node};
use ros2_client::qos::QosProfile;
use ros2_client::{MessageTypeName, Name, NodeName, NodeOptions};
use rustix::process::Signal;
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Period of the velocities: 20 Hz.
pub const PERIOD: Duration = Duration::from_millis(50);
/// Velocity that the operator wishes for, m/s: beyond every limit.
const WISH_M_S: f64 = 5.0;
/// The operator counts as silent after this time without a velocity, nanoseconds.
const SILENT_NS: u64 = 120_000_000;

/// Topic on which clients set the emergency stop.
const EMERGENCY_STOP: &str = "/emergency_stop";

/// geometry_msgs/Twist as DDS carries it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RosTwist(pub [f64; 6]);

/// The process, as its parent sees it.
pub struct Operator {
    process: Child,
    last_command: Arc<AtomicU64>,
}

impl Operator {
    /// Starts an operator on `tcp` (an address) or `dds` (a domain), if need be behind a link.
    pub fn start(transport: &str, target: &str, link: Option<&CutLink>) -> Result<Self, Box<dyn Error>> {
        let program = std::env::current_exe()?;
        let mut command = link.map_or_else(|| Command::new(&program), |link| link.command(&program));
        command.args(["operator", transport, target]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn()?;
        let lines = BufReader::new(process.stdout.take().ok_or("no standard output")?).lines();
        let last_command = Arc::new(AtomicU64::new(0));
        let newest = last_command.clone();
        std::thread::spawn(move || {
            let times = lines.map_while(Result::ok).filter_map(|line| line.parse().ok());
            times.for_each(|time| newest.store(time, Ordering::Relaxed));
        });
        Ok(Self { process, last_command })
    }

    /// Says a word to the operator: `close` or `silence`.
    pub fn notify(&mut self, word: &str) -> Result<(), Box<dyn Error>> {
        let input = self.process.stdin.as_mut().ok_or("no standard input")?;
        Ok(writeln!(input, "{word}")?)
    }

    /// Sends the operator a signal.
    pub fn signal(&self, signal: Signal) {
        crate::fleet::send(self.process.id(), signal);
    }

    /// Returns when the operator sent its last velocity.
    pub fn last_command(&self) -> Monotonic {
        Monotonic(self.last_command.load(Ordering::Relaxed))
    }

    /// Returns whether the operator has sent a velocity just now.
    pub fn is_sending(&self) -> bool {
        mr_slam::clock::now().since(self.last_command()) < SILENT_NS
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// A client on TCP that sets the emergency stop.
pub struct StopButton {
    stream: TcpStream,
}

impl StopButton {
    /// Connects to a bridge.
    pub fn connect(address: &str) -> Result<Self, Box<dyn Error>> {
        let mut stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        let (mut frame, message_name) = (Vec::new(), Bool::TYPE.into());
        let topic = Registration { topic: EMERGENCY_STOP.into(), message_name, ..Default::default() };
        Side::Client.write_command(&mut frame, name::PUBLISH, &topic);
        stream.write_all(&frame)?;
        Ok(Self { stream })
    }

    /// Sets the emergency stop; the bridge may not have read it yet.
    pub fn press(&mut self) -> std::io::Result<()> {
        let mut frame = Vec::new();
        Side::Client.write_with(&mut frame, EMERGENCY_STOP, |out| encode(&Bool(true), out));
        self.stream.write_all(&frame)
    }
}

/// Runs the operator.
pub fn run(transport: &str, target: &str) -> Result<(), Box<dyn Error>> {
    let (is_silent, is_closed) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let (silent, closed) = (is_silent.clone(), is_closed.clone());
    std::thread::spawn(move || {
        for word in std::io::stdin().lines().map_while(Result::ok) {
            silent.store(true, Ordering::Relaxed);
            closed.store(word == "close", Ordering::Relaxed);
        }
        closed.store(true, Ordering::Relaxed);
    });
    let mut send: Box<dyn FnMut() -> Result<(), Box<dyn Error>>> = match transport {
        "tcp" => {
            let mut stream = TcpStream::connect(target)?;
            stream.set_nodelay(true)?;
            let (mut frame, message_name) = (Vec::new(), Twist::TYPE.into());
            let topic = Registration { topic: "/cmd_vel_1".into(), message_name, ..Default::default() };
            Side::Client.write_command(&mut frame, name::PUBLISH, &topic);
            stream.write_all(&frame)?;
            frame.clear();
            let twist = Twist { linear: [WISH_M_S, 0.0, 0.0], ..Default::default() };
            Side::Client.write_with(&mut frame, "/cmd_vel_1", |out| encode(&twist, out));
            Box::new(move || Ok(stream.write_all(&frame)?))
        }
        _ => {
            let mut node = node(target.parse()?, "operator")?;
            let qos = QosProfile::publisher_default();
            let topic = node.create_topic(
                &Name::parse("/cmd_vel_1")?,
                MessageTypeName::new("geometry_msgs", "Twist"),
                &qos,
            )?;
            let publisher = node.create_publisher::<RosTwist>(&topic, None)?;
            Box::new(move || {
                let _alive = &node;
                Ok(publisher.publish(RosTwist([WISH_M_S, 0.0, 0.0, 0.0, 0.0, 0.0]))?)
            })
        }
    };
    while !is_closed.load(Ordering::Relaxed) {
        if !is_silent.load(Ordering::Relaxed) {
            // Before it is sent: the time to the zero is rather too long than too short.
            println!("{}", mr_slam::clock::now().0);
            send()?;
        }
        std::thread::sleep(PERIOD);
    }
    Ok(())
}

/// Joins a ROS domain on loopback.
pub fn node(domain: u16, name: &str) -> Result<Node, Box<dyn Error>> {
    let participant =
        DomainParticipantBuilder::new(domain).with_only_networks([Ipv4Addr::LOCALHOST]).build()?;
    let context = Context::from_domain_participant(participant)?;
    let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
    Ok(context.new_node(NodeName::new("/", name)?, options)?)
}
