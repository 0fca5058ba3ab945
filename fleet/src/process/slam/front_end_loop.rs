//! The scan path: answers each scan with a pose and passes nodes to the back end. It waits for scans only.

use super::{BackEndInput, FrontCommand, FrontEvent, TrajectoryStart};
use crate::channel;
use crate::ports::{ChannelError, Ports, ReadPort, WritePort};
use crate::process::heartbeat::{HealthCounters, Heartbeat};
use crate::process::{Listens, ProcessLoop};
use crate::run::Run;
use ::slam::{FrontEnd, FrontEndState};
use msg::{Header, Monotonic, Odometry, Pose2, PoseEstimate, RobotId, Role, Scan, TrackingState};
use std::sync::mpsc::{Receiver, SyncSender};

/// Scans for which a front end that begins at the last known `odom` waits for odometry: without it, the pose of the
/// robot in `odom` is unknown. A robot without odometry begins after them.
const SCANS_WITHOUT_ODOMETRY_MAX: u32 = 10;
/// Largest difference of the stamps of a scan and its odometry, seconds: one period of odometry.
const ODOMETRY_AGE_MAX_S: f64 = 0.05;

/// The scan path with its channels.
pub struct FrontEndLoop<P: Ports> {
    runner: FrontEndRunner,
    scans: P::Reader<Scan>,
    scan_listener: P::Listener,
    odometry: P::Reader<Odometry>,
    pose_estimates: P::Writer<PoseEstimate>,
    heartbeat: Heartbeat<P>,
    refused: u64,
}

impl<P: Ports> FrontEndLoop<P> {
    /// Opens the channels.
    pub fn open(
        ports: &P,
        run: &Run,
        robot: RobotId,
        beginning: BeginningFrontEnd,
        events: SyncSender<BackEndInput>,
        commands: Receiver<FrontCommand>,
    ) -> Result<Self, ChannelError> {
        Ok(Self {
            heartbeat: Heartbeat::new(ports, run, Role::Slam, Some(robot))?,
            scans: ports.reader(&channel::scan(robot))?,
            scan_listener: ports.listener(&channel::scan(robot))?,
            odometry: ports.reader(&channel::odometry(robot))?,
            pose_estimates: ports.writer(&channel::pose_estimate(robot))?,
            runner: FrontEndRunner::new(beginning, events, commands),
            refused: 0,
        })
    }

    /// Reports the last state of the front end; the process ends.
    pub fn end(self) {
        self.runner.end();
    }

    /// Returns the state of the front end.
    pub fn front_state(&self) -> FrontEndState {
        self.runner.front.state()
    }

    /// Returns the number of events that were lost to a full queue since the start.
    pub fn events_lost(&self) -> u64 {
        self.runner.events_lost.get()
    }
}

impl<P: Ports> ProcessLoop for FrontEndLoop<P> {
    fn step(&mut self) -> Monotonic {
        let Self { runner, scans, odometry, pose_estimates, heartbeat, refused, .. } = self;
        runner.apply_commands();
        while let Some(scan) = scans.receive() {
            while let Some(odometry) = odometry.receive() {
                runner.add_odometry(&odometry);
            }
            runner.apply_commands();
            let (pose_estimate, used) = heartbeat.measure(|| runner.process(&scan));
            *refused += u64::from(!used);
            if let Some(pose_estimate) = pose_estimate {
                pose_estimates.send(&pose_estimate);
            }
        }
        let dropped = runner.events_lost.get();
        let counters = HealthCounters {
            receive_counts: scans.receive_counts(),
            refused: *refused,
            dropped,
            ..HealthCounters::default()
        };
        heartbeat.publish_if_due(|| counters);
        heartbeat.due()
    }
}

impl<P: Ports> Listens<P::Listener> for FrontEndLoop<P> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        std::iter::once(&self.scan_listener)
    }
}

/// The front end with which a process begins, and where it begins.
pub struct BeginningFrontEnd {
    /// The front end, new or of a session.
    pub front: FrontEnd,
    /// Pose of `odom` in the map before the restart of the process, if the front end does not know its own pose.
    pub restart_map_from_odom: Option<Pose2>,
    /// The same, whatever the front end knows; `None`: the process is the first one, or nobody knew it.
    pub given_map_from_odom: Option<Pose2>,
    /// Whether SLAM is paused: it looks at one scan, which tells where the robot is.
    pub is_paused: bool,
}

/// The front end, and its queues to and from the back end.
struct FrontEndRunner {
    front: Box<FrontEnd>,
    /// Counts the front ends that were put in place.
    number: u32,
    paused: bool,
    /// Pose of `odom` in the map before a restart, until the first scan has used it.
    restart_map_from_odom: Option<Pose2>,
    /// Pose of `odom` in the map before the restart of the process, as the launcher knew it.
    given_map_from_odom: Option<Pose2>,
    /// Where the front end began anew, reported with the next node.
    trajectory_start: Option<TrajectoryStart>,
    /// Number of scans that have waited for odometry.
    waited: u32,
    last: Option<PoseEstimate>,
    /// The newest odometry.
    odometry: Option<Odometry>,
    events: SyncSender<BackEndInput>,
    events_lost: std::cell::Cell<u64>,
    commands: Receiver<FrontCommand>,
}

impl FrontEndRunner {
    fn new(
        BeginningFrontEnd { front, restart_map_from_odom, given_map_from_odom, is_paused }: BeginningFrontEnd,
        events: SyncSender<BackEndInput>,
        commands: Receiver<FrontCommand>,
    ) -> Self {
        Self {
            front: Box::new(front),
            number: 0,
            paused: is_paused,
            restart_map_from_odom,
            given_map_from_odom,
            trajectory_start: None,
            last: None,
            waited: 0,
            odometry: None,
            events,
            events_lost: std::cell::Cell::new(0),
            commands,
        }
    }

    /// Sends an event and never waits. Returns false if the queue is full: the event is lost, which the back end must
    /// survive.
    fn report(&self, event: FrontEvent) -> bool {
        let sent = self.events.try_send(BackEndInput::FrontEnd(self.number, event)).is_ok();
        self.events_lost.set(self.events_lost.get() + u64::from(!sent));
        sent
    }

    /// Reports the last state, and waits until the queue has room: no scan waits any more, and the back end ends on it alone.
    fn end(self) {
        let state = Box::new(self.front.state());
        // Without a back end nobody waits for it.
        let _ = self.events.send(BackEndInput::FrontEnd(self.number, FrontEvent::Ended(state)));
    }

    fn apply_commands(&mut self) {
        while let Ok(command) = self.commands.try_recv() {
            match command {
                FrontCommand::QueueFrameUpdate(frame_update) => self.front.add_frame_update(frame_update),
                FrontCommand::Pause(paused) => self.paused = paused,
                FrontCommand::ReportState => {
                    self.report(FrontEvent::State(Box::new(self.front.state())));
                }
                FrontCommand::Replace { number, front, keeps_pose } => {
                    let old = core::mem::replace(&mut self.front, front);
                    if let Some(odometry) = &self.odometry {
                        self.front.add_odometry(odometry);
                    }
                    self.continue_after_replacement(keeps_pose);
                    // Dropping it takes long, so the back end does that.
                    self.report(FrontEvent::Replaced(old));
                    self.number = number;
                }
                FrontCommand::SetInitialEstimate(Some(estimate)) => self.front.set_initial_estimate(estimate),
                FrontCommand::SetInitialEstimate(None) => self.front.set_map_from_local(None),
                FrontCommand::ApplyFrameUpdateNow(frame_update) => {
                    self.front.apply_frame_update(frame_update)
                }
                FrontCommand::RequestNode => self.front.request_node(),
            }
        }
    }

    fn add_odometry(&mut self, odometry: &Odometry) {
        // A message of the driver before, that comes late, says nothing about where `odom` lies now.
        if !self.front.add_odometry(odometry) {
            return;
        }
        let before = self.odometry.replace(*odometry);
        if let Some(before) = before.filter(|before| before.header.incarnation != odometry.header.incarnation)
        {
            // The restarted driver counts odometry from a new origin; the robot stood meanwhile.
            self.move_odom_origin(before.odom_from_base * odometry.odom_from_base.inverse());
        }
        if self.front.take_unknown_motion() {
            self.trajectory_start = Some(TrajectoryStart::Unknown);
        }
    }

    /// Follows an origin of odometry that a restarted driver has set anew, in each pose of `odom` that is kept.
    fn move_odom_origin(&mut self, odom_from_new_odom: Pose2) {
        if let Some(map_from_odom) = &mut self.restart_map_from_odom {
            *map_from_odom = *map_from_odom * odom_from_new_odom;
        }
        if let Some(map_from_odom) = &mut self.given_map_from_odom {
            *map_from_odom = *map_from_odom * odom_from_new_odom;
        }
        if let Some(last) = self.last.as_mut().filter(|last| last.map_from_odom().is_some()) {
            last.map_from_odom = last.map_from_odom * odom_from_new_odom;
        }
    }

    /// Returns whether the first scan must wait for its odometry, because it begins at a known `odom`.
    fn waits_for_odometry(&mut self, scan: &Scan) -> bool {
        let age_s = self.odometry.map(|odometry| scan.header.stamp - odometry.header.stamp);
        let known = age_s.is_some_and(|age_s| (0.0..ODOMETRY_AGE_MAX_S).contains(&age_s));
        let waits =
            self.restart_map_from_odom.is_some() && !known && self.waited < SCANS_WITHOUT_ODOMETRY_MAX;
        self.waited += u32::from(waits);
        waits
    }

    /// Returns the answer to a scan, if there is one, and whether the scan was valid.
    fn process(&mut self, scan: &Scan) -> (Option<PoseEstimate>, bool) {
        if self.paused
            && let Some(last) = self.last
        {
            self.last = Some(self.paused_estimate(last, scan));
            return (self.last, true);
        }
        if self.waits_for_odometry(scan) {
            self.last = self.last.map(|last| self.dead_reckoned(last, scan));
            return (self.last, true);
        }
        if self.restart_map_from_odom.is_some() && self.front.odom_from_base(scan.header.stamp).is_none() {
            // Without odometry, where `odom` lies does not tell where the robot is.
            self.restart_map_from_odom = None;
            self.front.set_map_from_local(None);
            self.trajectory_start = Some(TrajectoryStart::Unknown);
        }
        let mut result = self.front.process(scan);
        if result.rejected.is_none()
            && let Some(local_from_odom) = result.pose_estimate.map_from_odom()
            && let Some(map_from_odom) = self.restart_map_from_odom.take()
        {
            let map_from_local = map_from_odom * local_from_odom.inverse();
            self.front.set_map_from_local(Some(map_from_local));
            result.pose_estimate.map_from_base = map_from_local * result.pose_estimate.map_from_base;
            result.pose_estimate.map_from_odom = map_from_odom;
            self.trajectory_start = Some(TrajectoryStart::At { map_from_local });
        }
        if let Some(node) = result.node
            && self.report(FrontEvent::Node(node, self.trajectory_start))
        {
            self.trajectory_start = None;
        }
        // In a pause the pose follows odometry from the one scan that is looked at.
        let has_odometry = result.pose_estimate.map_from_odom().is_some();
        let gives_place = result.rejected.is_none()
            && result.pose_estimate.state() != TrackingState::Lost
            && (has_odometry || self.waited >= SCANS_WITHOUT_ODOMETRY_MAX);
        self.waited += u32::from(self.paused && !gives_place);
        if !self.paused || gives_place {
            self.last = Some(result.pose_estimate);
        }
        (Some(result.pose_estimate), result.rejected.is_none())
    }

    /// Begins with a new front end: at the robot's last pose if it `keeps_pose`, as the frame of the map is the same.
    fn continue_after_replacement(&mut self, keeps_pose: bool) {
        (self.restart_map_from_odom, self.trajectory_start, self.waited) = (None, None, 0);
        match self.last.filter(|_| keeps_pose) {
            // No scan has come since the process was started again.
            None if keeps_pose => self.restart_map_from_odom = self.given_map_from_odom,
            Some(last) if last.map_from_odom().is_some() => self.restart_map_from_odom = last.map_from_odom(),
            Some(last) => {
                // Without odometry: the new front end's frame lies where the robot stands.
                self.front.set_map_from_local(Some(last.map_from_base));
                self.trajectory_start = Some(TrajectoryStart::At { map_from_local: last.map_from_base });
            }
            None => {}
        }
    }

    /// Returns the pose by odometry alone, and how well that is known. A robot that was lost stays lost in a pause.
    fn paused_estimate(&mut self, last: PoseEstimate, scan: &Scan) -> PoseEstimate {
        let estimate = self.dead_reckoned(last, scan);
        let covariance = self.front.covariance_by_odometry(scan.header.stamp, estimate.map_from_base);
        let state = match last.state() {
            TrackingState::Lost => TrackingState::Lost,
            _ => TrackingState::Paused,
        };
        PoseEstimate { covariance, state: state as u32, ..estimate }
    }

    /// Returns the pose by odometry alone, while scans are ignored; without odometry, the last pose.
    fn dead_reckoned(&self, last: PoseEstimate, scan: &Scan) -> PoseEstimate {
        let moved = last.map_from_odom().zip(self.front.odom_from_base(scan.header.stamp));
        PoseEstimate {
            header: Header { stamp: scan.header.stamp, ..Default::default() },
            scan_seq: scan.header.seq,
            scan_sent: scan.header.sent,
            map_from_base: moved
                .map_or(last.map_from_base, |(map_from_odom, odom_from_base)| map_from_odom * odom_from_base),
            ..last
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::slam::{InitialPose, SlamConfig, create_or_resume};
    use msg::SlamMode;
    use std::sync::mpsc::sync_channel;

    /// A front end whose queue to the back end has room for one event, and the other end of the queue.
    fn runner() -> (FrontEndRunner, Receiver<BackEndInput>) {
        let (front, _) =
            create_or_resume(SlamConfig::default(), None, SlamMode::Mapping, InitialPose::Unknown);
        let beginning = BeginningFrontEnd {
            front,
            restart_map_from_odom: None,
            given_map_from_odom: None,
            is_paused: false,
        };
        let (events, inputs) = sync_channel(1);
        let (_, commands) = sync_channel(1);
        (FrontEndRunner::new(beginning, events, commands), inputs)
    }

    #[test]
    fn the_back_end_is_told_of_the_end_though_its_queue_was_full() {
        let (runner, inputs) = runner();
        let state = || FrontEvent::State(Box::new(runner.front.state()));
        assert!(runner.report(state()));
        assert!(!runner.report(state()), "the queue is full");
        let scan_path = std::thread::spawn(move || runner.end());
        let events: Vec<BackEndInput> = inputs.iter().collect();
        scan_path.join().unwrap();
        let kinds = events.iter().map(|event| match event {
            BackEndInput::FrontEnd(_, FrontEvent::State(_)) => "state",
            BackEndInput::FrontEnd(_, FrontEvent::Ended(_)) => "ended",
            _ => "other",
        });
        assert_eq!(kinds.collect::<Vec<_>>(), ["state", "ended"]);
    }

    #[test]
    fn the_scan_path_ends_without_a_back_end_too() {
        let (runner, inputs) = runner();
        assert!(runner.report(FrontEvent::State(Box::new(runner.front.state()))));
        drop(inputs);
        runner.end();
    }
}
