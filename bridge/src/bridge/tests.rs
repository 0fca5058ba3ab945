//! Tests of clients on weak links: a simulated socket that takes a few kB/s, on simulated time.

use super::*;
use crate::command::Registration;
use crate::frame::Side;
use crate::router::SEND_BUFFER_FIRST;
use bytemuck::Zeroable;
use msg::{GridHeader, GridView, RobotFrame, Scan, Transforms};
use proptest::prelude::*;
use ros_messages::{Clock, LaserScan, Message, OccupancyGrid, OccupancyGridUpdate, TfMessage};
use std::cell::Cell;
use std::io::IoSlice;
use std::rc::Rc;

/// What a weak link carries, bytes per second.
const RATE: f64 = 60e3;
/// The oldest that the newest transform at a client may become, seconds.
const AGE_MAX_S: f64 = 0.5;

/// A socket whose kernel buffer drains at a constant rate.
struct SlowLink {
    now: Cell<u64>,
    rate: Cell<f64>,
    kernel_bytes: Cell<usize>,
    is_full: Cell<bool>,
    /// Bytes in the kernel, and all bytes that were ever written.
    waiting: Cell<f64>,
    written: RefCell<Vec<u8>>,
}

impl SlowLink {
    fn new(rate: f64) -> Rc<Self> {
        Rc::new(Self {
            now: Cell::default(),
            rate: Cell::new(rate),
            kernel_bytes: Cell::new(2 * SEND_BUFFER_FIRST),
            is_full: Cell::default(),
            waiting: Cell::default(),
            written: RefCell::default(),
        })
    }

    /// Sets the time; what the link has carried meanwhile leaves the kernel.
    fn advance_to(&self, now_ns: u64) {
        let elapsed_s = (now_ns - self.now.replace(now_ns)) as f64 * 1e-9;
        self.waiting.set((self.waiting.get() - self.rate.get() * elapsed_s).max(0.0));
    }

    /// Returns the number of bytes that have reached the client.
    fn arrived(&self) -> usize {
        self.written.borrow().len() - self.waiting.get().ceil() as usize
    }
}

impl ClientSocket for Rc<SlowLink> {
    fn try_write(&self, slices: &[IoSlice<'_>]) -> std::io::Result<usize> {
        let kernel_bytes = self.kernel_bytes.get();
        let mut space = kernel_bytes.saturating_sub(self.waiting.get() as usize);
        // A full socket is writable again when a third of its buffer is free.
        self.is_full.set(space < if self.is_full.get() { kernel_bytes / 3 } else { 1 });
        if self.is_full.get() {
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

    fn set_send_buffer(&self, bytes: usize) {
        self.kernel_bytes.set(2 * bytes);
    }

    fn now(&self) -> Monotonic {
        Monotonic(self.now.get())
    }

    fn wake(&self) {}
}

/// What a fleet of three publishes, and the client of it.
struct World {
    bridge: Bridge,
    link: Rc<SlowLink>,
    client: ClientId,
    parser: crate::frame::Parser,
    read: usize,
    scan: Box<Scan>,
    map: GridHeader,
    cells: Vec<i8>,
    ms: u64,
    outcome: Outcome,
}

/// What arrived at the client.
#[derive(Default)]
struct Outcome {
    /// Stamp of the newest transform, and the oldest that it became, seconds.
    newest_ms: Option<u64>,
    oldest_s: f64,
    /// When maps arrived, milliseconds, and their cell size, metres.
    maps: Vec<(u64, f32)>,
    updates: usize,
}

impl World {
    /// Creates a fleet with a map of so many cells that has been published already, and a client without topics.
    fn new(rate: f64, width: u32, height: u32) -> Self {
        let bridge = Bridge::new(BridgeConfig::default(), 3, |_, _| {}).unwrap();
        let link = SlowLink::new(rate);
        let map = GridHeader { width, height, resolution_m: 0.05, ..Default::default() };
        let cells = vec![0; (width * height) as usize];
        bridge.publish(FleetMessage::MergedMap(GridView::new(&map, &cells).unwrap()));
        let client = bridge.connect_socket(([10, 0, 0, 2], 1).into(), Box::new(link.clone())).unwrap();
        let parser = crate::frame::Parser::new(1 << 25);
        let scan = Box::new(Scan { len: 180, ..Scan::zeroed() });
        let (read, ms, outcome) = (0, 0, Outcome::default());
        Self { bridge, link, client, parser, read, scan, map, cells, ms, outcome }
    }

    fn subscribe(&self, topics: &[(&str, &str)]) {
        for (topic, message_type) in topics {
            let (topic, message_name) = ((*topic).to_owned(), (*message_type).to_owned());
            let mut bytes = Vec::new();
            let registration = Registration { topic, message_name, ..Registration::default() };
            Side::Client.write_command(&mut bytes, crate::command::name::SUBSCRIBE, &registration);
            let mut parser = crate::frame::Parser::new(1 << 20);
            parser.push(&bytes);
            let now = Monotonic(self.ms * 1_000_000);
            self.bridge.receive(self.client, parser.next_frame().unwrap().unwrap(), now);
            self.bridge.flush();
        }
    }

    /// Publishes what is due: 20 Hz transforms, 10 Hz scans, 100 Hz clock, a map each second.
    fn publish(&mut self) {
        let (ms, bridge) = (self.ms, &self.bridge);
        for robot in RobotId::first(3) {
            if ms.is_multiple_of(50) {
                let mut transforms = Transforms { len: 6, ..Default::default() };
                transforms.header.stamp = Stamp(ms as i64 * 1_000_000);
                for transform in &mut transforms.transforms[..6] {
                    (transform.parent_frame, transform.child_frame) =
                        (RobotFrame::BaseFootprint as u32, RobotFrame::BaseLink as u32);
                }
                bridge.publish(FleetMessage::Transforms(robot, &transforms));
            }
            if ms.is_multiple_of(100) {
                bridge.publish(FleetMessage::Scan(robot, &self.scan));
            }
        }
        if ms.is_multiple_of(1000) {
            let changed = ms as usize / 1000 % self.cells.len();
            self.cells[changed] = 127;
            bridge.publish(FleetMessage::MergedMap(GridView::new(&self.map, &self.cells).unwrap()));
        }
        if ms.is_multiple_of(10) {
            bridge.publish(FleetMessage::Clock(&msg::Clock::default()));
        }
        if ms.is_multiple_of(250) {
            bridge.tick(Monotonic(ms * 1_000_000));
        }
    }

    /// Runs for so long.
    fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.link.advance_to(self.ms * 1_000_000);
            self.publish();
            if self.bridge.is_blocked(self.client).unwrap() {
                self.bridge.flush_client(self.client);
            }
            self.receive();
            self.ms += 1;
        }
    }

    /// Reads what has arrived.
    fn receive(&mut self) {
        let arrived = self.link.arrived().max(self.read);
        self.parser.push(&self.link.written.borrow()[self.read..arrived]);
        self.read = arrived;
        let outcome = &mut self.outcome;
        while let Some(frame) = self.parser.next_frame().unwrap() {
            match frame.name {
                b"/tf" => {
                    let tf: TfMessage = ros_messages::decode(frame.payload).unwrap();
                    outcome.newest_ms = Some((tf.transforms[0].stamp.0 / 1_000_000) as u64);
                }
                b"/merged_map" => {
                    let map: OccupancyGrid = ros_messages::decode(frame.payload).unwrap();
                    outcome.maps.push((self.ms, map.resolution));
                }
                b"/merged_map_updates" | b"/map_updates" => outcome.updates += 1,
                _ => {}
            }
        }
        if let Some(newest_ms) = outcome.newest_ms {
            outcome.oldest_s = outcome.oldest_s.max((self.ms - newest_ms) as f64 * 1e-3);
        }
    }

    fn status(&self) -> ClientStatus {
        self.bridge.clients(Monotonic(self.ms * 1_000_000)).remove(0)
    }
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
fn at_60_kb_per_s_the_newest_transform_is_never_half_a_second_old_the_first_map_included() {
    let mut world = World::new(RATE, 500, 300);
    // The map first: it is not known yet that transforms will follow.
    world.subscribe(&[&[MAP], &LIVE[..]].concat());
    world.run(60_000);
    assert!(world.outcome.oldest_s < AGE_MAX_S, "{}", world.outcome.oldest_s);
    let maps = &world.outcome.maps;
    assert!(maps[0].0 < 1000 && maps.len() >= 20, "{maps:?}");
    assert!(maps.iter().all(|(_, resolution)| (0.1..0.4).contains(resolution)), "{maps:?}");
    let status = world.status();
    assert_eq!(status.reduced_maps, 1, "the operator sees it");
    assert!((0.05..AGE_MAX_S).contains(&status.live_delay_s), "{status:?}");
}

#[test]
fn a_fast_link_gets_the_whole_map_at_once_and_a_link_that_becomes_fast_gets_it_then() {
    let mut fast = World::new(20e6, 500, 300);
    fast.subscribe(&[&LIVE[..], &[MAP]].concat());
    fast.run(300);
    assert_eq!(fast.outcome.maps.last().unwrap().1, 0.05, "{:?}", fast.outcome.maps);
    assert!(fast.outcome.oldest_s <= 0.06 && fast.status().reduced_maps == 0);
    let mut recovering = World::new(RATE, 500, 300);
    recovering.subscribe(&[&LIVE[..], &[MAP]].concat());
    recovering.run(20_000);
    assert_eq!(recovering.status().reduced_maps, 1);
    recovering.link.rate.set(5e6);
    recovering.run(10_000);
    assert_eq!(recovering.outcome.maps.last().unwrap().1, 0.05, "{:?}", recovering.outcome.maps);
}

#[test]
fn a_client_whose_map_has_larger_cells_gets_no_updates_of_it() {
    let updates = ("/map_updates", OccupancyGridUpdate::TYPE);
    let map = ("/map", OccupancyGrid::TYPE);
    let mut slow = World::new(RATE, 500, 300);
    slow.subscribe(&[LIVE[0], map, updates]);
    slow.run(10_000);
    assert_eq!((slow.outcome.updates, slow.status().reduced_maps), (0, 1));
    let mut fast = World::new(20e6, 500, 300);
    fast.subscribe(&[LIVE[0], map, updates]);
    fast.run(10_000);
    assert!(fast.outcome.updates >= 8 && fast.status().reduced_maps == 0, "{}", fast.outcome.updates);
}

#[test]
fn a_second_connection_gets_every_whole_map_it_has_time_for() {
    let mut world = World::new(RATE, 500, 300);
    world.subscribe(&[MAP]);
    world.run(30_000);
    let whole = world.outcome.maps.iter().filter(|(_, resolution)| *resolution == 0.05).count();
    assert!((9..=12).contains(&whole), "{:?}", world.outcome.maps);
    assert_eq!(world.status().held_back_bytes, 0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]
    #[test]
    fn the_newest_transform_is_never_half_a_second_old_whatever_the_rate_and_the_map(
        kilobytes_s in 60_u32..3000, side in 40_u32..1200, late_ms in 0_u64..3000, map_first in any::<bool>(),
    ) {
        let mut world = World::new(f64::from(kilobytes_s) * 1e3, side, side);
        world.run(late_ms);
        let topics = if map_first { [MAP, LIVE[0]] } else { [LIVE[0], MAP] };
        world.subscribe(&topics);
        world.subscribe(&LIVE[1..]);
        world.run(8000);
        prop_assert!(world.outcome.oldest_s < AGE_MAX_S, "{} s", world.outcome.oldest_s);
        prop_assert!(!world.outcome.maps.is_empty());
    }
}
