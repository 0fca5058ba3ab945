//! A robot's end and the base's end on queues in memory, joined by a link that can be cut.

use super::{BaseLink, POLL_PERIOD, RobotLink, StopControl};
use crate::channel::{self, Opener, Program};
use crate::config::{FleetConfig, RobotSource};
use crate::lockstep::faults::FaultPlan;
use crate::lockstep::queues::{
    MemoryPorts, Network, QueueMapReader, QueueMapWriter, QueueReader, QueueWriter,
};
use crate::ports::{Ports, ReadMapPort, ReadPort, WriteMapPort, WritePort};
use crate::process::ProcessLoop;
use crate::run::Run;
use ::link::{Kind, LocalControl};
use link_transport::Transport;
use msg::tiles::ROBOT_TILES_MAX;
use msg::{
    Header, IndexRect, MapHeader, Monotonic, PauseReason, PoseEstimate, RobotHold, RobotId, Role, Scan,
    ScanDemand, ScanPurpose, Stamp, SubmapPoses, TileMap, Transforms, VelocityCommand,
};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

const ROBOT: RobotId = RobotId::new(1).unwrap();
/// How far the robot's clock is ahead of the base's, nanoseconds.
const AHEAD_NS: u64 = 5_000_000_000;

/// Messages with their robots' indices.
type Messages = VecDeque<(usize, Vec<u8>)>;

/// One direction of a cable.
#[derive(Clone, Default)]
struct CableDirection {
    waiting: Rc<RefCell<Messages>>,
    is_cut: Rc<Cell<bool>>,
    bytes: Rc<Cell<usize>>,
}

/// One end of a cable.
struct Cable {
    out: CableDirection,
    back: CableDirection,
}

impl Transport for Cable {
    fn send(&mut self, robot: usize, _: Kind, bytes: &[u8]) {
        if !self.out.is_cut.get() {
            self.out.bytes.set(self.out.bytes.get() + bytes.len());
            self.out.waiting.borrow_mut().push_back((robot, bytes.to_vec()));
        }
    }
    fn receive(&mut self) -> Option<(usize, Vec<u8>)> {
        self.back.waiting.borrow_mut().pop_front()
    }
}

#[derive(Clone, Default)]
struct Stop(Rc<Cell<bool>>, Rc<Cell<u32>>);

impl StopControl for Stop {
    fn local_control(&self) -> LocalControl {
        let (is_stopped, interruptions) = (Some(self.0.get()), self.1.get());
        LocalControl { is_stopped, interruptions, ..LocalControl::default() }
    }
    fn request(&mut self, stop: bool) {
        self.0.set(stop);
    }
}

type Robot = RobotLink<MemoryPorts, Cable, Stop>;
type Base = BaseLink<MemoryPorts, Cable, Stop>;

/// What SLAM and the simulator write on the robot's machine, and what its bridge reads.
struct RobotSide {
    network: Rc<Network>,
    link: Robot,
    map: TileMap,
    map_writer: QueueMapWriter,
    pose_estimates: QueueWriter<PoseEstimate>,
    transforms: QueueWriter<Transforms>,
    scans: QueueWriter<Scan>,
    velocities: QueueReader<VelocityCommand>,
    stop: Stop,
}

/// What the base's processes read, and its bridge writes.
struct BaseSide {
    network: Rc<Network>,
    link: Base,
    map: QueueMapReader,
    pose_estimates: QueueReader<PoseEstimate>,
    submap_poses: QueueReader<SubmapPoses>,
    scans: QueueReader<Scan>,
    demand: QueueWriter<ScanDemand>,
    commands: QueueWriter<VelocityCommand>,
    holds: QueueReader<RobotHold>,
    stop: Stop,
}

struct Machines {
    robot: RobotSide,
    base: BaseSide,
    up: CableDirection,
    down: CableDirection,
    now: u64,
}

fn run(world: RobotSource) -> Run {
    let mut config = FleetConfig { world, ..FleetConfig::default() };
    config.fleet.robots = 1;
    Run::in_memory(config).unwrap()
}

fn ports(network: &Rc<Network>, role: Role) -> MemoryPorts {
    let robot = matches!(role, Role::Sim | Role::Slam).then_some(ROBOT);
    MemoryPorts::attach(network, Opener { program: role.into(), robot })
}

fn link_ports(network: &Rc<Network>) -> MemoryPorts {
    MemoryPorts::attach(network, Opener::of_fleet(Program::LinkTool))
}

impl RobotSide {
    /// A link process of the machine's run that began at `begun`.
    fn new(cable: Cable, session: u64, begun: u64) -> Self {
        let network = Network::new(FaultPlan::none());
        let (slam, sim) = (ports(&network, Role::Slam), ports(&network, Role::Sim));
        let stop = Stop::default();
        let mut run = run(RobotSource::Simulator);
        run.begun = Monotonic(begun);
        let link = RobotLink::open(&link_ports(&network), &run, cable, stop.clone(), session);
        let map = TileMap::new(MapHeader { resolution_m: 0.05, ..MapHeader::default() });
        Self {
            link: link.unwrap(),
            map,
            map_writer: slam.map_writer(&channel::map(ROBOT)).unwrap(),
            pose_estimates: slam.writer(&channel::pose_estimate(ROBOT)).unwrap(),
            transforms: sim.writer(&channel::transforms(ROBOT)).unwrap(),
            scans: sim.writer(&channel::scan(ROBOT)).unwrap(),
            velocities: ports(&network, Role::Bridge).reader(&channel::base_velocity(ROBOT)).unwrap(),
            stop,
            network,
        }
    }

    fn draw(&mut self, x: i64, cell: i8) {
        assert!(self.map.grow_to(IndexRect::single(x, 0), ROBOT_TILES_MAX));
        self.map.get_mut(x, 0).unwrap().cells[7] = cell;
    }

    fn step(&mut self, now: u64) {
        self.network.clock().set(Monotonic(now));
        let header = Header { stamp: Stamp(now as i64), ..Header::default() };
        self.map.header.header.stamp = header.stamp;
        self.map_writer.send(&self.map);
        self.pose_estimates.send(&PoseEstimate { header, ..PoseEstimate::default() });
        self.transforms.send(&Transforms { header, ..Transforms::default() });
        self.scans.send_with(|scan| {
            (scan.range_min_m, scan.range_max_m, scan.angle_increment_rad) = (0.12, 3.5, 0.0175);
            scan.ranges_m[..360].fill(1.75);
            scan.len = 360;
            scan.header.stamp = header.stamp;
        });
        self.link.step();
    }
}

impl BaseSide {
    /// The only link process of its base's run.
    fn new(cable: Cable, session: u64) -> Self {
        let network = Network::new(FaultPlan::none());
        let stop = Stop::default();
        let mut run = run(RobotSource::Robots);
        run.begun = Monotonic(session);
        let link = BaseLink::open(&link_ports(&network), &run, cable, stop.clone(), session);
        let merge = ports(&network, Role::Merge);
        Self {
            link: link.unwrap(),
            map: merge.map_reader(&channel::map(ROBOT)).unwrap(),
            pose_estimates: merge.reader(&channel::pose_estimate(ROBOT)).unwrap(),
            submap_poses: merge.reader(&channel::submap_poses(ROBOT)).unwrap(),
            scans: ports(&network, Role::Nav).reader(&channel::scan(ROBOT)).unwrap(),
            demand: ports(&network, Role::Bridge).writer(&channel::scan_demand()).unwrap(),
            holds: ports(&network, Role::Nav).reader(&channel::hold(ROBOT)).unwrap(),
            commands: ports(&network, Role::Bridge).writer(&channel::command(ROBOT)).unwrap(),
            stop,
            network,
        }
    }
}

impl Machines {
    fn new() -> Self {
        let (up, down) = (CableDirection::default(), CableDirection::default());
        let robot = RobotSide::new(Cable { out: up.clone(), back: down.clone() }, 1, 1);
        let base = BaseSide::new(Cable { out: down.clone(), back: up.clone() }, 2);
        Self { robot, base, up, down, now: 1_000_000_000 }
    }

    fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / POLL_PERIOD.as_secs_f64()) as usize {
            self.now += POLL_PERIOD.as_nanos() as u64;
            self.robot.step(self.now + AHEAD_NS);
            self.base.network.clock().set(Monotonic(self.now));
            self.base.link.step();
            self.base.map.poll();
        }
    }

    fn cut(&mut self, is_cut: bool) {
        self.up.is_cut.set(is_cut);
        self.down.is_cut.set(is_cut);
    }

    fn replace_robot(&mut self, session: u64, begun: u64) {
        self.robot = RobotSide::new(Cable { out: self.up.clone(), back: self.down.clone() }, session, begun);
    }

    fn replace_base(&mut self, session: u64) {
        self.base = BaseSide::new(Cable { out: self.down.clone(), back: self.up.clone() }, session);
    }

    /// Whether the base's map of the robot has the same cells as the robot's own.
    fn maps_are_equal(&self) -> bool {
        let (own, base) = (&self.robot.map, self.base.map.map());
        let all = own.extent().union(base.extent());
        all.points().all(|(x, y)| own.get(x, y).map(|t| t.cells) == base.get(x, y).map(|t| t.cells))
    }

    fn drive(&mut self) -> Option<f64> {
        self.base.commands.send(&VelocityCommand { linear_m_s: 0.2, ..VelocityCommand::default() });
        self.run(0.04);
        self.robot.velocities.newest().map(|command| command.linear_m_s)
    }
}

#[test]
fn the_base_gets_the_robots_map_and_its_poses_by_its_own_clock() {
    let mut machines = Machines::new();
    (0..40).for_each(|x| machines.robot.draw(x, 50));
    machines.run(8.0);
    assert!(machines.maps_are_equal() && machines.base.map.map().tiles().count() == 40);
    let pose_estimate = machines.base.pose_estimates.newest().expect("poses come five times a second");
    let late_s = (machines.now as i64 - pose_estimate.header.stamp.0) as f64 * 1e-9;
    // The epochs of both runs are 0, so that the clocks differ by exactly that much.
    assert!((0.0..0.3).contains(&late_s), "the pose is {late_s} s old by the base's clock");
}

#[test]
fn the_base_gets_scans_by_its_own_clock_while_it_repeats_that_it_wants_them() {
    let mut machines = Machines::new();
    let mut run_with = |demand: Option<ScanPurpose>, seconds: usize| {
        let mut scans = Vec::new();
        for _ in 0..2 * seconds {
            if let Some(purpose) = demand {
                let robots = ScanDemand::set_of([ROBOT]);
                let purpose = purpose as u32;
                machines.base.demand.send(&ScanDemand { robots, purpose, ..ScanDemand::default() });
            }
            machines.run(0.5);
            while let Some(scan) = machines.base.scans.receive() {
                let late_s = (machines.now as i64 - scan.header.stamp.0) as f64 * 1e-9;
                assert!((0.0..0.6).contains(&late_s), "the scan is {late_s} s old by the base's clock");
                scans.push(scan.len);
            }
        }
        scans
    };
    assert_eq!(run_with(None, 3), Vec::<u32>::new(), "nobody looks");
    let viewed = run_with(Some(ScanPurpose::Viewing), 4);
    assert!((17..=21).contains(&viewed.len()) && viewed.iter().all(|len| *len == 180), "{viewed:?}");
    let driven = run_with(Some(ScanPurpose::Navigation), 4);
    assert!((36..=42).contains(&driven.len()), "{driven:?}");
    // A demand that is not repeated ends.
    run_with(None, 2);
    assert_eq!(run_with(None, 3), Vec::<u32>::new());
}

#[test]
fn an_outage_costs_only_what_has_changed() {
    let mut machines = Machines::new();
    (0..200).for_each(|x| machines.robot.draw(x, 50));
    machines.run(10.0);
    assert!(machines.maps_are_equal());
    machines.cut(true);
    machines.robot.draw(3, -20);
    machines.run(60.0);
    assert!(!machines.maps_are_equal());
    machines.cut(false);
    let before = machines.up.bytes.get();
    machines.run(5.0);
    assert!(machines.maps_are_equal(), "caught up within 5 s");
    let bytes = machines.up.bytes.get() - before;
    assert!(bytes < 10_000, "{bytes} bytes in the 5 s after the outage");
}

#[test]
fn another_base_gets_the_whole_map() {
    let mut machines = Machines::new();
    (0..50).for_each(|x| machines.robot.draw(x, 50));
    machines.run(8.0);
    machines.replace_base(3);
    machines.run(8.0);
    assert!(machines.maps_are_equal());
}

#[test]
fn a_robot_whose_machine_began_anew_is_told_from_one_whose_link_did() {
    let mut machines = Machines::new();
    (0..50).for_each(|x| machines.robot.draw(x, 50));
    machines.run(8.0);
    let first = machines.base.submap_poses.newest().expect("poses say the frame").map_frame;
    machines.replace_robot(3, 1);
    (0..50).for_each(|x| machines.robot.draw(x, 50));
    machines.run(8.0);
    assert!(machines.base.submap_poses.newest().is_none_or(|poses| poses.map_frame == first));
    machines.replace_robot(4, 2);
    machines.robot.draw(90, 50);
    machines.run(12.0);
    let poses = machines.base.submap_poses.newest().expect("merging is told at once");
    assert!(poses.map_frame != first && poses.poses().is_empty());
    assert!(machines.maps_are_equal() && machines.base.map.map().tiles().count() == 1);
}

#[test]
fn a_velocity_of_the_base_reaches_the_robot_unless_it_waited() {
    let mut machines = Machines::new();
    machines.run(1.0);
    assert_eq!(machines.drive(), Some(0.2));
    machines.cut(true);
    assert_eq!(machines.drive(), None);
    machines.cut(false);
    // A velocity that was sent, and waits in a queue of the network for a second.
    machines.base.commands.send(&VelocityCommand { linear_m_s: 0.2, ..VelocityCommand::default() });
    machines.base.network.clock().set(Monotonic(machines.now));
    machines.base.link.step();
    let waiting = machines.down.waiting.take();
    machines.run(1.0);
    machines.down.waiting.borrow_mut().extend(waiting);
    machines.run(0.1);
    assert!(machines.robot.velocities.newest().is_none(), "an old velocity moves no robot");
}

#[test]
fn the_emergency_stop_of_the_base_is_set_on_the_robot_and_outlives_the_base() {
    let mut machines = Machines::new();
    machines.run(1.0);
    machines.base.stop.0.set(true);
    machines.run(0.3);
    assert!(machines.robot.stop.0.get(), "within 0.3 s");
    machines.replace_base(3);
    machines.run(5.0);
    assert!(machines.robot.stop.0.get(), "a base that never stopped the robot does not release it");
}

#[test]
fn a_stop_at_the_robots_machine_reaches_the_base_and_outdates_its_velocities() {
    let mut machines = Machines::new();
    machines.run(1.0);
    let before = *machines.base.holds.newest().expect("the base says that nothing holds the robot");
    assert_eq!(before.reason(), None);
    // A stop that is released before the base hears of it.
    machines.robot.stop.1.set(1);
    machines.run(0.3);
    let after = *machines.base.holds.newest().expect("the base is told");
    assert_eq!((after.interruptions, after.reason()), (before.interruptions + 1, None));
    machines.robot.stop.0.set(true);
    machines.run(0.3);
    assert_eq!(machines.base.holds.newest().unwrap().reason(), Some(PauseReason::StoppedAtRobot));
    machines.robot.stop.0.set(false);
    // The base's own stop is none of the robot's.
    machines.run(1.0);
    machines.base.stop.0.set(true);
    machines.run(1.0);
    assert_eq!(machines.base.holds.newest().unwrap().reason(), None);
}

#[test]
fn a_second_base_may_stop_the_robot_and_nothing_else_while_the_first_leads() {
    let mut machines = Machines::new();
    machines.run(1.0);
    let mut second = BaseSide::new(Cable { out: machines.down.clone(), back: CableDirection::default() }, 9);
    for is_stopped in [true, false] {
        second.stop.0.set(is_stopped);
        for _ in 0..50 {
            second.network.clock().set(Monotonic(machines.now));
            second.commands.send(&VelocityCommand { linear_m_s: 0.2, ..VelocityCommand::default() });
            second.link.step();
            machines.run(0.04);
        }
        assert_eq!(machines.robot.stop.0.get(), is_stopped);
        let reason = machines.base.holds.newest().unwrap().reason();
        assert_eq!(reason, is_stopped.then_some(PauseReason::StoppedAtRobot));
    }
    assert!(machines.robot.velocities.newest().is_none());
    assert!(machines.robot.link.refused() > 0);
}
