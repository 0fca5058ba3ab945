//! Abrupt reconnects.

use crate::client::Client;
use crate::measure::resident_kb;
use crate::server::Server;
use bridge::command::name;
use bridge::ros::{Message, Twist};
use bridge::{Bridge, FleetMessage};
use msg::Clock;
use std::time::{Duration, Instant};

/// Measures the time and memory of abrupt reconnects.
pub fn storm(connections: usize) {
    let server = Server::start();
    let registrations = [
        (name::SUBSCRIBE, "/tf", "tf2_msgs/TFMessage"),
        (name::SUBSCRIBE, "/robot1/scan", "sensor_msgs/LaserScan"),
        (name::SUBSCRIBE, "/clock", "rosgraph_msgs/Clock"),
        (name::SUBSCRIBE, "/of_mine", "std_msgs/String"),
        (name::PUBLISH, "/cmd_vel", Twist::TYPE),
    ];
    let go = |count: usize| {
        for _ in 0..count {
            let client = Client::connect(server.address, &registrations);
            server
                .jobs
                .send(Box::new(|bridge| bridge.publish(FleetMessage::Clock(&Clock::default()))))
                .unwrap();
            socket2::SockRef::from(&client.stream).set_linger(Some(Duration::ZERO)).unwrap();
        }
    };
    go(500);
    let (before, begin) = (resident_kb(), Instant::now());
    go(connections);
    let seconds = begin.elapsed().as_secs_f64();
    while server.ask(|bridge| bridge.counters().clients) > 0 {}
    let counters = server.ask(Bridge::counters);
    let what = format!("{connections} abrupt reconnects, 5 registrations each");
    println!("{what:<52} {seconds:.1} s, {before} -> {} kB resident, {counters:?}", resident_kb());
}
