//! The link's end at the base, for one robot: what has arrived of its map, poses and state.

use crate::content::{compress, decode, encode};
use crate::counters::ByteCounters;
use crate::leadership::{Leadership, PeerDecision};
use crate::part::{self, PartContent, PartKey};
use crate::peer::{Peer, STATE_PERIOD, Timer};
use crate::receiver::{PartChange, PartReceiver};
use crate::scan::{DecimatedScan, ScanRate};
use crate::table::Kind;
use crate::wire::{BaseState, Chunk, INTERRUPTIONS_UNKNOWN, Message, RobotState, WireError, address};
use msg::tiles::ROBOT_TILES_MAX;
use msg::{
    Battery, IndexRect, Monotonic, PauseReason, PoseEstimate, Submap, SubmapPoses, TileMap, Transforms,
    VelocityCommand,
};
use std::collections::BTreeMap;
use std::time::Duration;

/// Shortest time between two lists of held parts.
const LIST_PERIOD: Duration = Duration::from_millis(500);
/// Times that a change of the emergency stop is repeated, and their period: 0.3 s. TCP notices a lost packet by those that
/// arrive after it; without any it waits at least 0.2 s, and twice as long whenever that one is lost, too.
const STOP_REPEATS: u32 = 15;
const STOP_REPEAT_PERIOD: Duration = Duration::from_millis(20);

/// What a robot has sent. All stamps are by the robot's clock.
#[derive(Debug)]
pub enum BaseEvent {
    /// Pose in the robot's map.
    PoseEstimate(PoseEstimate),
    /// Frames of the robot.
    Transforms(Box<Transforms>),
    /// State of the robot's battery, without a stamp.
    Battery(Battery),
    /// Scan with few beams.
    Scan(Box<DecimatedScan>),
    /// The map has changed: see [`BaseEnd::map`].
    Map,
    /// A submap is new or has changed: see [`BaseEnd::submap`].
    Submap(u32),
    /// Poses of the submaps.
    SubmapPoses(Box<SubmapPoses>),
    /// The robot's machine is in this run from now on. Its earlier map was another one, and is forgotten.
    NewRun(u32),
    /// Another session of the robot counts from now on: its clock is not known.
    RobotJoined {
        /// Session of the robot.
        robot: u64,
        /// Session that counted before.
        before: Option<u64>,
    },
}

/// Whether the robot follows the base, as its machine says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hold {
    /// Why it does not; `None`: nothing is known to hold it.
    pub reason: Option<PauseReason>,
    /// Tells the stops and drives by hand at its machine apart from those before: its run and their number in it. 0: not known.
    pub interruptions: u64,
}

/// The newest state that the robot has said.
#[derive(Clone, Copy, Debug, Default)]
struct HeardState {
    newest: RobotState,
    /// When it arrived; 0: never.
    received: Monotonic,
    /// Whether it is of the session that counts. Before, nobody knows of which run that session's messages are.
    is_of_session: bool,
}

impl HeardState {
    /// Returns the state after one that has arrived. The number of interruptions that its bridge did not say is the one of before.
    fn replaced_by(self, mut newest: RobotState, received: Monotonic) -> Self {
        if self.received.0 > 0
            && self.newest.run == newest.run
            && newest.interruptions == INTERRUPTIONS_UNKNOWN
        {
            newest.interruptions = self.newest.interruptions;
        }
        Self { newest, received, is_of_session: true }
    }

    /// Returns what tells the robot's interruptions apart from those before: a reader may have been started again meanwhile. 0: not known.
    fn interruptions(&self) -> u64 {
        let RobotState { run, interruptions, .. } = self.newest;
        let is_known = self.received.0 > 0 && interruptions != INTERRUPTIONS_UNKNOWN;
        if is_known { ((u64::from(run) << 32) | u64::from(interruptions)) + 1 } else { 0 }
    }
}

/// End of the link to one robot. Channels, sockets and the clock are with its owner.
#[derive(Debug)]
pub struct BaseEnd {
    peer: Peer,
    leadership: Leadership,
    receiver: PartReceiver,
    tiles: TileMap,
    has_header: bool,
    /// Hash and compressed content of each submap.
    submaps: BTreeMap<u32, (u64, Vec<u8>)>,
    robot_state: HeardState,
    state: BaseState,
    state_due: Monotonic,
    /// Repetitions of a change of the stop that are left.
    stop_repeats: u32,
    list_timer: Timer,
    /// Pages of the list of held parts that are to be sent.
    is_list_due: bool,
}

impl BaseEnd {
    /// Creates the end. `session` is a random number that tells this process from every other, and `run` one that tells the base's
    /// run from every other.
    pub fn new(session: u64, run: u32) -> Self {
        Self {
            peer: Peer::new(session),
            leadership: Leadership::default(),
            receiver: PartReceiver::default(),
            tiles: TileMap::default(),
            has_header: false,
            submaps: BTreeMap::new(),
            robot_state: HeardState::default(),
            state: BaseState { run, ..BaseState::default() },
            state_due: Monotonic(0),
            stop_repeats: 0,
            list_timer: Timer::new(LIST_PERIOD),
            is_list_due: false,
        }
    }

    /// Returns the robot's map as it has arrived; `None` before its lattice is known.
    pub fn map(&self) -> Option<&TileMap> {
        self.has_header.then_some(&self.tiles)
    }

    /// Returns the ids of the submaps that have arrived.
    pub fn submap_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.submaps.keys().copied()
    }

    /// Returns a submap that has arrived.
    pub fn submap(&self, id: u32) -> Option<Box<Submap>> {
        let (hash, bytes) = self.submaps.get(&id)?;
        match decode(PartKey::Submap(id), *hash, bytes) {
            Ok(PartContent::Submap(submap)) => Some(submap),
            _ => None,
        }
    }

    /// Returns the robot's newest state.
    pub fn robot_state(&self) -> RobotState {
        self.robot_state.newest
    }

    /// Returns when the robot's newest state arrived; 0: never.
    pub fn state_received(&self) -> Monotonic {
        self.robot_state.received
    }

    /// Returns whether the robot follows this base.
    pub fn hold(&self) -> Hold {
        let (newest, interruptions) = (self.robot_state.newest, self.robot_state.interruptions());
        let reason = match newest {
            // It keeps the list of the parts that its base holds.
            RobotState { list_of, .. } if list_of != 0 && list_of != self.peer.session => {
                Some(PauseReason::AnotherBase)
            }
            RobotState { is_own_stop: true, .. } => Some(PauseReason::StoppedAtRobot),
            RobotState { is_driven_by_hand: true, .. } => Some(PauseReason::DrivenAtRobot),
            RobotState { is_late: true, .. } => Some(PauseReason::LateVelocities),
            _ => None,
        };
        Hold { reason, interruptions }
    }

    /// Returns whether two machines bear the robot's name: one is heard, and the other one is refused meanwhile.
    pub fn is_contested(&self, now: Monotonic) -> bool {
        self.leadership.is_contested(now)
    }

    /// Returns whether the robot was heard lately.
    pub fn is_heard(&self, now: Monotonic) -> bool {
        self.leadership.is_heard(now)
    }

    /// Returns the bytes that were received, by kind.
    pub fn received(&self) -> &ByteCounters {
        &self.peer.received
    }

    /// Returns the number of messages of other machines that bear the robot's name, and of parts that were refused.
    pub fn refused(&self) -> u64 {
        self.leadership.refused + self.receiver.refused()
    }

    /// Takes a message of the robot.
    pub fn receive(&mut self, bytes: &[u8], now: Monotonic) -> Result<Vec<BaseEvent>, WireError> {
        let envelope = self.peer.read(bytes)?;
        let mut events = Vec::new();
        match self.leadership.admit(envelope.session, now) {
            PeerDecision::Refused => return Ok(events),
            PeerDecision::Accepted => {}
            PeerDecision::TakenOver { before } => {
                self.peer.heard = Monotonic(0);
                self.robot_state.is_of_session = false;
                events.push(BaseEvent::RobotJoined { robot: envelope.session, before });
            }
        }
        (self.peer.heard, self.peer.to) = (self.peer.heard.max(envelope.sent), address(envelope.session));
        if !self.robot_state.is_of_session && !matches!(envelope.message, Message::RobotState(_)) {
            return Ok(events);
        }
        match envelope.message {
            Message::RobotState(state) => {
                // A session has one run: the first state says it.
                let before = self.robot_state;
                let is_new_run = !before.is_of_session && before.newest.run != state.run;
                if is_new_run {
                    self.forget_map();
                    events.push(BaseEvent::NewRun(state.run));
                }
                self.robot_state = before.replaced_by(state, now);
                self.is_list_due = is_new_run || state.list_of != self.peer.session;
            }
            Message::PoseEstimate(pose_estimate) => events.push(BaseEvent::PoseEstimate(pose_estimate)),
            Message::Transforms(transforms) => events.push(BaseEvent::Transforms(transforms)),
            Message::Battery(battery) => events.push(BaseEvent::Battery(battery)),
            Message::Scan(scan) => events.push(BaseEvent::Scan(scan)),
            Message::Chunk(chunk) => events.extend(self.receive_chunk(&chunk)),
            _ => {}
        }
        Ok(events)
    }

    /// Forgets all that has arrived of the robot's map: it was of an earlier run of the robot's machine.
    fn forget_map(&mut self) {
        self.receiver.forget_parts();
        (self.tiles, self.has_header) = (TileMap::default(), false);
        self.submaps.clear();
    }

    fn receive_chunk(&mut self, chunk: &Chunk) -> Option<BaseEvent> {
        match self.receiver.receive(chunk)? {
            (_, PartChange::Replaced(PartContent::Tile(tile))) => {
                let (x, y) = (i64::from(tile.x), i64::from(tile.y));
                let fits = self.tiles.grow_to(IndexRect::single(x, y), ROBOT_TILES_MAX);
                self.tiles.set(x, y, Some(tile));
                fits.then_some(BaseEvent::Map)
            }
            (_, PartChange::Replaced(PartContent::MapHeader(header))) => {
                (self.tiles.header, self.has_header) = (header, true);
                Some(BaseEvent::Map)
            }
            (_, PartChange::Replaced(PartContent::SubmapPoses(poses))) => Some(BaseEvent::SubmapPoses(poses)),
            (_, PartChange::Replaced(PartContent::Submap(submap))) => {
                let id = submap.id;
                let plain = encode(&PartContent::Submap(submap));
                self.submaps.insert(id, (part::hash(&plain), compress(&plain)));
                Some(BaseEvent::Submap(id))
            }
            (PartKey::Tile(x, y), PartChange::Removed) => {
                self.tiles.set(x.into(), y.into(), None);
                Some(BaseEvent::Map)
            }
            (PartKey::Submap(id), PartChange::Removed) => {
                self.submaps.remove(&id);
                None
            }
            (PartKey::MapHeader | PartKey::SubmapPoses, PartChange::Removed) => None,
        }
    }

    /// Sets whether the base's emergency stop is set; `None` if its bridge does not answer.
    pub fn set_stopped(&mut self, is_stopped: Option<bool>) {
        let (is_stopped, is_known) = (is_stopped == Some(true), is_stopped.is_some());
        let state = BaseState { is_stopped, is_known, ..self.state };
        if state != self.state {
            // A stop does not wait for the next period.
            (self.state, self.state_due, self.stop_repeats) = (state, Monotonic(0), STOP_REPEATS);
        }
    }

    /// Sets which scans somebody at the base looks at; `None`: nobody looks, and the robot sends none.
    pub fn set_scans(&mut self, scans: Option<ScanRate>) {
        if scans != self.state.scans {
            (self.state.scans, self.state_due) = (scans, Monotonic(0));
        }
    }

    /// Hands a velocity for the robot to `send`.
    pub fn send_velocity(
        &mut self,
        command: &VelocityCommand,
        now: Monotonic,
        send: &mut impl FnMut(Kind, &[u8]),
    ) {
        self.peer.send(Message::Velocity(*command), now, send);
    }

    /// Hands all messages that are due to `send`.
    pub fn poll(&mut self, now: Monotonic, send: &mut impl FnMut(Kind, &[u8])) {
        if now >= self.state_due {
            let period = if self.stop_repeats > 0 { STOP_REPEAT_PERIOD } else { STATE_PERIOD };
            self.stop_repeats = self.stop_repeats.saturating_sub(1);
            self.state_due = now + period;
            self.peer.send(Message::BaseState(self.state), now, send);
        }
        if self.is_list_due && self.list_timer.is_due(now) {
            self.is_list_due = false;
            for page in self.receiver.list() {
                self.peer.send(Message::Held(page), now, send);
            }
        }
        let receipts = self.receiver.take_acknowledgements();
        if !receipts.is_empty() {
            self.peer.send(Message::Acknowledgement(receipts), now, send);
        }
    }
}
