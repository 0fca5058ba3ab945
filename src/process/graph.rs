//! The fleet's joint graph at work: submaps in, what is believed of the robots' maps out. On a thread of its own
//! beside the merged map, which never waits for it, and of less priority than all that robots wait for.

use crate::channel;
use crate::clock::now;
use crate::merge_memory::MergeMemory;
use crate::ports::ChannelError;
use crate::run::Run;
use crate::shared_memory::{Participant, Reader, Writer, wait};
use ::merge::FleetPoseGraph;
use msg::{
    EdgeAction, EdgeCommand, Grid, MergeEdges, Monotonic, Pose2, RobotId, Role, Submap, SubmapPoses,
    SubmapRequest,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// How often the thread looks around without being rung for.
const LOOK_NS: u64 = 500_000_000;
/// Who lacks submaps asks for them after this, and again.
const ASK_NS: u64 = 3_000_000_000;
/// How much less of the processors this thread gets when others want them, as `nice` counts.
const NICE: i32 = 10;

/// What the graph says of each robot: where its map lies, `map` from `robotK/map`; and the map redrawn, where no place
/// alone puts it right.
pub type Places = Vec<(Option<Pose2>, Option<Arc<Grid>>)>;

/// Where the newest places are left for who draws the map. [`channel::merge_edges`] rings when there are new ones.
#[derive(Default)]
pub struct PlacesSlot(Mutex<Option<Places>>);

impl PlacesSlot {
    fn put(&self, places: Places) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(places);
    }

    /// Those that came since the last time.
    pub fn take(&self) -> Option<Places> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// One robot's submaps.
struct Source {
    robot: RobotId,
    submaps: Reader<Submap>,
    poses: Reader<SubmapPoses>,
    asks: Writer<SubmapRequest>,
    /// Lost so far, when all were last asked for.
    lost: u64,
    /// Since when something has been missing.
    lacks_since: Option<Monotonic>,
}

/// Works until `done`.
pub fn run(
    run: &Run,
    mut fleet: FleetPoseGraph,
    mut memory: MergeMemory,
    slot: &PlacesSlot,
    done: &AtomicBool,
) -> Result<(), ChannelError> {
    // On Linux that is the calling thread's alone. Whether it is granted makes no difference to what comes out.
    let _ = rustix::process::nice(NICE);
    // A presence of its own: shared memory's ports stay on the thread that made them.
    let node = run.attach_thread(Role::Merge, None, "graph")?;
    let mut sources = run.robots().map(|robot| Source::open(&node, robot)).collect::<Result<Vec<_>, _>>()?;
    let mut commands = node.reader(&channel::edge_command())?;
    let mut out = Out {
        writer: node.writer(&channel::merge_edges())?,
        edges: Box::default(),
        answered: false,
        places: None,
    };
    let mut bells = vec![node.listener(&channel::edge_command())?];
    for robot in run.robots() {
        bells.push(node.listener(&channel::submap_poses(robot))?);
        bells.push(node.listener(&channel::submap(robot))?);
    }
    let mut worked = false;
    while !done.load(Ordering::Relaxed) {
        wait(&bells, if worked { now() } else { Monotonic(now().0 + LOOK_NS) });
        while let Some(command) = commands.receive() {
            out.obey(&mut fleet, &command);
        }
        sources.iter_mut().for_each(|source| source.read(&mut fleet));
        let task = fleet.next_task();
        worked = task.is_some();
        if let Some(task) = task {
            fleet.apply_outcome(task.run());
        }
        // Before it is told: who has heard that an edge is pinned may rely on it.
        memory.keep(&fleet, now());
        out.tell(run, &fleet, slot);
    }
    Ok(())
}

impl Source {
    fn open(node: &Participant, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            robot,
            submaps: node.reader(&channel::submap(robot))?,
            poses: node.reader(&channel::submap_poses(robot))?,
            asks: node.writer(&channel::submap_request(robot))?,
            lost: 0,
            lacks_since: None,
        })
    }

    fn read(&mut self, fleet: &mut FleetPoseGraph) {
        // What makes no sense is not taken: the robot stays where it was.
        if let Some(poses) = self.poses.newest() {
            let _ = fleet.update_poses(self.robot, &poses);
        }
        while let Some(submap) = self.submaps.receive() {
            let _ = fleet.add_submap(self.robot, &submap);
        }
        let lost = self.submaps.gaps().lost;
        if fleet.missing_submaps(self.robot) == 0 && lost == self.lost {
            self.lacks_since = None;
            return;
        }
        let since = *self.lacks_since.get_or_insert(now());
        if now().since(since) >= ASK_NS {
            self.asks.send(&SubmapRequest::default());
            (self.lost, self.lacks_since) = (lost, None);
        }
    }
}

/// What the graph says.
struct Out {
    writer: Writer<MergeEdges>,
    /// As told last, but for the count of commands.
    edges: Box<MergeEdges>,
    /// A command was answered since.
    answered: bool,
    places: Option<Places>,
}

impl Out {
    fn obey(&mut self, fleet: &mut FleetPoseGraph, command: &EdgeCommand) {
        let action = EdgeAction::from_code(command.action);
        let done = action.is_some_and(|action| fleet.apply_command(command.edge, action));
        self.edges.commands += 1;
        self.edges.refused += u32::from(!done);
        self.answered = true;
    }

    /// Tells what is new.
    fn tell(&mut self, run: &Run, fleet: &FleetPoseGraph, slot: &PlacesSlot) {
        let places: Places = run
            .robots()
            .map(|robot| (fleet.map_from_robot_map(robot), fleet.redrawn_map(robot).cloned()))
            .collect();
        let moved = self.places.as_ref().is_none_or(|before| !same(before, &places));
        let mut edges = self.edges.clone();
        fleet.write_edges(&mut edges);
        if moved {
            slot.put(places.clone());
            self.places = Some(places);
        }
        if moved || self.answered || edges.edges() != self.edges.edges() {
            edges.header.stamp = run.epoch.stamp(now());
            self.writer.send(&edges);
            (self.edges, self.answered) = (edges, false);
        }
        self.writer.refresh();
    }
}

fn same(before: &Places, now: &Places) -> bool {
    before.iter().zip(now).all(|((place, map), (place_now, map_now))| {
        place == place_now && map.as_ref().map(Arc::as_ptr) == map_now.as_ref().map(Arc::as_ptr)
    })
}
