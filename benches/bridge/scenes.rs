//! What is done to the running fleet's bridge, beside the mix.

use crate::client::{Client, EVERYTHING, Wish};
use bridge::command::name;
use bridge::frame::Side;
use bridge::ros::{self, Message, Twist, encode};
use mr_slam::channel;
use mr_slam::clock::now;
use mr_slam::run::Run;
use mr_slam::shared_memory::{Node, wait};
use msg::{Monotonic, RobotId};
use std::collections::BTreeMap;
use std::error::Error;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// A command every so often, as a headset at 50 Hz.
const COMMAND_PERIOD: Duration = Duration::from_millis(20);

/// A frame cut as Unity's connector writes it: each field by itself.
fn fields(frame: &[u8], name_length: usize) -> Vec<usize> {
    let payload = 8 + name_length;
    let mut cuts = vec![0, 4, 4 + name_length, payload, payload + 4];
    cuts.extend((payload + 4..=frame.len()).step_by(8).skip(1));
    cuts
}

/// Milliseconds from a command's first byte written to the moment who listens on the robot's channel, as its
/// simulator does, has it. Sorted.
pub fn commands(run: &Run, count: usize) -> Result<Vec<f64>, Box<dyn Error>> {
    let node = Node::open(&run.domain, "bench")?;
    let robot = RobotId::first(3).last().ok_or("no robot")?;
    let channel = channel::command(robot);
    let (mut reader, bell) = (node.reader(&channel)?, node.bell(&channel)?);
    let topic: Wish = (name::PUBLISH, "/cmd_vel_3", Twist::TYPE);
    let mut client = Client::connect(run.port, &[topic])?;
    client.stream.set_nodelay(false)?;
    let mut frame = Vec::new();
    let turning = Twist { linear: [0.0; 3], angular: [0.0, 0.0, 0.01] };
    Side::Client.write_with(&mut frame, topic.1, |out| encode(&turning, out));
    // A name from a client ends in a NUL.
    let cuts = fields(&frame, topic.1.len() + 1);
    let mut times = Vec::new();
    for _ in 0..count {
        std::thread::sleep(COMMAND_PERIOD);
        while reader.receive().is_some() {}
        let begun = now();
        cuts.windows(2).try_for_each(|cut| client.stream.write_all(&frame[cut[0]..cut[1]]))?;
        let until = Monotonic(begun.0 + 1_000_000_000);
        while reader.receive().is_none() {
            wait(&[&bell], until);
            if now() >= until {
                return Err("a command did not arrive".into());
            }
        }
        times.push(now().since(begun) as f64 * 1e-6);
    }
    times.sort_by(f64::total_cmp);
    Ok(times)
}

/// The same writes over a plain socket to a thread that acknowledges at once: what belongs to the machine.
pub fn bare_commands(count: usize) -> Result<Vec<f64>, Box<dyn Error>> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let port = listener.local_addr()?.port();
    let frame = [0; 71];
    let cuts = fields(&frame, 11);
    let (tell, arrived) = std::sync::mpsc::channel();
    std::thread::spawn(move || -> std::io::Result<()> {
        let (mut stream, _) = listener.accept()?;
        let (mut have, mut space) = (0, [0; 4096]);
        loop {
            rustix::net::sockopt::set_tcp_quickack(&stream, true)?;
            have += stream.read(&mut space)?;
            rustix::net::sockopt::set_tcp_quickack(&stream, true)?;
            if have >= frame.len() {
                have -= frame.len();
                let _ = tell.send(now());
            }
        }
    });
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    let mut times = Vec::new();
    for _ in 0..count {
        std::thread::sleep(COMMAND_PERIOD);
        let begun = now();
        cuts.windows(2).try_for_each(|cut| stream.write_all(&frame[cut[0]..cut[1]]))?;
        times.push(arrived.recv()?.since(begun) as f64 * 1e-6);
    }
    times.sort_by(f64::total_cmp);
    Ok(times)
}

/// 52-byte messages through the bridge, from one client to another, `per_second` of them for `seconds`; 0: as fast as
/// they go in. (sent, lost, the rate at which they arrived)
pub fn rate(port: u16, per_second: usize, seconds: usize) -> Result<(usize, usize, f64), Box<dyn Error>> {
    let mut hears = Client::connect(port, &[(name::SUBSCRIBE, "/bench", Twist::TYPE)])?;
    let mut sends = Client::connect(port, &[(name::PUBLISH, "/bench", Twist::TYPE)])?;
    let reader = std::thread::spawn(move || {
        let (mut count, mut first, mut last) = (0_usize, None, Instant::now());
        while let Ok(Some(true)) = hears.next(|name, _| name == b"/bench") {
            count += 1;
            last = Instant::now();
            first.get_or_insert(last);
        }
        (count, first.map_or(0.0, |first| (last - first).as_secs_f64()))
    });
    let mut message = Vec::new();
    Side::Client.write_with(&mut message, "/bench", |out| encode(&Twist::default(), out));
    let step = if per_second == 0 { 1000 } else { per_second / 1000 };
    let frames = message.repeat(step);
    let rounds = 1000 * seconds;
    let begun = Instant::now();
    for round in 0..rounds {
        if per_second > 0 {
            let due = begun + Duration::from_millis(round as u64);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        sends.stream.write_all(&frames)?;
    }
    let sent = step * rounds;
    let (count, took_s) = reader.join().map_err(|_| "the reader failed")?;
    Ok((sent, sent.saturating_sub(count), count as f64 / took_s.max(1e-9)))
}

/// A client that reads nothing for 0.4 s, then all that has come meanwhile, again and again: what of the mix it
/// lost. (heard, lost)
pub fn bursts(port: u16, seconds: usize) -> Result<(usize, usize), Box<dyn Error>> {
    let mut client = Client::connect(port, &EVERYTHING[..5])?;
    let begun = Instant::now();
    let mut pause = begun;
    // By link or topic: the newest stamp, and its period.
    let mut newest: BTreeMap<String, i64> = BTreeMap::new();
    let (mut heard, mut lost) = (0, 0);
    let mut note = |stream: &str, stamp_ns: i64, period_ns: i64| {
        heard += 1;
        if let Some(before) = newest.insert(stream.into(), stamp_ns) {
            let step = (stamp_ns - before) as f64 / period_ns as f64;
            lost += (step.round() - 1.0).abs() as usize;
        }
    };
    let ms = 1_000_000;
    while begun.elapsed().as_secs() < seconds as u64 {
        if pause.elapsed() > Duration::from_secs(1) {
            std::thread::sleep(Duration::from_millis(400));
            pause = Instant::now();
        }
        client.next(|name, payload| match name {
            b"/tf" => {
                let tree = ros::decode::<ros::TfMessage>(payload).unwrap_or_default();
                for edge in &tree.transforms {
                    let child = edge.child_frame_id.as_str();
                    if !child.starts_with("odom") && !child.starts_with("map") {
                        note(child, edge.stamp.0, 50 * ms);
                    }
                }
            }
            b"/clock" => {
                let clock = ros::decode::<ros::Clock>(payload).unwrap_or_default();
                note("clock", clock.clock.0, 10 * ms);
            }
            topic if topic.ends_with(b"/scan") => {
                let scan = ros::decode::<ros::LaserScan>(payload).unwrap_or_default();
                note(&String::from_utf8_lossy(topic), scan.stamp.0, 100 * ms);
            }
            _ => {}
        })?;
    }
    Ok((heard, lost))
}

/// Connects with five registrations and vanishes with a reset, `count` times.
pub fn reconnects(port: u16, count: usize) -> Result<(), Box<dyn Error>> {
    let own: Wish = (name::SUBSCRIBE, "/of_mine", "std_msgs/String");
    let drives: Wish = (name::PUBLISH, "/cmd_vel", Twist::TYPE);
    for _ in 0..count {
        let client = Client::connect(port, &[EVERYTHING[0], EVERYTHING[1], EVERYTHING[2], own, drives])?;
        client.abort()?;
    }
    Ok(())
}

/// Resident memory of a process, bytes.
pub fn resident_bytes(pid: u32) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{pid}/statm")).unwrap_or_default();
    let pages = text.split(' ').nth(1).and_then(|field| field.parse::<u64>().ok()).unwrap_or(0);
    pages * rustix::param::page_size() as u64
}
