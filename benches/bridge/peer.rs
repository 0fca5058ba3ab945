//! A ROS 2 peer in a process of its own, with a reliable reader of everything a fleet of three says.

use bridge::dds::{CdrPassthrough, SerializedMessage};
use ros2_client::dds::rustdds::no_key::SimpleDataReader;
use ros2_client::dds::rustdds::policy::{Durability, History};
use ros2_client::dds::rustdds::{
    DomainParticipantBuilder, Duration as DdsDuration, QosPolicyBuilder, Subscriber, TopicKind,
};
use std::error::Error;
use std::io::{BufRead, BufReader};
use std::net::Ipv4Addr;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// It looks so often for what has come: ten messages of the fastest topic wait meanwhile.
const LOOK: Duration = Duration::from_millis(20);
const KEPT: i32 = 64;

/// Domains whose ports lie below those that the system gives to anybody.
pub fn domain() -> u16 {
    2 + (std::process::id() % 98) as u16
}

/// The peer's side: listens for so long, then says how many messages came.
pub fn listen(domain: u16, length: Duration) -> Result<(), Box<dyn Error>> {
    let participant =
        DomainParticipantBuilder::new(domain).with_only_networks([Ipv4Addr::LOCALHOST]).build()?;
    let subscriber = participant.create_subscriber(&QosPolicyBuilder::new().build())?;
    let open = |name: &str, class: &str, durability: Durability| -> Result<Reader, Box<dyn Error>> {
        let (package, kind) = class.split_once('/').ok_or("package/Type")?;
        let qos = QosPolicyBuilder::new()
            .reliable(DdsDuration::ZERO)
            .durability(durability)
            .history(History::KeepLast { depth: KEPT })
            .build();
        let (name, class) = (format!("rt{name}"), format!("{package}::msg::dds_::{kind}_"));
        let topic = participant.create_topic(name, class, &qos, TopicKind::NoKey)?;
        reader(&subscriber, &topic, qos)
    };
    let mut readers = vec![
        open("/tf", "tf2_msgs/TFMessage", Durability::Volatile)?,
        open("/tf_static", "tf2_msgs/TFMessage", Durability::TransientLocal)?,
        open("/clock", "rosgraph_msgs/Clock", Durability::Volatile)?,
        open("/merged_map", "nav_msgs/OccupancyGrid", Durability::TransientLocal)?,
        open("/map", "nav_msgs/OccupancyGrid", Durability::TransientLocal)?,
    ];
    for robot in 1..=3 {
        for (topic, class) in [
            ("scan", "sensor_msgs/LaserScan"),
            ("odom", "nav_msgs/Odometry"),
            ("pose", "geometry_msgs/PoseWithCovarianceStamped"),
            ("slam_stats", "std_msgs/Float32MultiArray"),
        ] {
            readers.push(open(&format!("/robot{robot}/{topic}"), class, Durability::Volatile)?);
        }
        readers.push(open(
            &format!("/robot{robot}/map"),
            "nav_msgs/OccupancyGrid",
            Durability::TransientLocal,
        )?);
    }
    let begun = Instant::now();
    let mut heard = 0_u64;
    while begun.elapsed() < length {
        for reader in &readers {
            reader.drain_read_notifications();
            while let Ok(Some(_)) = reader.try_take_one() {
                heard += 1;
            }
        }
        std::thread::sleep(LOOK);
    }
    println!("{heard}");
    Ok(())
}

type Reader = SimpleDataReader<SerializedMessage, CdrPassthrough>;

fn reader(
    subscriber: &Subscriber,
    topic: &ros2_client::dds::rustdds::Topic,
    qos: ros2_client::dds::rustdds::QosPolicies,
) -> Result<Reader, Box<dyn Error>> {
    Ok(subscriber.create_simple_datareader_no_key(topic, Some(qos))?)
}

/// A peer that listens in another process.
pub struct Peer(Child);

impl Peer {
    /// For so long.
    pub fn start(domain: u16, length: Duration) -> Result<Self, Box<dyn Error>> {
        let words = ["ros-peer".to_owned(), domain.to_string(), length.as_secs().to_string()];
        let peer = Command::new(std::env::current_exe()?).args(words).stdout(Stdio::piped()).spawn()?;
        Ok(Self(peer))
    }

    /// How many messages it has heard, when it is done.
    pub fn heard(mut self) -> Result<u64, Box<dyn Error>> {
        let mut line = String::new();
        BufReader::new(self.0.stdout.take().ok_or("no stdout")?).read_line(&mut line)?;
        self.0.wait()?;
        Ok(line.trim().parse().map_err(|_| "the ROS 2 peer failed")?)
    }
}
