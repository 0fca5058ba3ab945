//! Time of velocities from a client to a robot.

use crate::client::Client;
use crate::measure::print_us;
use crate::server::Server;
use bridge::command::name;
use bridge::frame::Side;
use bridge::ros::{Message, Twist, encode};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

/// Measures the time from the first write of a twist to the robot's command.
///
/// `field_by_field`: as Unity's connector writes, one write for each field with Nagle's algorithm on.
pub fn command_in(field_by_field: bool) {
    let server = Server::start();
    let client = Client::connect(server.address, &[(name::PUBLISH, "/cmd_vel", Twist::TYPE)]);
    client.stream.set_nodelay(!field_by_field).unwrap();
    let mut frame = Vec::new();
    let moving = Twist { linear: [0.1, 0.0, 0.0], angular: [0.0; 3] };
    Side::Client.write_with(&mut frame, "/cmd_vel", |out| encode(&moving, out));
    let mut cuts = vec![0, 4, 12, 13, 17, 21];
    cuts.extend((21..frame.len()).step_by(8).skip(1));
    cuts.push(frame.len());
    if !field_by_field {
        cuts = vec![0, frame.len()];
    }
    let mut times = Vec::new();
    for _ in 0..500 {
        thread::sleep(Duration::from_millis(10));
        let begin = Instant::now();
        cuts.windows(2).for_each(|cut| (&client.stream).write_all(&frame[cut[0]..cut[1]]).unwrap());
        times.push(server.commands.recv().unwrap().duration_since(begin).as_nanos() as i64);
    }
    let how = if field_by_field { "field by field with Nagle" } else { "in one write" };
    print_us(&format!("twist in, {how}, to the robot's command"), times);
}

/// Measures the same bytes over a plain socket.
pub fn bare_wake_up() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let (send, arrived) = mpsc::channel();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut frame = [0; 68];
        while stream.read_exact(&mut frame).is_ok() {
            send.send(Instant::now()).unwrap();
        }
    });
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_nodelay(true).unwrap();
    let mut times = Vec::new();
    for _ in 0..500 {
        thread::sleep(Duration::from_millis(10));
        let begin = Instant::now();
        stream.write_all(&[0; 68]).unwrap();
        times.push(arrived.recv().unwrap().duration_since(begin).as_nanos() as i64);
    }
    print_us("  bare: 68 bytes over a plain socket", times);
}
