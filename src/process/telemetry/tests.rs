//! Telemetry on queues in memory, with metrics of the maps that take as long as a test wants.

use super::*;
use crate::channel::Opener;
use crate::job_thread::JobRunner;
use crate::lockstep::faults::FaultPlan;
use crate::lockstep::queues::{MemoryPorts, Network, QueueReader};
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
struct SlowWorker(Waiting);

impl JobWorker<MapChanges, MapFigures> for SlowWorker {
    fn submit(&mut self, job: MapChanges) -> oneshot::Receiver<MapFigures> {
        let (sender, receiver) = oneshot::channel();
        self.0.borrow_mut().push((job, sender));
        receiver
    }
}

/// Telemetry of one robot, and the channels around it.
struct Scene {
    network: Rc<Network>,
    process: TelemetryProcess<MemoryPorts, SlowWorker>,
    worker: MapWorker,
    waiting: Waiting,
    transforms: <MemoryPorts as Ports>::Writer<Transforms>,
    maps: <MemoryPorts as Ports>::MapWriter,
    map: TileMap,
    stats: QueueReader<FleetStats>,
}

impl Scene {
    fn new() -> Self {
        let mut config = crate::config::FleetConfig { world: RobotSource::Robots, ..Default::default() };
        config.fleet.robots = 1;
        let run = Run::in_memory(config).unwrap();
        let robot = RobotId::new(1).unwrap();
        let network = Network::new(FaultPlan::none());
        let of = |role: Role, robot| MemoryPorts::attach(&network, Opener { program: role.into(), robot });
        let waiting = Waiting::default();
        let process =
            TelemetryProcess::open(&of(Role::Telemetry, None), &run, SlowWorker(waiting.clone())).unwrap();
        let (sim, slam) = (of(Role::Sim, Some(robot)), of(Role::Slam, Some(robot)));
        let mut map = TileMap::new(MapHeader { resolution_m: 0.05, ..MapHeader::default() });
        assert!(map.grow_to(IndexRect::single(0, 0), MAP_TILES_MAX));
        Self {
            process,
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
    fn pass(&mut self, stamp_ns: u64, late_ns: u64) -> Option<FleetStats> {
        self.network.clock().set(Monotonic(stamp_ns + late_ns));
        self.transforms.send_with(|message| {
            message.header.stamp = msg::Stamp(stamp_ns as i64);
            message.len = 1;
            message.transforms[0] =
                RobotFrameTransform { child_frame: RobotFrame::BaseFootprint as u32, ..Default::default() };
        });
        let cell = (stamp_ns / (50 * MS)) as usize;
        self.map.get_mut(0, 0).unwrap().cells[cell] = msg::grid::LOG_ODDS_MAX;
        while !self.maps.send(&self.map) {}
        self.process.step();
        self.stats.newest().map(|stats| *stats)
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

    /// Arrival times are counted alike whether the metrics take no time, some seconds, or never end. At most one job waits,
    /// and the one after it has the newest map.
    #[test]
    fn jitter_does_not_depend_on_how_long_the_metrics_of_the_maps_take(
        late_ms in prop::collection::vec(0_u64..20, 100..300),
        takes_s in prop::collection::vec(0_usize..4, 16),
        never_ends: bool,
    ) {
        let (mut quick, mut slow) = (Scene::new(), Scene::new());
        let (mut takes_s, mut left_s) = (takes_s.into_iter(), 0);
        let mut cells = Vec::new();
        for (n, late_ms) in late_ms.iter().enumerate() {
            let stamp_ns = 1000 * MS + n as u64 * 50 * MS;
            let [of_quick, of_slow] = [&mut quick, &mut slow].map(|scene| scene.pass(stamp_ns, late_ms * MS));
            quick.finish_metrics();
            prop_assert_eq!(of_quick.is_some(), of_slow.is_some());
            let (Some(of_quick), Some(of_slow)) = (of_quick, of_slow) else { continue };
            prop_assert_eq!(of_quick.robots[0].tf_jitter_ms, of_slow.robots[0].tf_jitter_ms);
            prop_assert_eq!(of_quick.robots[0].tf_jitter_ms.count, (n as u64 + 1).saturating_sub(40));
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
fn metrics_whose_thread_has_ended_are_unknown() {
    let mut scene = Scene::new();
    let stats = |scene: &mut Scene, second: u64| scene.pass(second * 1000 * MS, 0).unwrap();
    assert_eq!(stats(&mut scene, 1).robots[0].scans_lost_unknown, 1, "its robots are on other machines");
    scene.finish_metrics();
    assert_eq!(stats(&mut scene, 2).robots[0].occupied_cells, 1);
    scene.waiting.take();
    assert_eq!(stats(&mut scene, 3).robots[0].occupied_cells, 0);
    stats(&mut scene, 4);
    assert_eq!(scene.waiting.borrow().len(), 0, "no further job");
}
