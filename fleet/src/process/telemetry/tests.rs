//! Telemetry on queues in memory, with metrics of the maps that take as long as a test wants.

use super::*;
use crate::channel::Opener;
use crate::job_thread::JobRunner;
use crate::lockstep::faults::FaultPlan;
use crate::lockstep::queues::{MemoryPorts, Network, QueueReader, VirtualClock};
use crate::ports::WriteMapPort;
use msg::tiles::MAP_TILES_MAX;
use msg::{IndexRect, MapHeader, RobotFrame, RobotFrameTransform};
use proptest::prelude::*;
use std::cell::RefCell;
use std::rc::Rc;
use tokio::sync::oneshot;

const MS: u64 = 1_000_000;

/// A job that is not done yet, and where its figures go.
type Waiting = Rc<RefCell<Vec<(MapChanges, oneshot::Sender<MapFigures>)>>>;

/// Keeps jobs until they are done by [`Scene::finish_metrics`].
struct SlowWorker {
    waiting: Waiting,
    clock: VirtualClock,
    /// Time that the loop spends in handing over a job, nanoseconds: not zero as if it computed the metrics itself.
    takes_ns: u64,
}

impl JobWorker<MapChanges, MapFigures> for SlowWorker {
    fn submit(&mut self, job: MapChanges) -> oneshot::Receiver<MapFigures> {
        let (sender, receiver) = oneshot::channel();
        self.waiting.borrow_mut().push((job, sender));
        self.clock.set(self.clock.now() + Duration::from_nanos(self.takes_ns));
        receiver
    }
}

/// Telemetry of one robot, and the channels around it.
struct Scene {
    network: Rc<Network>,
    process: Box<TelemetryProcess<MemoryPorts, SlowWorker>>,
    worker: MapWorker,
    waiting: Waiting,
    transforms: <MemoryPorts as Ports>::Writer<Transforms>,
    maps: <MemoryPorts as Ports>::MapWriter,
    map: TileMap,
    stats: QueueReader<FleetStats>,
}

impl Scene {
    fn new(takes_ns: u64) -> Self {
        let mut config = crate::config::FleetConfig { world: RobotSource::Robots, ..Default::default() };
        config.fleet.robots = 1;
        let run = Run::in_memory(config).unwrap();
        let robot = RobotId::new(1).unwrap();
        let network = Network::new(FaultPlan::none());
        let of = |role: Role, robot| MemoryPorts::attach(&network, Opener { program: role.into(), robot });
        let waiting = Waiting::default();
        let worker = SlowWorker { waiting: waiting.clone(), clock: network.clock().clone(), takes_ns };
        let process = TelemetryProcess::open(&of(Role::Telemetry, None), &run, worker, MAPS_LEAD).unwrap();
        let (sim, slam) = (of(Role::Sim, Some(robot)), of(Role::Slam, Some(robot)));
        let mut map = TileMap::new(MapHeader { resolution_m: 0.05, ..MapHeader::default() });
        assert!(map.grow_to(IndexRect::single(0, 0), MAP_TILES_MAX));
        Self {
            process: Box::new(process),
            worker: MapWorker::new(&run, None).unwrap(),
            waiting,
            transforms: sim.writer(&channel::transforms(robot)).unwrap(),
            maps: slam.map_writer(&channel::map(robot)).unwrap(),
            map,
            stats: of(Role::Bridge, None).reader(&channel::stats()).unwrap(),
            network,
        }
    }

    /// Sends one more known cell and the transforms of a moment, which arrive `late_ns` after it. Returns new figures.
    fn pass(&mut self, stamp_ns: u64, late_ns: u64) -> Option<Box<FleetStats>> {
        let clock = self.network.clock();
        clock.set(Monotonic((stamp_ns + late_ns).max(clock.now().0)));
        self.transforms.send_with(|message| {
            message.header.stamp = msg::Stamp(stamp_ns as i64);
            message.len = 1;
            message.transforms[0] =
                RobotFrameTransform { child_frame: RobotFrame::BaseFootprint as u32, ..Default::default() };
        });
        let cell = (stamp_ns / (50 * MS)) as usize;
        self.map.get_mut(0, 0).unwrap().cells[cell] = msg::grid::LOG_ODDS_MAX;
        assert!(self.maps.send(&self.map), "a small map is sent at once");
        self.process.step();
        self.stats.newest().map(|stats| Box::new(*stats))
    }

    /// Does the jobs that wait, and returns how many they were.
    fn finish_metrics(&mut self) -> usize {
        let jobs = self.waiting.take();
        let count = jobs.len();
        for (job, sender) in jobs {
            let _ = sender.send(self.worker.run(&job));
        }
        count
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Arrival times are counted alike whether the metrics take no time, some seconds, or never end. They are not if the loop computes
    /// them. At most one job waits, and the one after it has the newest map.
    #[test]
    fn jitter_does_not_depend_on_how_long_the_metrics_of_the_maps_take(
        late_ms in prop::collection::vec(0_u64..20, 100..300),
        takes_s in prop::collection::vec(0_usize..4, 16),
        never_ends: bool,
    ) {
        let [mut quick, mut slow, mut in_loop] = [0, 0, 300 * MS].map(|takes_ns| Box::new(Scene::new(takes_ns)));
        let (mut takes_s, mut left_s) = (takes_s.into_iter(), 0);
        let mut cells = Vec::new();
        for (n, late_ms) in late_ms.iter().enumerate() {
            let stamp_ns = 1000 * MS + n as u64 * 50 * MS;
            let [of_quick, of_slow] = [&mut quick, &mut slow].map(|scene| scene.pass(stamp_ns, late_ms * MS));
            let of_loop = in_loop.pass(stamp_ns, late_ms * MS);
            quick.finish_metrics();
            in_loop.finish_metrics();
            if let Some(stats) = of_loop.filter(|stats| stats.robots[0].tf_jitter_ms.count > 20) {
                prop_assert!(stats.robots[0].tf_jitter_ms.max > 100.0, "{:?}", stats.robots[0].tf_jitter_ms);
            }
            prop_assert_eq!(of_quick.is_some(), of_slow.is_some());
            let (Some(of_quick), Some(of_slow)) = (of_quick, of_slow) else { continue };
            prop_assert_eq!(of_quick.robots[0].tf_jitter_ms, of_slow.robots[0].tf_jitter_ms);
            prop_assert_eq!(of_quick.robots[0].tf_jitter_ms.count, (n as u64 + 1).saturating_sub(40));
            // The maps are taken shortly before the figures.
            prop_assert!(n == 0 || of_quick.maps_age_s <= 0.3, "{}", of_quick.maps_age_s);
            prop_assert_eq!(slow.waiting.borrow().len(), 1);
            cells.push(of_slow.robots[0].occupied_cells);
            if !never_ends && left_s == 0 {
                prop_assert_eq!(slow.waiting.borrow()[0].0.robots.len(), 1);
                slow.finish_metrics();
                left_s = takes_s.next().unwrap_or(0);
            } else {
                left_s = left_s.saturating_sub(1);
            }
        }
        prop_assert!(cells.is_sorted());
        prop_assert!(never_ends == (cells.last() == Some(&0)), "{cells:?}");
    }
}

#[test]
fn lost_scans_of_robots_on_other_machines_are_unknown() {
    let mut scene = Scene::new(0);
    let stats = scene.pass(1000 * MS, 0).unwrap();
    assert_eq!(stats.robots[0].scans_lost_unknown, 1);
}

#[test]
fn figures_of_maps_that_do_not_come_are_older_each_second() {
    let mut scene = Scene::new(0);
    let mut age_s = |second: u64| {
        let age_s = scene.pass(second * 1000 * MS, 0).unwrap().maps_age_s;
        if second < 3 {
            scene.finish_metrics();
        }
        age_s
    };
    assert!(age_s(1).is_nan());
    assert_eq!([2, 3, 4, 5].map(age_s), [1.0, 1.0, 2.0, 3.0]);
}
