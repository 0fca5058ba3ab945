//! A ros_tcp client that blocks, as small as a bench needs.

use bridge::command::{Registration, name};
use bridge::frame::{Parser, Side};
use std::error::Error;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// Larger than any frame here.
const FRAME_MAX: usize = 64 << 20;
/// Nothing for so long: nothing more comes.
const SILENCE: Duration = Duration::from_millis(700);

/// (command, topic, type)
pub type Wish = (&'static str, &'static str, &'static str);

/// Everything a fleet of three offers.
pub const EVERYTHING: [Wish; 10] = [
    (name::SUBSCRIBE, "/tf", "tf2_msgs/TFMessage"),
    (name::SUBSCRIBE, "/clock", "rosgraph_msgs/Clock"),
    (name::SUBSCRIBE, "/robot1/scan", "sensor_msgs/LaserScan"),
    (name::SUBSCRIBE, "/robot2/scan", "sensor_msgs/LaserScan"),
    (name::SUBSCRIBE, "/robot3/scan", "sensor_msgs/LaserScan"),
    (name::SUBSCRIBE, "/robot1/map", "nav_msgs/OccupancyGrid"),
    (name::SUBSCRIBE, "/robot2/map", "nav_msgs/OccupancyGrid"),
    (name::SUBSCRIBE, "/robot3/map", "nav_msgs/OccupancyGrid"),
    (name::SUBSCRIBE, "/merged_map", "nav_msgs/OccupancyGrid"),
    (name::SUBSCRIBE, "/robot1/odom", "nav_msgs/Odometry"),
];

/// One connection.
pub struct Client {
    /// Its socket.
    pub stream: TcpStream,
    parser: Parser,
}

impl Client {
    /// Connects, registers, and returns when the bridge has taken it all in.
    pub fn connect(port: u16, wishes: &[Wish]) -> Result<Self, Box<dyn Error>> {
        let mut client = Self::connect_only(port, wishes)?;
        client.stream.set_read_timeout(Some(SILENCE))?;
        while client.next(|name, _| name == name::TOPIC_LIST.as_bytes())? != Some(true) {}
        Ok(client)
    }

    /// Connects and registers, and reads nothing.
    pub fn connect_only(port: u16, wishes: &[Wish]) -> Result<Self, Box<dyn Error>> {
        let mut stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_nodelay(true)?;
        let mut out = bridge::frame::KEEPALIVE.to_vec();
        for (command, topic, class) in wishes {
            let (topic, message_name) = ((*topic).into(), (*class).into());
            let about = Registration { topic, message_name, queue_size: 4096, latch: false };
            Side::Client.write_command(&mut out, command, &about);
        }
        Side::Client.write_command(&mut out, name::TOPIC_LIST, &serde_json::json!({}));
        stream.write_all(&out)?;
        Ok(Self { stream, parser: Parser::new(FRAME_MAX).keep(FRAME_MAX) })
    }

    /// The next frame; `None` if nothing comes any more.
    pub fn next<T>(&mut self, see: impl FnOnce(&[u8], &[u8]) -> T) -> Result<Option<T>, Box<dyn Error>> {
        loop {
            if let Some(frame) = self.parser.next_frame()? {
                return Ok(Some(see(frame.name, frame.payload)));
            }
            match self.stream.read(self.parser.space()) {
                Ok(0) | Err(_) => return Ok(None),
                Ok(count) => self.parser.filled(count),
            }
        }
    }

    /// Goes as an application does that crashes: with a reset.
    pub fn abort(self) -> std::io::Result<()> {
        rustix::net::sockopt::set_socket_linger(&self.stream, Some(Duration::ZERO))?;
        Ok(())
    }
}
