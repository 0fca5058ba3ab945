//! What is done to the running fleet's bridge, beside the mix.

use crate::client::{Client, EVERYTHING, Wish};
use bridge::command::name;
use bridge::frame::Side;
use bridge::ros::{self, Message, Twist, encode};
use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::time::{Duration, Instant};

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
