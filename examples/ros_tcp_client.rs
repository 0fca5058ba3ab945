//! A client of the bridge, in the protocol of Unity's ROS-TCP-Endpoint: subscribes, drives, and prints what arrives.
//!
//! `cargo run --example ros_tcp_client [ADDRESS:PORT]`, such as `127.0.0.1:10000` while `mr-slam up` runs
//!
//! Without an address it talks with a stand-in for a fleet, which sends the handshake and `/clock`.
//! A frame is: u32 name length, name, u32 payload length, payload, all little-endian. Names that begin with `__` are commands
//! with JSON; any other name is a topic with a CDR message.

use bridge::command::{Handshake, Registration, name};
use bridge::frame::{Parser, Side};
use bridge::ros::{self, Clock, Message, Twist};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// The longest message this client accepts, bytes.
const PAYLOAD_BYTES_MAX: usize = 1 << 24;
/// How long the example runs.
const DURATION: Duration = Duration::from_secs(2);

type Error = Box<dyn std::error::Error>;

fn main() -> Result<(), Error> {
    let address = match std::env::args().nth(1) {
        Some(address) => address,
        None => serve_clock()?,
    };
    let mut stream = TcpStream::connect(&address)?;
    stream.set_read_timeout(Some(Duration::from_millis(100)))?;
    let mut parser = Parser::new(PAYLOAD_BYTES_MAX);
    let (mut clocks, mut others, begin) = (0, 0, Instant::now());
    while begin.elapsed() < DURATION {
        match stream.read(parser.space()) {
            Ok(0) => return Err("the bridge closed the connection".into()),
            Ok(count) => parser.filled(count),
            Err(why)
                if matches!(why.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {}
            Err(why) => return Err(why.into()),
        }
        while let Some(frame) = parser.next_frame()? {
            match std::str::from_utf8(frame.name)? {
                name::HANDSHAKE => {
                    let hello: Handshake = serde_json::from_slice(frame.payload)?;
                    println!("connected: version {}, {}", hello.version, hello.metadata);
                    stream.write_all(&greeting())?;
                }
                "/clock" => {
                    let clock: Clock = ros::decode(frame.payload)?;
                    if clocks == 0 {
                        println!("/clock: {:.2} s", clock.clock.seconds());
                    }
                    clocks += 1;
                }
                // Keepalives have no name; /tf and whatever else was subscribed.
                _ => others += 1,
            }
        }
    }
    println!("{clocks} messages on /clock, {others} other frames in {} s", DURATION.as_secs());
    Ok(())
}

/// What the client says first: what it subscribes to and publishes, and one command, which holds for 0.3 s.
fn greeting() -> Vec<u8> {
    let topic = |topic: &str, class: &str| Registration {
        topic: topic.into(),
        message_name: class.into(),
        ..Registration::default()
    };
    let mut bytes = Vec::new();
    Side::Client.write_command(&mut bytes, name::SUBSCRIBE, &topic("/clock", Clock::TYPE));
    Side::Client.write_command(&mut bytes, name::SUBSCRIBE, &topic("/tf", "tf2_msgs/TFMessage"));
    Side::Client.write_command(&mut bytes, name::PUBLISH, &topic("/cmd_vel_1", Twist::TYPE));
    let forward = Twist { linear: [0.1, 0.0, 0.0], angular: [0.0, 0.0, 0.2] };
    Side::Client.write_with(&mut bytes, "/cmd_vel_1", |payload| ros::encode(&forward, payload));
    bytes
}

/// A stand-in for a fleet, on a thread of its own: the handshake, then `/clock` at 100 Hz. Returns its address.
fn serve_clock() -> Result<String, Error> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?.to_string();
    std::thread::spawn(move || -> std::io::Result<()> {
        let (mut client, _) = listener.accept()?;
        let metadata = r#"{"protocol":"ROS2"}"#.to_owned();
        let mut bytes = Vec::new();
        Side::Server.write_command(
            &mut bytes,
            name::HANDSHAKE,
            &Handshake { version: bridge::command::VERSION.into(), metadata },
        );
        client.write_all(&bytes)?;
        let begin = Instant::now();
        loop {
            let clock = Clock { clock: msg::Stamp(begin.elapsed().as_nanos() as i64) };
            bytes.clear();
            Side::Server.write_with(&mut bytes, "/clock", |payload| ros::encode(&clock, payload));
            client.write_all(&bytes)?;
            std::thread::sleep(Duration::from_millis(10));
        }
    });
    Ok(address)
}
