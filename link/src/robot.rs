//! The link's end on a robot's machine: its map, poses and state go to the base, velocities and the stop come back.

use crate::battery::WaitingBattery;
use crate::counters::ByteCounters;
use crate::leadership::{Leadership, PeerDecision};
use crate::part::{PartContent, PartKey};
use crate::peer::{Peer, STATE_PERIOD, Timer};
use crate::scan::ScanRate;
use crate::scan_throttle::ScanThrottle;
use crate::sender::{PartSender, SenderConfig};
use crate::stop::{StopFollower, StopRequest};
use crate::table::Kind;
use crate::velocity_admission::VelocityAdmission;
use crate::wire::{BaseState, Message, RobotState, WireError, address};
use msg::{
    Battery, Header, MapHeader, Monotonic, PoseEstimate, Scan, Submap, SubmapPoses, TileMap, Transforms,
    VelocityCommand,
};
use std::collections::BTreeSet;
use std::time::Duration;

/// Period at which parts are looked for that the base holds and the robot has no more.
const CLEAN_UP_PERIOD: Duration = Duration::from_secs(1);
/// Period at which SLAM is asked for its submaps while some are missing.
const SUBMAPS_PERIOD: Duration = Duration::from_secs(10);

/// What a message of the base asks of the robot's machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RobotEvent {
    /// Drive with this velocity, within the robot's own limits. Its header is empty.
    Velocity(VelocityCommand),
    /// Change the emergency stop.
    Stop(StopRequest),
    /// Another session of a base leads from now on.
    BaseLeads {
        /// Session of the base.
        base: u64,
        /// Session that led before.
        before: Option<u64>,
    },
}

/// Who controls the robot at its own machine, as its bridge says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LocalControl {
    /// Whether the emergency stop is set; `None` if the bridge does not answer.
    pub is_stopped: Option<bool>,
    /// Whether a person drives the robot.
    pub is_driven_by_hand: bool,
    /// Number of stops and of drives by hand; it keeps its value while the bridge does not answer.
    pub interruptions: u32,
}

/// Messages that wait for their time: the newest alone counts.
#[derive(Debug, Default)]
struct Newest {
    pose_estimate: Option<PoseEstimate>,
    transforms: Option<Transforms>,
    battery: WaitingBattery,
}

/// Map as SLAM has published it.
#[derive(Debug, Default)]
struct OwnMap {
    tiles: TileMap,
    /// The whole map was received at least once.
    has_tiles: bool,
    /// Number and generation of the submaps, once they are known.
    submaps: Option<(u32, u32)>,
    /// Submaps that were received.
    received: BTreeSet<u32>,
}

#[derive(Debug)]
struct Timers {
    state: Timer,
    poses: Timer,
    clean_up: Timer,
    submaps: Timer,
}

/// End of the link on a robot's machine. Channels, sockets and the clock are with its owner.
#[derive(Debug)]
pub struct RobotEnd {
    peer: Peer,
    run: u32,
    leadership: Leadership,
    follower: StopFollower,
    local: LocalControl,
    admission: VelocityAdmission,
    sender: PartSender,
    newest: Newest,
    scans: ScanThrottle,
    map: OwnMap,
    timers: Timers,
}

impl RobotEnd {
    /// Creates the end. `session` is a random number that tells this process from every other; `run` one that tells this
    /// run of the robot's machine from every other; `scans` is what it sends of scans at most.
    pub fn new(session: u64, run: u32, config: SenderConfig, scans: ScanRate) -> Self {
        Self {
            peer: Peer::new(session),
            run,
            leadership: Leadership::default(),
            follower: StopFollower::default(),
            local: LocalControl::default(),
            admission: VelocityAdmission::default(),
            sender: PartSender::new(config),
            newest: Newest::default(),
            scans: ScanThrottle::new(scans),
            map: OwnMap::default(),
            timers: Timers {
                state: Timer::new(STATE_PERIOD),
                poses: Timer::new(STATE_PERIOD),
                clean_up: Timer::new(CLEAN_UP_PERIOD),
                submaps: Timer::new(SUBMAPS_PERIOD),
            },
        }
    }

    /// Returns the bytes that were sent, by kind.
    pub fn sent(&self) -> &ByteCounters {
        &self.peer.sent
    }

    /// Returns the number of messages of other bases than the one that leads.
    pub fn refused(&self) -> u64 {
        self.leadership.refused
    }

    /// Returns whether the base that leads was heard lately.
    pub fn is_heard(&self, now: Monotonic) -> bool {
        self.leadership.is_heard(now)
    }

    /// Returns the number of parts that the base does not hold as they are.
    pub fn waiting(&self) -> usize {
        self.sender.waiting()
    }

    /// Sets who controls the robot at its own machine. A change is told to the base at once.
    pub fn set_local_control(&mut self, local: LocalControl) {
        if local.is_stopped.is_some() && self.admission.set_interruptions(local.interruptions)
            || local != self.local
        {
            self.timers.state = Timer::new(STATE_PERIOD);
        }
        self.local = local;
    }

    /// Returns the number of velocities of the base that came too late to be obeyed.
    pub fn late_velocities(&self) -> u64 {
        self.admission.late_count
    }

    /// Returns whether all of the base's velocities come too late to be obeyed.
    pub fn is_late(&self, now: Monotonic) -> bool {
        self.admission.is_late(now)
    }

    /// Returns whether the base has accepted another machine that bears this robot's name, and obeys nothing of this one.
    pub fn is_refused(&self) -> bool {
        self.admission.is_refused()
    }

    /// Takes a message of a base. Velocities that waited on the way ask for nothing, nor does a second base but for its emergency
    /// stop: each base that has the keys may stop a robot.
    pub fn receive(&mut self, bytes: &[u8], now: Monotonic) -> Result<Vec<RobotEvent>, WireError> {
        let envelope = self.peer.read(bytes)?;
        let mut events = Vec::new();
        match self.leadership.admit(envelope.session, now) {
            PeerDecision::Refused => {
                if let Message::BaseState(state) = envelope.message {
                    events.extend(self.follow_stop(envelope.session, state, now));
                }
                return Ok(events);
            }
            PeerDecision::Accepted => {}
            PeerDecision::TakenOver { before } => {
                self.sender.forget_list();
                self.scans.set_asked(None);
                self.peer.heard = Monotonic(0);
                events.push(RobotEvent::BaseLeads { base: envelope.session, before });
            }
        }
        (self.peer.heard, self.peer.to) = (self.peer.heard.max(envelope.sent), address(envelope.session));
        let is_ours = self.admission.is_addressed(envelope.to, address(self.peer.session), now);
        match envelope.message {
            Message::BaseState(state) => {
                self.scans.set_asked(state.scans);
                events.extend(self.follow_stop(envelope.session, state, now));
            }
            Message::Velocity(command) if is_ours && self.admission.admit(envelope.answers, now) => {
                events.push(RobotEvent::Velocity(command));
            }
            Message::Held(page) => drop(self.sender.receive_list(page, envelope.session)),
            Message::Acknowledgement(receipts) => self.sender.acknowledge(&receipts, now),
            _ => {}
        }
        Ok(events)
    }

    fn follow_stop(&mut self, base: u64, state: BaseState, now: Monotonic) -> Option<RobotEvent> {
        self.follower.follow(base, state, self.local.is_stopped, now).map(RobotEvent::Stop)
    }

    /// Keeps the robot's newest pose until it is sent.
    pub fn put_pose_estimate(&mut self, pose_estimate: &PoseEstimate) {
        self.newest.pose_estimate = Some(*pose_estimate);
    }

    /// Keeps the robot's newest frames until they are sent.
    pub fn put_transforms(&mut self, transforms: &Transforms) {
        self.newest.transforms = Some(*transforms);
    }

    /// Keeps the newest state of the robot's battery until it is sent.
    pub fn put_battery(&mut self, battery: &Battery, now: Monotonic) {
        self.newest.battery.put(battery, now);
    }

    /// Returns whether somebody at the base looks at scans, so that [`Self::put_scan`] has a use.
    pub fn is_scan_wanted(&self, now: Monotonic) -> bool {
        self.scans.is_asked() && self.leadership.is_heard(now)
    }

    /// Takes the robot's newest scan, which is sent if somebody at the base looks and the rate allows it.
    pub fn put_scan(&mut self, scan: &Scan, now: Monotonic) {
        self.scans.put(scan, now);
    }

    /// Takes a new version of the robot's map.
    pub fn put_map(&mut self, map: &TileMap, now: Monotonic) {
        for (x, y) in map.changed_since(&self.map.tiles) {
            let key = PartKey::Tile(x as i32, y as i32);
            match map.get(x, y) {
                Some(tile) => self.sender.put(key, &PartContent::Tile(tile.clone()), now),
                None => self.sender.remove(key, now),
            }
        }
        let header = stamp_only(map.header.header);
        let header = MapHeader { header, scan_sent: Monotonic(0), ..map.header };
        self.sender.put(PartKey::MapHeader, &PartContent::MapHeader(header), now);
        (self.map.tiles, self.map.has_tiles) = (map.clone(), true);
    }

    /// Takes a new or changed submap.
    pub fn put_submap(&mut self, submap: &Submap, now: Monotonic) {
        let mut submap = Box::new(*submap);
        submap.grid.header = stamp_only(submap.grid.header);
        submap.grid.scan_sent = Monotonic(0);
        self.map.received.insert(submap.id);
        self.sender.put(PartKey::Submap(submap.id), &PartContent::Submap(submap), now);
    }

    /// Takes the submaps' newest poses.
    pub fn put_submap_poses(&mut self, poses: &SubmapPoses, now: Monotonic) {
        let known = (poses.poses().len() as u32, poses.generation);
        if self.map.submaps.is_some_and(|(_, generation)| generation != known.1) {
            self.map.received.clear();
        }
        self.map.submaps = Some(known);
        let mut poses = Box::new(*poses);
        poses.header = stamp_only(poses.header);
        self.sender.put(PartKey::SubmapPoses, &PartContent::SubmapPoses(poses), now);
    }

    /// Returns whether SLAM is to be asked for all submaps, because some were never received. At most every 10 s.
    pub fn needs_submaps(&mut self, now: Monotonic) -> bool {
        let received = &self.map.received;
        let is_missing = |(count, _): (u32, u32)| (0..count).any(|id| !received.contains(&id));
        self.map.submaps.is_some_and(is_missing) && self.timers.submaps.is_due(now)
    }

    /// Hands all messages that are due to `send`.
    pub fn poll(&mut self, now: Monotonic, send: &mut impl FnMut(Kind, &[u8])) {
        if self.timers.clean_up.is_due(now) {
            self.remove_old_parts(now);
        }
        if self.timers.state.is_due(now) {
            let state = self.state(now);
            self.peer.send(Message::RobotState(state), now, send);
        }
        let scan = self.scans.take();
        if !self.leadership.is_heard(now) {
            return;
        }
        // Driving by a scan needs the pose of the same time.
        if self.timers.poses.is_due(now) || scan.is_some() {
            if let Some(transforms) = self.newest.transforms.take() {
                self.peer.send(Message::Transforms(Box::new(transforms)), now, send);
            }
            if let Some(pose_estimate) = self.newest.pose_estimate.take() {
                self.peer.send(Message::PoseEstimate(pose_estimate), now, send);
            }
        }
        if let Some(battery) = self.newest.battery.take(now) {
            self.peer.send(Message::Battery(battery), now, send);
        }
        if let Some(scan) = scan {
            self.peer.send(Message::Scan(scan), now, send);
        }
        while let Some(chunk) = self.sender.next_chunk(now) {
            self.peer.send(Message::Chunk(chunk), now, send);
        }
    }

    fn state(&mut self, now: Monotonic) -> RobotState {
        let is_stopped = self.local.is_stopped == Some(true);
        RobotState {
            list_of: self.sender.list_of(),
            run: self.run,
            waiting: self.sender.waiting() as u32,
            is_stopped,
            is_known: self.local.is_stopped.is_some(),
            is_own_stop: is_stopped && self.follower.is_own(self.leadership.session(), now),
            is_driven_by_hand: self.local.is_driven_by_hand,
            is_late: self.admission.is_late(now),
            interruptions: self.admission.report_interruptions(now),
        }
    }

    /// Removes from the base what an earlier map of the robot had. What is not known yet is left alone.
    fn remove_old_parts(&mut self, now: Monotonic) {
        let map = &self.map;
        let exists = |key| match key {
            PartKey::Tile(x, y) => !map.has_tiles || map.tiles.get(x.into(), y.into()).is_some(),
            PartKey::Submap(id) => map.submaps.is_none_or(|(count, _)| id < count),
            PartKey::MapHeader | PartKey::SubmapPoses => true,
        };
        self.sender.remove_unless(exists, now);
    }
}

/// Returns the header's stamp without what its channel gave it.
fn stamp_only(header: Header) -> Header {
    Header { stamp: header.stamp, ..Header::default() }
}
