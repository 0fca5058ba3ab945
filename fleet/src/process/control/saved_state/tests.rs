//! Tests of the files that a restarted bridge continues with.

use super::*;
use crate::config::FleetConfig;
use crate::emergency_stop_file::latch_stop;
use crate::storage::DiskStorage;
use ::bridge::command::{Registration, name};
use ::bridge::frame::{Parser, Side};
use ::bridge::ros::{Int32, Message, Twist, encode};
use ::bridge::{BridgeConfig, ClientId};
use msg::VelocityCommand;
use std::cell::RefCell;
use std::rc::Rc;

const HOLDER: [u8; 4] = [10, 0, 0, 7];
const STRANGER: [u8; 4] = [10, 0, 0, 8];

/// A bridge of two robots with its files, as one process has them.
struct Process {
    bridge: Bridge,
    files: SavedFiles<DiskStorage>,
    begun: Monotonic,
    stops_applied: u64,
    moved: Rc<RefCell<Vec<usize>>>,
}

impl Process {
    fn start(run: &Run, now: Monotonic) -> Self {
        let moved = Rc::new(RefCell::new(Vec::new()));
        let sink = moved.clone();
        let on_command = move |robot: RobotId, command: VelocityCommand| {
            if command.linear_m_s != 0.0 {
                sink.borrow_mut().push(robot.number());
            }
        };
        let bridge = Bridge::new(run.config.bridge.clone(), 2, on_command).unwrap();
        let files = SavedFiles::restore(&bridge, run, DiskStorage, now);
        Self { bridge, files, begun: run.begun, stops_applied: 0, moved }
    }

    /// Brings files and bridge together, as the control does.
    fn update(&mut self, now: Monotonic) {
        let snapshot = BridgeSnapshot::take(&self.bridge, self.begun, self.stops_applied, now);
        self.files.update(&snapshot).unwrap();
        let stops_found = self.files.stops_found();
        self.set_stop(stops_found);
    }

    fn set_stop(&mut self, stops_found: u64) {
        if stops_found > self.stops_applied {
            self.stops_applied = stops_found;
            self.bridge.stop_robots();
        }
    }

    fn send<M: Message>(&self, address: [u8; 4], topic: &str, message: &M, now: Monotonic) -> ClientId {
        let client = self.bridge.connect((address, 5000).into()).unwrap();
        let mut bytes = Vec::new();
        let registration =
            Registration { topic: topic.into(), message_name: M::TYPE.into(), ..Default::default() };
        Side::Client.write_command(&mut bytes, name::PUBLISH, &registration);
        Side::Client.write_with(&mut bytes, topic, |out| encode(message, out));
        let mut parser = Parser::new(1 << 20);
        parser.push(&bytes);
        while let Some(frame) = parser.next_frame().unwrap() {
            self.bridge.receive(client, frame, now);
        }
        client
    }

    fn take_moved(&self) -> Vec<usize> {
        std::mem::take(&mut self.moved.borrow_mut())
    }
}

fn run_in(folder: &Path) -> Run {
    let bridge = BridgeConfig { drive: ::bridge::Permission::Anyone, ..Default::default() };
    let config = FleetConfig { bridge, ..FleetConfig::default() };
    let mut run = Run::in_memory(config).unwrap();
    run.dir = folder.into();
    run
}

fn at_ms(ms: u64) -> Monotonic {
    Monotonic(ms * 1_000_000)
}

#[test]
fn a_restarted_bridge_keeps_the_selection_and_the_robot_for_its_driver() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let twist = Twist { linear: [0.1, 0.0, 0.0], ..Default::default() };
    let mut before = Process::start(&run, at_ms(0));
    before.send(HOLDER, "/selected_robot", &Int32(2), at_ms(10));
    before.send(HOLDER, "/cmd_vel", &twist, at_ms(20));
    before.update(at_ms(30));
    assert_eq!(before.take_moved(), [2]);

    let after = Process::start(&run, at_ms(1_000));
    assert_eq!(after.bridge.selected_robot().number(), 2);
    after.send(STRANGER, "/cmd_vel", &twist, at_ms(1_100));
    assert!(after.take_moved().is_empty(), "a stranger does not profit");
    after.send(HOLDER, "/cmd_vel", &twist, at_ms(1_200));
    assert_eq!(after.take_moved(), [2], "its driver drives the same robot");
    let again = Process::start(&run, at_ms(1_000));
    again.send(STRANGER, "/cmd_vel", &twist, at_ms(6_000));
    assert_eq!(again.take_moved(), [2], "it is not kept for ever");

    let mut other = run;
    other.begun = Monotonic(7);
    let selected = Process::start(&other, at_ms(0)).bridge.selected_robot();
    assert_eq!(selected.number(), 1, "another run in this folder begins anew");
}

#[test]
fn the_emergency_stop_on_the_disk_is_the_bridges() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_in(folder.path());
    let path = stop_file(&run.dir);
    let mut process = Process::start(&run, at_ms(0));
    process.update(at_ms(0));
    assert!(!process.bridge.is_stopped() && !path.exists());

    latch_stop(&DiskStorage, &path, at_ms(1)).unwrap();
    process.update(at_ms(100));
    assert!(process.bridge.is_stopped(), "the bridge reads what `mr-slam stop` writes");
    let mut next = Process::start(&run, at_ms(200));
    assert!(next.bridge.is_stopped(), "it holds across a restart");

    next.bridge.release_stop();
    next.update(at_ms(300));
    assert!(!next.bridge.is_stopped() && !path.exists());
    next.bridge.stop_robots();
    next.update(at_ms(400));
    assert!(path.exists());

    // A release that waited in a frozen bridge does not undo a stop that was set after it.
    latch_stop(&DiskStorage, &path, at_ms(500)).unwrap();
    next.bridge.release_stop();
    next.update(at_ms(600));
    assert!(next.bridge.is_stopped() && path.exists());

    // A stop that was written while a snapshot was on its way is not released by it.
    let released =
        BridgeSnapshot { is_stopped: false, ..BridgeSnapshot::take(&next.bridge, run.begun, 1, at_ms(610)) };
    latch_stop(&DiskStorage, &path, at_ms(620)).unwrap();
    next.files.update(&released).unwrap();
    let found = next.files.stops_found();
    assert!(path.exists() && found > next.stops_applied);
    next.set_stop(found);
    assert!(next.bridge.is_stopped());

    // Somebody removes the file: the stop holds, and is written again.
    std::fs::remove_file(&path).unwrap();
    next.update(at_ms(700));
    assert!(next.bridge.is_stopped() && path.exists());
}
