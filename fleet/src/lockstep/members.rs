//! The processes of a fleet in lockstep: the components that run live, started, stopped and killed like processes.

use super::memory_storage::MemoryStorage;
use super::queues::{MemoryPorts, Network};
use super::replay::RecordedRobot;
use super::room_plan::cached_room_plan;
use super::tcp::{BridgeServer, Port};
use crate::channel::Opener;
use crate::job_thread::ImmediateJobs;
use crate::ports::{Clock, Ports as _};
use crate::process::bridge::BridgeProcess;
use crate::process::control::files::ImmediateFiles;
use crate::process::graph_worker::GraphWorker;
use crate::process::merge::{self, MergeProcess};
use crate::process::nav::NavigationProcess;
use crate::process::nav::state_file::NavigationFile;
use crate::process::objects::ObjectsProcess;
use crate::process::sim::SimulatorProcess;
use crate::process::slam::files::SlamFileJob;
use crate::process::slam::{BackEndInput, FrontEvent, SlamProcess};
use crate::process::telemetry::TelemetryProcess;
use crate::process::telemetry::map_worker::MapWorker;
use crate::process::{Error, ProcessLoop};
use crate::processes::ProcessRow;
use crate::restarts::{RestartPolicy, State};
use crate::run::Run;
use crate::supervisor::START_MAX;
use crate::watchdog::{Finding, ThreadSample, ThreadState, Watchdog};
use ::recording::fleet::FleetRecording;
use msg::{Monotonic, Pose2, RobotId, Role};
use std::rc::Rc;
use std::time::Duration;

/// Time from a death until the new process runs: the launcher's poll, the program's start and the opening of its channels.
const BACK_AFTER: Duration = Duration::from_millis(200);

/// Surroundings that all processes of a fleet in lockstep share.
pub struct World {
    /// The run's id, times and configuration.
    pub run: Run,
    /// Queues of all channels, in memory.
    pub network: Rc<Network>,
    /// The run's folder.
    pub storage: MemoryStorage,
    /// The bridge's TCP port.
    pub port: Rc<Port>,
    /// What the robots send, if they are not simulated.
    pub recording: Option<Rc<FleetRecording>>,
    /// Whether the room is known, with which maps are compared.
    pub has_room: bool,
    /// Whether recorded robots send their links' transforms, too.
    pub sends_transforms: bool,
}

/// One process of the fleet, running or ended.
pub struct Member {
    /// Its row in the table of processes.
    pub row: &'static ProcessRow,
    /// Robot of a simulator or SLAM process; `None` for all others.
    pub robot: Option<RobotId>,
    /// Decides when it is started again.
    pub policy: RestartPolicy,
    /// It is stopped until then.
    pub frozen_until: Monotonic,
    /// When it took its last step: what it is to save can be in its files since then.
    pub stepped_at: Monotonic,
    /// Moment before which a killed process is not back, though it is started at once.
    back_at: Monotonic,
    /// Its threads, while it runs.
    pub threads: Vec<Thread>,
    body: Option<Body>,
    watchdog: Watchdog,
    /// Passes of the first thread's loop, which the watchdog compares.
    passes: u64,
}

/// One thread of a process.
pub struct Thread {
    ports: MemoryPorts,
    /// Moment at which it runs next.
    pub due: Monotonic,
}

/// The components of a running process.
enum Body {
    Sim(Box<SimulatorProcess<MemoryPorts>>),
    Recorded(RecordedRobot<MemoryPorts>),
    Slam(Box<SlamBody>),
    Merge(Box<(MergeProcess<MemoryPorts>, GraphWorker<MemoryPorts, MemoryStorage>)>),
    Telemetry(Box<TelemetryProcess<MemoryPorts, ImmediateJobs<MapWorker>>>),
    Bridge(Box<BridgeServer<MemoryStorage>>),
    Objects(Box<ObjectsProcess<MemoryPorts, MemoryStorage>>),
    Nav(Box<NavigationProcess<MemoryPorts, ImmediateJobs<NavigationFile<MemoryStorage>>>>),
}

/// A SLAM process, and what it took from its queues to process next.
pub struct SlamBody {
    /// Scan path, back-end thread and file thread, called in turn.
    pub process: SlamProcess<MemoryPorts, MemoryStorage>,
    input: Option<BackEndInput>,
    job: Option<SlamFileJob>,
    /// An outcome that the back end has no room for.
    outcome: Option<BackEndInput>,
}

impl Member {
    /// Creates a process that is to be started now.
    pub fn new(row: &'static ProcessRow, robot: Option<RobotId>) -> Self {
        Self {
            row,
            robot,
            policy: RestartPolicy::new(Monotonic(0)),
            frozen_until: Monotonic(0),
            stepped_at: Monotonic(0),
            back_at: Monotonic(0),
            threads: Vec::new(),
            body: None,
            watchdog: Watchdog::new(START_MAX, row.silence_max, Monotonic(0)),
            passes: 0,
        }
    }

    /// Starts the process; `at` is the pose that the supervisor gives a restarted one.
    pub fn start(&mut self, world: &World, at: Option<Pose2>) -> Result<(), Error> {
        let opener = Opener { program: self.row.role.into(), robot: self.robot };
        let now = world.network.clock().now();
        let count = match self.row.role {
            Role::Slam => 3,
            Role::Merge => 2,
            _ => 1,
        };
        let ports: Vec<MemoryPorts> =
            (0..count).map(|_| MemoryPorts::attach(&world.network, opener)).collect();
        self.body = Some(Body::open(world, self.row.role, self.robot, at, &ports)?);
        self.threads = ports.into_iter().map(|ports| Thread { ports, due: now }).collect();
        self.frozen_until = Monotonic(0);
        self.watchdog = Watchdog::new(START_MAX, self.row.silence_max, now);
        self.passes = 0;
        self.policy.on_started(now);
        Ok(())
    }

    /// Ends the process as SIGKILL would: all that it has not written is lost.
    pub fn kill(&mut self, now: Monotonic) {
        if self.body.take().is_some() {
            self.threads.clear();
            self.policy.on_death(now);
            self.back_at = Monotonic(now.0 + BACK_AFTER.as_nanos() as u64);
        }
    }

    /// Returns when the process is to run again; `None` if it runs or is not started again.
    pub fn start_due(&self) -> Option<Monotonic> {
        match self.policy.state() {
            State::Waiting { until } => Some(until.max(self.back_at)),
            State::Running { .. } => None,
        }
    }

    /// Returns whether the process runs.
    pub fn is_running(&self) -> bool {
        self.body.is_some()
    }

    /// Returns whether the process hangs, by the live supervisor's watchdog.
    pub fn is_hung(&mut self, now: Monotonic) -> bool {
        let state = if now < self.frozen_until { ThreadState::Stopped } else { ThreadState::Sleeping };
        let sample = || ThreadSample { state, cpu: Duration::ZERO };
        self.is_running()
            && matches!(self.watchdog.poll(now, self.passes, sample), Some(Finding::Hung { .. }))
    }

    /// Returns the SLAM process, if this is one and runs.
    pub fn slam(&self) -> Option<&SlamBody> {
        match &self.body {
            Some(Body::Slam(slam)) => Some(slam),
            _ => None,
        }
    }

    /// Returns the bridge, if this is its process and runs.
    pub fn bridge(&self) -> Option<&BridgeProcess<MemoryPorts, ImmediateFiles<MemoryStorage>>> {
        match &self.body {
            Some(Body::Bridge(server)) => Some(&server.process),
            _ => None,
        }
    }

    /// Returns whether a thread has something to do now.
    pub fn is_runnable(&mut self, thread: usize, world: &World) -> bool {
        let now = world.network.clock().now();
        if now < self.frozen_until {
            return false;
        }
        let Thread { ports, due } = &self.threads[thread];
        let woken = *due <= now || ports.is_notified();
        match &mut self.body {
            Some(Body::Slam(slam)) => woken || slam.take_next(thread, world),
            Some(Body::Bridge(server)) => woken || server.has_input(),
            _ => woken,
        }
    }

    /// Runs one step of a thread.
    pub fn step(&mut self, thread: usize) {
        let Some(body) = &mut self.body else { return };
        self.passes += u64::from(thread == 0);
        self.stepped_at = self.threads[thread].ports.clock().now();
        self.threads[thread].ports.take_notifications();
        self.threads[thread].due = match (body, thread) {
            (Body::Sim(simulation), _) => simulation.step(),
            (Body::Recorded(robot), _) => robot.step(),
            (Body::Slam(slam), _) => slam.step(thread),
            (Body::Merge(merge), 0) => merge.0.step(),
            (Body::Merge(merge), _) => merge.1.step(),
            (Body::Telemetry(figures), _) => figures.step(),
            (Body::Bridge(server), _) => server.step(),
            (Body::Nav(navigation), _) => navigation.step(),
            (Body::Objects(objects), _) => objects.step(),
        };
    }
}

impl Body {
    fn open(
        world: &World,
        role: Role,
        robot: Option<RobotId>,
        at: Option<Pose2>,
        ports: &[MemoryPorts],
    ) -> Result<Self, Error> {
        let run = &world.run;
        let robot = || robot.ok_or("a robot's process without a robot");
        Ok(match role {
            Role::Sim => match &world.recording {
                Some(recording) => {
                    let (recording, robot) = (recording.clone(), robot()?);
                    Self::Recorded(RecordedRobot::open(
                        &ports[0],
                        run,
                        robot,
                        recording,
                        world.sends_transforms,
                    )?)
                }
                None => Self::Sim(Box::new(SimulatorProcess::open(&ports[0], run, robot()?, at)?)),
            },
            Role::Slam => {
                let storage = world.storage.clone();
                let process = SlamProcess::open([&ports[0], &ports[1]], run, robot()?, at, storage)?;
                Self::Slam(Box::new(SlamBody { process, input: None, job: None, outcome: None }))
            }
            Role::Merge => {
                let (state, restored) = merge::begin(run, world.storage.clone())?;
                let process = MergeProcess::open(&ports[0], run, &state, &restored)?;
                Self::Merge(Box::new((process, GraphWorker::open(&ports[1], run, state)?)))
            }
            Role::Telemetry => {
                let plan = if world.has_room { cached_room_plan(&run.config)? } else { None };
                let worker = ImmediateJobs(MapWorker::new(run, plan)?);
                Self::Telemetry(Box::new(TelemetryProcess::open(&ports[0], run, worker, Duration::ZERO)?))
            }
            Role::Nav => {
                let storage = world.storage.clone();
                let process =
                    NavigationProcess::open(&ports[0], run, storage, |file| Ok(ImmediateJobs(file)))?;
                Self::Nav(Box::new(process))
            }
            Role::Objects => {
                Self::Objects(Box::new(ObjectsProcess::open(&ports[0], run, world.storage.clone())?))
            }
            Role::Record => return Err("lockstep records with `--record FILE`".into()),
            Role::Bridge => {
                let process = BridgeProcess::open(&ports[0], run, world.storage.clone(), |files| {
                    Ok(ImmediateJobs(files))
                })?;
                let frame_bytes_max = run.config.bridge.frame_bytes_max;
                Self::Bridge(Box::new(BridgeServer::new(process, world.port.clone(), frame_bytes_max)))
            }
        })
    }
}

impl SlamBody {
    /// Takes the next element from the queue to a thread; returns true if there is something to do.
    fn take_next(&mut self, thread: usize, world: &World) -> bool {
        match thread {
            1 => {
                if self.input.is_none() {
                    self.input = self.process.inputs.try_recv().ok().filter(|input| !is_lost(input, world));
                }
                self.input.is_some()
            }
            2 => {
                if self.job.is_none() && self.outcome.is_none() {
                    self.job = self.process.jobs.try_recv().ok();
                }
                self.job.is_some() || self.outcome.is_some()
            }
            _ => false,
        }
    }

    fn step(&mut self, thread: usize) -> Monotonic {
        match thread {
            0 => self.process.front_end_loop.step(),
            1 => self.process.back_end.step(self.input.take()),
            _ => {
                let files = &mut self.process.files;
                self.outcome = match (self.outcome.take(), self.job.take()) {
                    (Some(outcome), _) => files.try_send(outcome),
                    (None, Some(job)) => files.try_run(job),
                    (None, None) => None,
                };
                // The file thread waits for jobs only.
                Monotonic(u64::MAX)
            }
        }
    }
}

/// Returns whether a fault makes the queue too full for an event.
///
/// Nodes always have room: see `slam::NODES_IN_FLIGHT_MAX`.
fn is_lost(input: &BackEndInput, world: &World) -> bool {
    let is_node = matches!(input, BackEndInput::FrontEnd(_, FrontEvent::Node(..)) | BackEndInput::File(_));
    !is_node && world.network.faults().loses_events(world.network.clock().now())
}
