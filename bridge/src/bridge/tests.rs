//! Test of a client on a weak link: a simulated socket that takes 60 kB/s, on simulated time.

use super::*;
use crate::command::Registration;
use crate::frame::Side;
use crate::ros::{Clock, LaserScan, Message, OccupancyGrid, TfMessage};
use bytemuck::Zeroable;
use msg::{GridHeader, GridView, Link, Scan, Transforms};
use std::cell::Cell;
use std::io::IoSlice;
use std::rc::Rc;

/// What the link carries, bytes per second.
const RATE: f64 = 60e3;
/// What the kernel holds: [`BridgeConfig::unsent_bytes_max`], and no more on its way than the link carries.
const KERNEL_BYTES: usize = 16 << 10;

/// A socket whose kernel buffer drains at a constant rate.
#[derive(Default)]
struct SlowLink {
    now: Cell<u64>,
    /// Bytes in the kernel, and all bytes that were ever written.
    waiting: Cell<f64>,
    written: RefCell<Vec<u8>>,
}

impl ClientSocket for Rc<SlowLink> {
    fn try_write(&self, slices: &[IoSlice<'_>]) -> std::io::Result<usize> {
        let mut space = KERNEL_BYTES.saturating_sub(self.waiting.get() as usize);
        // A socket is writable when a third of its buffer is free.
        if space < KERNEL_BYTES / 3 {
            return Err(std::io::ErrorKind::WouldBlock.into());
        }
        let mut taken = 0;
        for slice in slices {
            let part = slice.len().min(space);
            self.written.borrow_mut().extend_from_slice(&slice[..part]);
            (taken, space) = (taken + part, space - part);
        }
        self.waiting.set(self.waiting.get() + taken as f64);
        Ok(taken)
    }

    fn now(&self) -> Monotonic {
        Monotonic(self.now.get())
    }

    fn wake(&self) {}
}

/// The ages of transforms when the client has them whole, and the number of maps it gets, second by second.
struct Outcome {
    /// The oldest transform that arrived in each second, seconds.
    oldest_s: Vec<f64>,
    maps: Vec<usize>,
    held_back: usize,
}

/// What a fleet of three publishes.
struct World {
    scan: Box<Scan>,
    cells: Vec<i8>,
}

impl Default for World {
    fn default() -> Self {
        Self { scan: Box::new(Scan { len: 180, ..Scan::zeroed() }), cells: vec![0; 150_000] }
    }
}

impl World {
    /// Publishes what is due in this millisecond.
    fn publish(&self, bridge: &Bridge, ms: u64) {
        for robot in RobotId::first(3) {
            if ms.is_multiple_of(50) {
                let mut transforms = Transforms { len: 6, ..Default::default() };
                transforms.header.stamp = Stamp(ms as i64 * 1_000_000);
                for link in &mut transforms.links[..6] {
                    (link.parent, link.child) = (Link::BaseFootprint as u32, Link::BaseLink as u32);
                }
                bridge.publish(FleetMessage::Transforms(robot, &transforms));
            }
            if ms.is_multiple_of(100) {
                bridge.publish(FleetMessage::Scan(robot, &self.scan));
            }
        }
        if ms.is_multiple_of(1000) {
            let shape = GridHeader { width: 500, height: 300, resolution_m: 0.05, ..Default::default() };
            bridge.publish(FleetMessage::MergedMap(GridView::new(&shape, &self.cells).unwrap()));
        }
        bridge.publish(FleetMessage::Clock(&msg::Clock::default()));
    }
}

/// Runs three robots for some seconds: 20 Hz transforms, 10 Hz scans, a map of 150 kB each second.
fn run(seconds: usize, topics: &[(&str, &str)]) -> Outcome {
    let bridge = Bridge::new(BridgeConfig::default(), 3, |_, _| {}).unwrap();
    let link = Rc::new(SlowLink::default());
    let id = bridge.connect_socket(([10, 0, 0, 2], 1).into(), Box::new(link.clone())).unwrap();
    for (topic, message_type) in topics {
        let (topic, message_name) = ((*topic).to_owned(), (*message_type).to_owned());
        let mut bytes = Vec::new();
        let registration = Registration { topic, message_name, ..Registration::default() };
        Side::Client.write_command(&mut bytes, crate::command::name::SUBSCRIBE, &registration);
        let mut parser = crate::frame::Parser::new(1 << 20);
        parser.push(&bytes);
        bridge.receive(id, parser.next_frame().unwrap().unwrap(), Monotonic(0));
    }
    let mut outcome = Outcome { oldest_s: vec![0.0; seconds], maps: vec![0; seconds], held_back: 0 };
    let mut parser = crate::frame::Parser::new(1 << 20);
    let (mut arrived, world) = (0, World::default());
    for ms in 0..seconds as u64 * 1000 {
        let now_ns = ms * 1_000_000;
        link.now.set(now_ns);
        link.waiting.set((link.waiting.get() - RATE / 1e3).max(0.0));
        world.publish(&bridge, ms);
        if bridge.is_blocked(id).unwrap() {
            bridge.flush_client(id);
        } else {
            bridge.flush();
        }
        // What is not in the kernel any more has arrived.
        let written = link.written.borrow();
        let there = written.len() - link.waiting.get().ceil() as usize;
        parser.push(&written[arrived..there.max(arrived)]);
        arrived = there.max(arrived);
        while let Some(frame) = parser.next_frame().unwrap() {
            let second = (ms / 1000) as usize;
            if frame.name == b"/tf" {
                let tf: TfMessage = crate::ros::decode(frame.payload).unwrap();
                let age_s = (now_ns as i64 - tf.transforms[0].stamp.0) as f64 * 1e-9;
                outcome.oldest_s[second] = outcome.oldest_s[second].max(age_s);
            } else if frame.name == b"/merged_map" {
                outcome.maps[second] += 1;
            }
        }
        outcome.held_back = bridge.clients(Monotonic(now_ns))[0].held_back_bytes;
    }
    outcome
}

const LIVE: [(&str, &str); 5] = [
    ("/tf", TfMessage::TYPE),
    ("/clock", Clock::TYPE),
    ("/robot1/scan", LaserScan::TYPE),
    ("/robot2/scan", LaserScan::TYPE),
    ("/robot3/scan", LaserScan::TYPE),
];
const MAP: (&str, &str) = ("/merged_map", OccupancyGrid::TYPE);

#[test]
fn at_60_kb_per_s_no_transform_is_older_than_half_a_second() {
    let outcome = run(50, &[&LIVE[..], &[MAP]].concat());
    // The first map measures the link; from then on maps are held back.
    assert!(outcome.oldest_s[5..].iter().all(|age_s| *age_s > 0.0 && *age_s < 0.5), "{:?}", outcome.oldest_s);
    assert_eq!(outcome.maps.iter().sum::<usize>(), 1, "{:?}", outcome.maps);
    assert!(outcome.held_back > 150_000, "the operator sees it");
}

#[test]
fn a_held_map_is_tried_once_a_minute_if_transforms_leave_room() {
    let outcome = run(90, &[LIVE[0], MAP]);
    let late = outcome.oldest_s.iter().filter(|age_s| **age_s >= 0.5).count();
    assert!(
        outcome.maps.iter().sum::<usize>() == 2 && late <= 8,
        "{:?} {:?}",
        outcome.maps,
        outcome.oldest_s
    );
}

#[test]
fn a_second_connection_gets_every_map_it_has_time_for() {
    let outcome = run(30, &[MAP]);
    assert!((9..=12).contains(&outcome.maps.iter().sum::<usize>()), "{:?}", outcome.maps);
    assert_eq!(outcome.held_back, 0);
}
