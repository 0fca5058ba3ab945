//! Latency and jitter of the messages of a fleet of three.

use crate::client::Client;
use crate::measure::{header, nanoseconds, print_us, stamp_at, thread_cpu_ns, transforms};
use crate::server::{Job, ROBOTS, Server};
use bridge::FleetMessage;
use bridge::command::name;
use msg::{Clock, RobotId, Scan};
use std::thread;
use std::time::{Duration, Instant};

/// Measures the latency and jitter of the fleet's messages: transforms of 3 robots at 20 Hz, scans at 10 Hz, clock at 100 Hz.
pub fn mix(seconds: u64) {
    let server = Server::start();
    let subscribed = [
        (name::SUBSCRIBE, "/tf", "tf2_msgs/TFMessage"),
        (name::SUBSCRIBE, "/clock", "rosgraph_msgs/Clock"),
        (name::SUBSCRIBE, "/robot1/scan", "sensor_msgs/LaserScan"),
        (name::SUBSCRIBE, "/robot2/scan", "sensor_msgs/LaserScan"),
        (name::SUBSCRIBE, "/robot3/scan", "sensor_msgs/LaserScan"),
    ];
    let mut client = Client::connect(server.address, &subscribed);
    client.stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let begin = Instant::now();
    let reader = thread::spawn(move || {
        let (mut transforms, mut clocks, mut scans) = (Vec::new(), Vec::new(), Vec::new());
        while client
            .next(|name, payload| {
                let age = |offset| nanoseconds(begin) - stamp_at(payload, offset);
                match name {
                    b"/tf" => transforms.push(age(8)),
                    b"/clock" => clocks.push(age(4)),
                    _ => scans.push(age(4)),
                }
            })
            .is_some()
        {}
        (transforms, clocks, scans)
    });
    let scan = Box::new(Scan { len: 180, ..bytemuck::Zeroable::zeroed() });
    let cpu = server.ask(|_| thread_cpu_ns());
    for tick in 0..seconds * 100 {
        let due = begin + Duration::from_millis(10 * tick);
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let mut scan = scan.clone();
        server
            .jobs
            .send(Box::new(move |bridge| {
                bridge.publish(FleetMessage::Clock(&Clock { header: header(begin) }))
            }))
            .unwrap();
        for robot in RobotId::first(ROBOTS) {
            if tick % 5 == robot.index() as u64 {
                let job: Job = Box::new(move |bridge| {
                    bridge.publish(FleetMessage::Transforms(robot, &transforms(header(begin))))
                });
                server.jobs.send(job).unwrap();
            }
            if tick % 10 == 5 + robot.index() as u64 {
                scan.header = header(begin);
                let scan = scan.clone();
                server
                    .jobs
                    .send(Box::new(move |bridge| bridge.publish(FleetMessage::Scan(robot, &scan))))
                    .unwrap();
            }
        }
    }
    let cpu = server.ask(|_| thread_cpu_ns()) - cpu;
    let (transforms, clocks, scans) = reader.join().unwrap();
    let lost = seconds * 60 - transforms.len() as u64 + seconds * 100 - clocks.len() as u64;
    let mean = transforms.iter().sum::<i64>() / transforms.len().max(1) as i64;
    print_us("TF, encode to client", transforms.clone());
    print_us("TF jitter, |latency - mean|", transforms.iter().map(|ns| (ns - mean).abs()).collect());
    print_us("clock, encode to client", clocks);
    print_us("scan, made to client", scans);
    let share = cpu as f64 / (seconds * 10_000_000) as f64;
    println!(
        "{:<52} {share:.2} % of a core, {lost} of {} lost",
        "bridge's thread in this mix",
        seconds * 190
    );
}
