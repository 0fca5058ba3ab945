//! The process that records the fleet's messages, and the same loop for `mr-slam record` and for lockstep.
//!
//! It reads channels. Threads that leave the processor to all others ([`crate::spare_time`]) encode the messages by the bridge's
//! tables (`topics`) and write files of a bounded size ([`crate::recording_files`]). It never holds anything up: when too much
//! waits, messages are dropped and counted.

mod bag;
pub mod description;
mod inputs;
mod operator;
mod recording_work;
mod topics;

use super::heartbeat::{HealthCounters, Heartbeat};
use super::scan_demand::ScanDemandSender;
use super::{Error, Listens, ProcessLoop, serve};
use crate::config::RecordingConfig;
use crate::ports::{Clock as _, Ports};
use crate::progress::WatchedThread;
use crate::realtime::lower_priority;
use crate::recording_files::RecordingFiles;
use crate::run::Run;
use crate::shared_memory::{Listener, wait};
use crate::spare_time::{JobExecutor, SpareTime, WaitingLimits};
use crate::stop::Stop;
use ::recording::TopicCount;
use ::recording::rosbag2::Bag;
pub use bag::{describe_parts, write_description};
use inputs::Inputs;
use msg::{Monotonic, RobotId, Role, ScanPurpose, Stamp};
use operator::{OperatorChange, OperatorWatch};
use recording_work::RecordingWork;
use serde::Serialize;
use sha2::{Digest, Sha256};
use sim::Simulator;
use std::io;
use std::path::PathBuf;
use std::time::Duration;
pub use topics::{PLANAR_ODOMETRY, Recorder};

/// Period at which each channel is read. The shortest queue, the clock's, holds 0.32 s.
const POLL_PERIOD: Duration = Duration::from_millis(50);
/// Parts in which they are read, one after another over the period: a core is taken for so short a time that it hardly delays the
/// process that wakes there meanwhile.
const PARTS: u32 = 10;
/// Longest time until a message is in a chunk on its way to the disk.
const FLUSH_PERIOD: Duration = Duration::from_millis(900);
/// Niceness of a recorder's threads (nice(2)): robots and clients do not wait for it, and it has 0.32 s until a queue is full.
const NICE: i32 = 10;
/// Bytes of messages that may wait. Above the first a thread of normal priority encodes, too: it is 1 s of 20 robots. Above the second
/// messages are dropped: it is 10 s of 64 robots, for which a disk may be slow.
const WAITING: WaitingLimits = WaitingLimits { help: 4 << 20, refuse: 128 << 20 };
/// What a recording's file of numbers says until it has them.
const NOT_ENDED: &str = "the recorder still records, or was killed: the messages were not counted";
/// Folder of recordings below the run's folder.
pub const FOLDER: &str = "recording";
/// Name of the files of a run's recording, without extension.
const STEM: &str = "recording";

/// Returns the SHA-256 of maps: names, sizes, origins and cells, as hexadecimal digits.
pub fn map_hash<'a>(maps: impl Iterator<Item = (&'a str, msg::GridView<'a>)>) -> String {
    let mut hash = Sha256::new();
    for (name, map) in maps {
        hash.update(name);
        hash.update(map.header.width.to_le_bytes());
        hash.update(map.header.height.to_le_bytes());
        let origin = map.header.origin;
        for part in [origin.x_m, origin.y_m, origin.yaw_rad, map.header.resolution_m] {
            hash.update(part.to_le_bytes());
        }
        hash.update(bytemuck::cast_slice::<i8, u8>(map.cells));
    }
    format!("{:x}", hash.finalize())
}

/// What a recording has, and what it lacks.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Summary {
    /// Files, in the order of their messages.
    pub files: Vec<PathBuf>,
    /// Files of a recorder that was killed before; their messages are not counted here.
    pub earlier: Vec<PathBuf>,
    /// Number of messages of each topic, over all files.
    pub topics: Vec<TopicCount>,
    /// Messages that were dropped because too much waited, or because the recording had ended; `None`: not known.
    pub dropped: Option<u64>,
    /// Messages that were sent and not received in time; `None`: not known.
    pub lost: Option<u64>,
    /// Reason why the recording ended before the fleet, or why nothing was counted.
    pub ended: Option<String>,
    /// The same files and topics, as rosbag2 counts them.
    #[serde(skip)]
    pub bag: Bag,
}

impl Summary {
    /// Returns the summary of a recording that begins: a recorder that is killed leaves it so.
    pub fn begun(files: Vec<PathBuf>) -> Self {
        Self { files, ended: Some(NOT_ENDED.into()), ..Self::default() }
    }
}

/// Runs the process of a recorded fleet until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    lower_priority(NICE);
    let participant = run.attach(Role::Record, None)?;
    let folder = run.dir.join(FOLDER);
    formats::folder::create(&folder)?;
    let files = RecordingFiles::new(
        &folder.join(STEM).with_extension("mcap"),
        run.config.recording.disk_free_bytes(),
    );
    let numbers = folder.join(STEM).with_extension("json");
    write_summary(&numbers, &Summary::begun(Vec::new()))?;
    let watch = OperatorWatch::start(run.clone(), stop.clone());
    let recording = Recording::open(&participant, run, files, encode_later, Some(watch))?;
    let heartbeat = Heartbeat::new(&participant, run, Role::Record, None)?;
    let mut process = RecorderProcess { recording, heartbeat };
    serve(&mut process, run.progress(Role::Record, None, WatchedThread::Main), &|| stop.requested());
    let mut summary = process.recording.finish();
    // The folder may have held another run before.
    summary.earlier.retain(|path| !description::is_of_another_run(path, run));
    write_summary(&numbers, &summary)?;
    let described = write_description(&summary.bag, &folder, &summary.earlier);
    // The launcher says that the recording is not whole.
    summary.ended.map_or(Ok(described?), |why| Err(why.into()))
}

/// Records a running fleet until `over` returns true or the disk is full.
///
/// # Errors
/// A channel cannot be opened.
pub fn record<P: Ports<Listener = Listener>>(
    participant: &P,
    run: &Run,
    files: RecordingFiles,
    stop: &Stop,
    over: &dyn Fn() -> bool,
) -> Result<Summary, Error> {
    lower_priority(NICE);
    let watch = OperatorWatch::start(run.clone(), stop.clone());
    let mut recording = Recording::open(participant, run, files, encode_later, Some(watch))?;
    while !over() && !recording.has_ended() {
        let due = recording.step();
        wait([], due);
    }
    Ok(recording.finish())
}

fn encode_later(recorder: Recorder) -> io::Result<JobExecutor<Recorder>> {
    Ok(JobExecutor::Later(SpareTime::start(recorder, WAITING)?))
}

/// The process: a recording and its health report.
struct RecorderProcess<P: Ports> {
    recording: Recording<P>,
    heartbeat: Heartbeat<P>,
}

impl<P: Ports> ProcessLoop for RecorderProcess<P> {
    fn step(&mut self) -> Monotonic {
        let Self { recording, heartbeat } = self;
        let due = heartbeat.measure(|| recording.step());
        heartbeat.publish_if_due(|| {
            let counts = &recording.to.counts;
            let mut counters = HealthCounters { dropped: counts.dropped(), ..Default::default() };
            (counters.receive_counts.received, counters.receive_counts.lost) =
                (counts.messages(), recording.inputs.lost());
            counters
        });
        due.min(heartbeat.due())
    }
}

impl<P: Ports> Listens<P::Listener> for RecorderProcess<P> {
    /// It listens to nothing: waking it for each message would cost the fleet more than its polling.
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        std::iter::empty()
    }
}

/// Reads the fleet's channels and records their messages.
pub struct Recording<P: Ports> {
    to: RecordingWork,
    inputs: Inputs<P>,
    operator: Option<OperatorWatch>,
    robots: usize,
    scan_demand: ScanDemandSender<P>,
    clock: P::Clock,
    next: NextPart,
    flush_due: Monotonic,
}

/// The part of the channels that is read next, and when.
struct NextPart {
    part: u32,
    due: Monotonic,
}

impl NextPart {
    /// The first part: in the middle between the ticks of two simulators, which are spread over the tick of the fleet.
    fn first(run: &Run, now: Monotonic) -> Self {
        let between = Simulator::TICK / (2 * run.config.fleet.robots.max(1) as u32);
        let tick_ns = Simulator::TICK.as_nanos() as i64;
        let next_tick = Stamp((run.epoch.stamp(now).0.div_euclid(tick_ns) + 1) * tick_ns);
        Self { part: 0, due: run.epoch.moment(next_tick) + between }
    }

    /// Goes on to the next part. Who is late catches up, but not with more than a period.
    fn advance(&mut self, now: Monotonic) {
        self.part = (self.part + 1) % PARTS;
        let due = self.due + POLL_PERIOD / PARTS;
        self.due = if now > due + POLL_PERIOD { now } else { due };
    }
}

impl<P: Ports> Recording<P> {
    /// Opens all channels. `work` says where messages are encoded; `operator` watches the bridge's state, where there is one.
    ///
    /// # Errors
    /// A channel cannot be opened, or a thread cannot be started.
    pub fn open(
        ports: &P,
        run: &Run,
        files: RecordingFiles,
        work: impl FnOnce(Recorder) -> io::Result<JobExecutor<Recorder>>,
        operator: Option<OperatorWatch>,
    ) -> Result<Self, Error> {
        let clock = ports.clock();
        let flush_due = clock.now() + FLUSH_PERIOD;
        let recorder = Recorder::new(run, description::of_run(run), files)?;
        let to = RecordingWork { counts: recorder.counts(), work: work(recorder)? };
        let inputs = Inputs::open(ports, run)?;
        let scan_demand = ScanDemandSender::open(ports, run, ScanPurpose::Viewing)?;
        let robots = run.config.fleet.robots;
        let next = NextPart::first(run, clock.now());
        Ok(Self { to, inputs, operator, robots, scan_demand, clock, next, flush_due })
    }

    /// Records what has come on the channels that are due, and returns when it is to be called again.
    pub fn step(&mut self) -> Monotonic {
        let now = self.clock.now();
        for _ in 0..PARTS {
            if now < self.next.due {
                break;
            }
            self.receive(self.next.part, now);
            self.next.advance(now);
        }
        self.next.due
    }

    fn receive(&mut self, part: u32, now: Monotonic) {
        self.inputs.receive((part as usize, PARTS as usize), &mut self.to, now);
        if part == 0 {
            self.record_rest(now);
        }
    }

    /// Does once in a period what is not a channel's.
    fn record_rest(&mut self, now: Monotonic) {
        self.scan_demand.update(RobotId::first(self.robots), now);
        while let Some(change) = self.operator.as_mut().and_then(OperatorWatch::changed) {
            let record = move |to: &mut Recorder| match change {
                OperatorChange::State(state) => to.record_operator(&state, now),
                OperatorChange::Workload(entries) => to.record_workload(&entries, now),
            };
            self.to.record(size_of_val(&record), Box::new(record));
        }
        if now >= self.flush_due {
            self.to.record(0, Box::new(Recorder::flush));
            self.flush_due = now + FLUSH_PERIOD;
        }
    }

    /// Returns whether the recording has ended, because the disk is full or the thread that writes panicked.
    pub fn has_ended(&self) -> bool {
        self.to.counts.has_ended() || self.to.work.has_panicked()
    }

    /// Records what has come, ends the recording and returns what it has.
    pub fn finish(mut self) -> Summary {
        let now = self.clock.now();
        self.inputs.end_map_periods();
        (0..PARTS).for_each(|part| self.receive(part, now));
        let lost = Some(self.inputs.lost());
        let panicked =
            || Summary { ended: Some("the thread that writes panicked".into()), ..Summary::default() };
        Summary { lost, ..self.to.work.finish().map_or_else(panicked, Recorder::finish) }
    }
}

/// Writes a recording's summary as JSON.
///
/// # Errors
/// The file cannot be written.
pub fn write_summary(path: &std::path::Path, summary: &Summary) -> io::Result<()> {
    let json = serde_json::to_vec_pretty(summary)?;
    let written = formats::atomic::write(path, |file| io::Write::write_all(file, &json));
    written.map_err(|why| io::Error::new(why.kind(), format!("cannot write {}: {why}", path.display())))
}

/// Returns the files of a recording at this path, which must not exist yet.
///
/// # Errors
/// The file exists, or its disk is nearly full.
pub fn new_files(path: &std::path::Path, config: &RecordingConfig) -> Result<RecordingFiles, Error> {
    if path.exists() {
        return Err(
            format!("{}: exists already; choose another name for the recording", path.display()).into()
        );
    }
    let files = RecordingFiles::new(path, config.disk_free_bytes());
    files.check_space()?;
    Ok(files)
}
