//! A robot's end and the base's end, joined by a link that is cut, delays, and is taken over.

use link::leadership::SILENCE_MAX;
use link::{
    BaseEnd, BaseEvent, Kind, LocalControl, RobotEnd, RobotEvent, ScanRate, SenderConfig, StopRequest,
};
use msg::tiles::ROBOT_TILES_MAX;
use msg::{
    IndexRect, MapHeader, Monotonic, Pose2, PoseEstimate, Scan, Stamp, Submap, SubmapPoses, TileMap,
    Transforms, VelocityCommand,
};

/// Step of time, milliseconds.
const STEP_MS: u64 = 20;
/// How far the robot's clock is ahead of the base's, milliseconds.
const AHEAD_MS: u64 = 7_000;
/// What the robot sends of scans at most.
const SCANS: ScanRate = ScanRate { period_ms: 100, beams: 180 };

fn scan() -> Box<Scan> {
    let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    (scan.angle_increment_rad, scan.range_min_m, scan.range_max_m, scan.len) = (0.0175, 0.12, 3.5, 360);
    scan.ranges_m[..360].fill(2.0);
    scan
}

/// Two machines.
struct Machines {
    robot: RobotEnd,
    base: BaseEnd,
    map: TileMap,
    now_ms: u64,
    is_cut: bool,
    up_bytes: usize,
    /// What the robot's machine does.
    velocities: Vec<f64>,
    is_stopped: bool,
    /// What the base has got.
    pose_estimates: Vec<PoseEstimate>,
    submaps: Vec<u32>,
    /// Numbers of beams of the scans.
    scans: Vec<usize>,
}

impl Machines {
    fn new() -> Self {
        Self {
            robot: RobotEnd::new(1, 1, SenderConfig::default(), SCANS),
            base: BaseEnd::new(2, 2),
            map: TileMap::new(MapHeader { resolution_m: 0.05, ..MapHeader::default() }),
            now_ms: 1_000,
            is_cut: false,
            up_bytes: 0,
            velocities: Vec::new(),
            is_stopped: false,
            pose_estimates: Vec::new(),
            submaps: Vec::new(),
            scans: Vec::new(),
        }
    }

    fn base_now(&self) -> Monotonic {
        Monotonic(self.now_ms * 1_000_000)
    }

    fn robot_now(&self) -> Monotonic {
        Monotonic((self.now_ms + AHEAD_MS) * 1_000_000)
    }

    fn draw(&mut self, tiles: std::ops::Range<i64>, cell: i8) {
        for x in tiles {
            assert!(self.map.grow_to(IndexRect::single(x, 0), ROBOT_TILES_MAX));
            self.map.get_mut(x, 0).unwrap().cells[7] = cell;
        }
        let now = self.robot_now();
        self.robot.put_map(&self.map, now);
    }

    fn deliver_to_robot(&mut self, messages: Vec<Vec<u8>>) {
        for bytes in messages {
            for event in self.robot.receive(&bytes, self.robot_now()).unwrap() {
                match event {
                    RobotEvent::Velocity(command) => self.velocities.push(command.linear_m_s),
                    RobotEvent::Stop(request) => self.is_stopped = request == StopRequest::Set,
                    RobotEvent::BaseLeads { .. } => {}
                }
            }
        }
    }

    fn deliver_to_base(&mut self, messages: Vec<Vec<u8>>) {
        for bytes in messages {
            self.up_bytes += bytes.len();
            for event in self.base.receive(&bytes, self.base_now()).unwrap() {
                match event {
                    BaseEvent::PoseEstimate(pose_estimate) => self.pose_estimates.push(pose_estimate),
                    BaseEvent::Submap(id) => self.submaps.push(id),
                    BaseEvent::Scan(scan) => self.scans.push(scan.ranges_m.len()),
                    _ => {}
                }
            }
        }
    }

    /// Returns what the base sends now.
    fn base_messages(&mut self) -> Vec<Vec<u8>> {
        let (now, mut down) = (self.base_now(), Vec::new());
        self.base.poll(now, &mut |_, bytes: &[u8]| down.push(bytes.to_vec()));
        down
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms / STEP_MS {
            self.now_ms += STEP_MS;
            let (now, mut up) = (self.robot_now(), Vec::new());
            let mut pose_estimate =
                PoseEstimate { map_from_base: Pose2::new(1.0, 2.0, 0.0), ..PoseEstimate::default() };
            pose_estimate.header.stamp = Stamp(now.0 as i64);
            self.robot.put_pose_estimate(&pose_estimate);
            self.robot.put_transforms(&Transforms::default());
            // A sensor of 10 Hz.
            if self.now_ms.is_multiple_of(100) && self.robot.is_scan_wanted(now) {
                self.robot.put_scan(&scan(), now);
            }
            self.robot.set_local_control(LocalControl {
                is_stopped: Some(self.is_stopped),
                ..LocalControl::default()
            });
            self.robot.poll(now, &mut |_, bytes: &[u8]| up.push(bytes.to_vec()));
            let down = self.base_messages();
            if !self.is_cut {
                self.deliver_to_base(up);
                self.deliver_to_robot(down);
            }
        }
    }

    /// Returns the message with a velocity that the base sends now.
    fn velocity(&mut self) -> Vec<Vec<u8>> {
        let (now, mut down) = (self.base_now(), Vec::new());
        let command = VelocityCommand { linear_m_s: 0.2, ..VelocityCommand::default() };
        self.base.send_velocity(&command, now, &mut |_, bytes: &[u8]| down.push(bytes.to_vec()));
        down
    }

    fn maps_are_equal(&self) -> bool {
        let Some(base) = self.base.map() else { return false };
        let all = self.map.extent().union(base.extent());
        let cells = |map: &TileMap, x, y| map.get(x, y).map(|tile| tile.cells);
        all.points().all(|(x, y)| cells(&self.map, x, y) == cells(base, x, y))
    }
}

#[test]
fn the_base_gets_the_robots_map_and_its_poses() {
    let mut machines = Machines::new();
    machines.draw(0..40, 50);
    machines.run(8_000);
    assert!(machines.maps_are_equal());
    assert_eq!(machines.base.map().unwrap().tiles().count(), 40);
    let count = machines.pose_estimates.len();
    assert!((35..=41).contains(&count), "{count} poses in 8 s");
    assert_eq!(machines.pose_estimates[0].map_from_base, Pose2::new(1.0, 2.0, 0.0));
}

#[test]
fn an_outage_costs_only_what_has_changed() {
    let mut machines = Machines::new();
    machines.draw(0..200, 50);
    machines.run(10_000);
    assert!(machines.maps_are_equal());
    machines.is_cut = true;
    machines.draw(3..4, -20);
    machines.run(60_000);
    assert!(!machines.maps_are_equal());
    machines.is_cut = false;
    machines.up_bytes = 0;
    machines.run(5_000);
    assert!(machines.maps_are_equal(), "caught up within 5 s");
    // Poses, frames and signs of life take 5 s * 5 Hz * 300 bytes of them.
    assert!(machines.up_bytes < 10_000, "{} bytes in the 5 s after the outage", machines.up_bytes);
}

#[test]
fn scans_cross_only_while_somebody_looks() {
    let mut machines = Machines::new();
    machines.run(5_000);
    assert_eq!(machines.scans, [], "nobody looks");
    machines.base.set_scans(Some(ScanRate::new(5.0, 90)));
    machines.run(10_000);
    assert!((45..=52).contains(&machines.scans.len()), "{} scans in 10 s at 5 Hz", machines.scans.len());
    assert!(machines.scans.iter().all(|beams| *beams == 90));
    // Nobody hears them while the link is cut, and afterwards none of them is sent late.
    machines.is_cut = true;
    machines.run(SILENCE_MAX.as_millis() as u64 + 2_000);
    machines.is_cut = false;
    machines.scans.clear();
    machines.run(1_000);
    assert!((3..=6).contains(&machines.scans.len()), "{} scans in 1 s at 5 Hz", machines.scans.len());
    machines.base.set_scans(None);
    machines.run(100);
    machines.scans.clear();
    machines.run(5_000);
    assert_eq!(machines.scans, [], "nobody looks any more");
    // Another base does not inherit the demand of the one before.
    machines.base.set_scans(Some(ScanRate::new(20.0, 1000)));
    machines.run(1_000);
    assert!(
        machines.scans.iter().all(|beams| *beams == 180) && machines.scans.len() <= 11,
        "the robot's own limit"
    );
    machines.base = BaseEnd::new(3, 3);
    machines.run(SILENCE_MAX.as_millis() as u64 + 1_000);
    machines.scans.clear();
    machines.run(2_000);
    assert_eq!(machines.scans, []);
}

#[test]
fn another_base_gets_the_whole_map_and_the_same_one_nothing_twice() {
    let mut machines = Machines::new();
    machines.draw(0..50, 50);
    machines.run(8_000);
    machines.base = BaseEnd::new(3, 3);
    machines.run(SILENCE_MAX.as_millis() as u64 + 2_000);
    assert!(machines.maps_are_equal());
    // The robot's process is started again, and learns what the base holds.
    machines.robot = RobotEnd::new(4, 1, SenderConfig::default(), SCANS);
    machines.draw(0..50, 50);
    machines.run(SILENCE_MAX.as_millis() as u64 + 1_000);
    machines.up_bytes = 0;
    machines.run(5_000);
    assert!(machines.maps_are_equal() && machines.robot.waiting() == 0);
    assert!(machines.up_bytes < 10_000, "{} bytes", machines.up_bytes);
}

#[test]
fn a_robot_that_begins_anew_leaves_nothing_of_its_old_map() {
    let mut machines = Machines::new();
    machines.draw(0..50, 50);
    machines.run(8_000);
    machines.robot = RobotEnd::new(4, 2, SenderConfig::default(), SCANS);
    machines.map = TileMap::new(machines.map.header);
    machines.draw(100..103, 50);
    machines.run(SILENCE_MAX.as_millis() as u64 + 10_000);
    assert!(machines.maps_are_equal());
    assert_eq!(machines.base.map().unwrap().tiles().count(), 3);
}

#[test]
fn before_a_robots_first_state_its_messages_are_of_an_unknown_run() {
    let mut machines = Machines::new();
    machines.draw(0..50, 50);
    machines.run(500);
    machines.robot.put_pose_estimate(&PoseEstimate::default());
    let (now, mut states, mut others) = (machines.robot_now(), Vec::new(), Vec::new());
    machines.robot.poll(Monotonic(now.0 + 1_000_000_000), &mut |kind, bytes: &[u8]| {
        if kind == Kind::RobotState { &mut states } else { &mut others }.push(bytes.to_vec());
    });
    assert!(!states.is_empty() && !others.is_empty());
    // A base's process that was started again.
    let mut base = BaseEnd::new(3, 3);
    for bytes in &others {
        let events = base.receive(bytes, machines.base_now()).unwrap();
        assert!(events.iter().all(|event| matches!(event, BaseEvent::RobotJoined { .. })), "{events:?}");
    }
    let events = base.receive(&states[0], machines.base_now()).unwrap();
    assert!(events.iter().any(|event| matches!(event, BaseEvent::NewRun(1))), "{events:?}");
    assert!(!base.receive(&others[0], machines.base_now()).unwrap().is_empty());
}

#[test]
fn submaps_arrive_and_missing_ones_are_asked_for() {
    let mut machines = Machines::new();
    let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
    (submap.id, submap.grid.resolution_m, submap.grid.width, submap.grid.height) = (1, 0.05, 80, 60);
    submap.cells[17] = 40;
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    poses.len = 2;
    let now = machines.robot_now();
    machines.robot.put_submap(&submap, now);
    machines.robot.put_submap_poses(&poses, now);
    assert!(machines.robot.needs_submaps(now), "submap 0 never came");
    assert!(!machines.robot.needs_submaps(now), "not again at once");
    machines.run(6_000);
    assert_eq!(machines.submaps, [1]);
    assert!(*machines.base.submap(1).unwrap() == *submap);
    // SLAM begins anew with one submap.
    poses.len = 1;
    let now = machines.robot_now();
    machines.robot.put_submap_poses(&poses, now);
    machines.run(6_000);
    assert_eq!(machines.base.submap_ids().count(), 0);
}

#[test]
fn a_velocity_is_obeyed_unless_it_waited() {
    let mut machines = Machines::new();
    let early = machines.velocity();
    machines.deliver_to_robot(early);
    assert!(machines.velocities.is_empty(), "it answers nothing that the robot said");
    machines.run(1_000);
    let fresh = machines.velocity();
    machines.deliver_to_robot(fresh);
    assert_eq!(machines.velocities, [0.2]);
    let waiting = machines.velocity();
    machines.run(600);
    machines.deliver_to_robot(waiting);
    assert_eq!(machines.velocities, [0.2], "what waited in the network moves no robot");
    // A base that no longer hears the robot drives blindly.
    machines.is_cut = true;
    machines.run(600);
    let blind = machines.velocity();
    machines.deliver_to_robot(blind);
    assert_eq!(machines.velocities, [0.2]);
}

#[test]
fn the_stop_of_the_base_holds_on_the_robot_when_the_base_is_replaced() {
    let mut machines = Machines::new();
    machines.base.set_stopped(Some(false));
    machines.run(1_000);
    machines.base.set_stopped(Some(true));
    machines.run(2 * STEP_MS);
    assert!(machines.is_stopped, "a stop waits for no period");
    machines.base = BaseEnd::new(3, 3);
    machines.base.set_stopped(Some(false));
    machines.run(SILENCE_MAX.as_millis() as u64 + 1_000);
    assert!(machines.is_stopped, "a base that never stopped the robot does not release it");
    machines.base.set_stopped(Some(true));
    machines.run(100);
    machines.base.set_stopped(Some(false));
    machines.run(100);
    assert!(!machines.is_stopped, "stopped and released by the base that leads");
}

/// TCP holds back all that follows a lost packet until packets after it show that it is lost.
#[test]
fn a_change_of_the_stop_is_repeated_at_once_and_not_for_ever() {
    let mut machines = Machines::new();
    machines.base.set_stopped(Some(false));
    machines.run(1_000);
    machines.base.set_stopped(Some(true));
    let lost = machines.base_messages();
    assert!(!lost.is_empty() && !machines.is_stopped);
    machines.run(2 * STEP_MS);
    assert!(machines.is_stopped, "the repetition is there before the next sign of life");
    // What a second has when nothing changes.
    machines.run(1_000);
    let messages: usize = (0..1_000 / STEP_MS)
        .map(|_| {
            machines.now_ms += STEP_MS;
            machines.base_messages().len()
        })
        .sum();
    assert!((4..=6).contains(&messages), "{messages} messages in a second in which nothing changed");
}

#[test]
fn a_second_base_may_stop_the_robot_and_nothing_else_while_the_first_leads() {
    let mut machines = Machines::new();
    machines.base.set_stopped(Some(false));
    machines.run(1_000);
    let first = std::mem::replace(&mut machines.base, BaseEnd::new(9, 9));
    let velocity = machines.velocity();
    machines.deliver_to_robot(velocity);
    assert!(machines.velocities.is_empty() && machines.robot.refused() > 0);
    for is_stopped in [true, false] {
        machines.base.set_stopped(Some(is_stopped));
        let second = machines.base_messages();
        assert!(!second.is_empty());
        machines.deliver_to_robot(second);
        assert_eq!(machines.is_stopped, is_stopped);
    }
    machines.base = first;
    machines.draw(0..5, 50);
    machines.run(5_000);
    assert!(machines.maps_are_equal());
}

#[test]
fn without_its_map_a_robot_costs_less_than_2_kb_a_second() {
    let mut machines = Machines::new();
    machines.run(1_000);
    machines.up_bytes = 0;
    machines.run(60_000);
    // The burger's frames are six; the transforms of these tests have none.
    let frames = 6 * 30 * 5 * 60;
    let bytes_per_s = (machines.up_bytes + frames) / 60;
    assert!((1_500..2_000).contains(&bytes_per_s), "{bytes_per_s} bytes a second");
    let counted: u64 = machines.robot.sent().rows().map(|(_, bytes, _)| bytes).sum();
    assert_eq!(counted, machines.base.received().bytes(), "both ends count the same");
}
