//! Rates of small messages.

use crate::client::Client;
use crate::measure::thread_cpu_ns;
use crate::server::{Job, Server};
use bridge::FleetMessage;
use bridge::command::name;
use bridge::frame::Side;
use bridge::ros::{Message, Twist, encode};
use msg::{PoseEstimate, RobotId};
use std::io::Write;
use std::thread;
use std::time::{Duration, Instant};

/// Measures how many small transforms a second reach a client, each written on its own.
pub fn rate_out(per_second: u64) {
    let server = Server::start();
    let mut client = Client::connect(server.address, &[(name::SUBSCRIBE, "/tf", "tf2_msgs/TFMessage")]);
    client.stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let reader = thread::spawn(move || {
        let (mut count, begin, mut last) = (0_u64, Instant::now(), Instant::now());
        while client.next(|_, payload| payload.len()).is_some() {
            count += 1;
            last = Instant::now();
        }
        (count, last - begin)
    });
    let cpu = server.ask(|_| thread_cpu_ns());
    let begin = Instant::now();
    for tick in 0..400 {
        thread::sleep((begin + Duration::from_millis(5 * tick)).saturating_duration_since(Instant::now()));
        let job: Job = Box::new(move |bridge| {
            let robot = RobotId::new(1).unwrap();
            (0..per_second / 200)
                .for_each(|_| bridge.publish(FleetMessage::PoseEstimate(robot, &PoseEstimate::default())));
        });
        server.jobs.send(job).unwrap();
    }
    let cpu = server.ask(|_| thread_cpu_ns()) - cpu;
    let (count, time) = reader.join().unwrap();
    let sent = per_second / 200 * 400;
    println!(
        "{:<52} {:.0}/s arrived, {} of {sent} lost, {:.1} us of processor each",
        format!("transforms out, {per_second}/s offered, one write each"),
        count as f64 / time.as_secs_f64(),
        sent - count,
        cpu as f64 / 1e3 / sent as f64
    );
}

/// Measures how many twists a second the bridge forwards from one client to another.
pub fn relay(count: usize) {
    let server = Server::start();
    let mut subscriber = Client::connect(server.address, &[(name::SUBSCRIBE, "/relay", Twist::TYPE)]);
    let publisher = Client::connect(server.address, &[(name::PUBLISH, "/relay", Twist::TYPE)]);
    subscriber.stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let begin = Instant::now();
    let reader = thread::spawn(move || {
        let (mut got, mut last) = (0, Instant::now());
        while subscriber.next(|_, payload| payload.len()).is_some() {
            got += 1;
            last = Instant::now();
        }
        (got, last)
    });
    let mut frames = Vec::new();
    (0..100)
        .for_each(|_| Side::Client.write_with(&mut frames, "/relay", |out| encode(&Twist::default(), out)));
    (0..count / 100).for_each(|_| (&publisher.stream).write_all(&frames).unwrap());
    let (got, last) = reader.join().unwrap();
    let rate = f64::from(got) / (last - begin).as_secs_f64();
    println!(
        "{:<52} {rate:.0}/s, {} of {count} lost",
        "52-byte twists, client to client",
        count as i32 - got
    );
}
