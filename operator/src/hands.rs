//! The hands: 20 times a second, look at the picture, let the tour decide, move the stick.

use crate::client::Voice;
use crate::measures::LinkReport;
use crate::picture::{RobotPicture, read_maps};
use crate::report::{MapReport, OperatorReport, RobotReport};
use crate::{OperatorArgs, OperatorError, SharedHeard, lock, stamp};
use bridge::ros;
use msg::RobotId;
use nav::joystick::{Joystick, Stick, Twist};
use nav::sight::{RobotSight, Sight};
use nav::tour::{Hand, Tour, TourConfig};
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A headset sends its stick at 20 Hz.
const TICK: Duration = Duration::from_millis(50);
/// The connector asks for the topics at most this often.
const TOPICS_EVERY: Duration = Duration::from_secs(5);
/// The bridge's word on which robot is selected follows ours after this at the latest; if it then says another one,
/// somebody else selected it, and `/cmd_vel` is not for our robot.
const SELECTION_SETTLES: Duration = Duration::from_millis(200);
/// Then we select ours again, but not more often than this.
const SELECT_AGAIN: Duration = Duration::from_secs(1);

#[derive(Clone, Copy)]
struct Selection {
    robot: RobotId,
    connection: u64,
    at: Instant,
}

pub(crate) struct Hands<'a> {
    args: &'a OperatorArgs,
    voice: Voice,
    heard: &'a SharedHeard,
    epoch: Instant,
    joystick: Joystick,
    tour: Option<Tour>,
    known: BTreeSet<RobotId>,
    selection: Option<Selection>,
    commands: u64,
    moves: Vec<Hand>,
}

impl<'a> Hands<'a> {
    pub(crate) fn new(args: &'a OperatorArgs, voice: Voice, heard: &'a SharedHeard, epoch: Instant) -> Self {
        Self {
            args,
            voice,
            heard,
            epoch,
            joystick: Joystick::default(),
            tour: None,
            known: BTreeSet::new(),
            selection: None,
            commands: 0,
            moves: Vec::new(),
        }
    }

    /// Drives until `stop` or the time is over, and lets go.
    pub(crate) fn work(&mut self, stop: &AtomicBool) {
        let end =
            self.args.seconds.and_then(|s| self.epoch.checked_add(Duration::try_from_secs_f64(s).ok()?));
        let mut tick = self.epoch;
        let mut asked = self.epoch;
        if let Some(count) = self.args.robots {
            self.meet(RobotId::first(usize::from(count)).collect());
        }
        while !stop.load(Ordering::Relaxed) && end.is_none_or(|end| tick < end) {
            if tick.duration_since(asked) >= TOPICS_EVERY {
                self.voice.ask_topics();
                asked = tick;
            }
            self.tick(tick);
            // Late ticks are left out, not made up for.
            let now = Instant::now();
            tick += TICK;
            match tick.checked_duration_since(now) {
                Some(rest) => std::thread::sleep(rest),
                None => tick = now,
            }
        }
        self.let_go();
    }

    fn tick(&mut self, now: Instant) {
        let unread = lock(self.heard).picture.unread_maps();
        let maps = read_maps(unread);
        let (robots, selected, stopped, found) = {
            let mut heard = lock(self.heard);
            heard.picture.put_maps(maps);
            let at = stamp(self.epoch, Instant::now());
            let robots: Vec<RobotPicture> =
                self.known.iter().map(|robot| heard.picture.robot(at, *robot)).collect();
            let found = self.args.robots.is_none().then(|| heard.robots.clone());
            (robots, heard.picture.selected(), heard.picture.stopped(), found)
        };
        self.meet(found.unwrap_or_default());
        let Some(tour) = &mut self.tour else { return };
        let sights: Vec<RobotSight> = robots.iter().map(RobotPicture::sight).collect();
        let sight = Sight { stamp: stamp(self.epoch, Instant::now()), robots: &sights };
        let mut moves = core::mem::take(&mut self.moves);
        if self.args.all_at_once {
            tour.step_all(&sight, &mut moves);
        } else {
            moves.clear();
            moves.push(tour.step(&sight));
        }
        for hand in &moves {
            let stick = if stopped { Stick::CENTRED } else { hand.stick };
            self.push(now, hand.robot, stick, selected);
        }
        self.moves = moves;
    }

    /// Registers for robots not met before, as a headset does once it knows of them.
    fn meet(&mut self, robots: BTreeSet<RobotId>) {
        for robot in robots {
            if !self.known.insert(robot) {
                continue;
            }
            self.voice.subscribe(&format!("/{robot}/scan"), "sensor_msgs/LaserScan");
            self.voice.subscribe(&format!("/{robot}/map"), "nav_msgs/OccupancyGrid");
            self.voice.subscribe(&format!("/{robot}/slam_stats"), "std_msgs/Float32MultiArray");
            if self.args.all_at_once {
                self.voice.advertise::<ros::Twist>(&own_topic(robot));
            }
            match &mut self.tour {
                Some(tour) => tour.add(robot),
                None => self.tour = Tour::new(self.config(), [robot]),
            }
        }
        if let Some(tour) = &mut self.tour {
            tour.set_turn_s(turn_s(self.args, self.known.len()));
        }
    }

    fn config(&self) -> TourConfig {
        TourConfig { turn_s: turn_s(self.args, 1), joystick: self.joystick, seed: self.args.seed }
    }

    /// One command to one robot.
    fn push(&mut self, now: Instant, robot: RobotId, stick: Stick, selected: Option<i32>) {
        let Twist { linear_m_s, angular_rad_s } = self.joystick.twist(stick);
        let twist = ros::Twist { linear: [linear_m_s, 0.0, 0.0], angular: [0.0, 0.0, angular_rad_s] };
        let sent = if self.args.all_at_once {
            self.voice.publish(&own_topic(robot), &twist)
        } else {
            self.select(now, robot, selected) && self.voice.publish("/cmd_vel", &twist)
        };
        self.commands += u64::from(sent);
    }

    /// Tells the bridge which robot is in the hand, where it does not know. Whether `/cmd_vel` reaches that robot.
    fn select(&mut self, now: Instant, robot: RobotId, selected: Option<i32>) -> bool {
        let connection = self.voice.connections();
        let told = self.selection.filter(|told| told.robot == robot && told.connection == connection);
        let since = told.map_or(Duration::MAX, |told| now.saturating_duration_since(told.at));
        let other = selected.is_some_and(|number| number != robot.number() as i32);
        if told.is_none() || (other && since >= SELECT_AGAIN) {
            self.selection = Some(Selection { robot, connection, at: now });
            return self.voice.publish("/selected_robot", &ros::Int32(robot.number() as i32));
        }
        !(other && since >= SELECTION_SETTLES)
    }

    /// The stick back to its middle, for whatever is in the hand.
    fn let_go(&mut self) {
        let still = ros::Twist::default();
        if self.args.all_at_once {
            for robot in &self.known {
                self.voice.publish(&own_topic(*robot), &still);
            }
        } else if self.selection.is_some() {
            self.voice.publish("/cmd_vel", &still);
        }
    }

    pub(crate) fn report(self, address: String, link: LinkReport) -> Result<OperatorReport, OperatorError> {
        let heard = lock(self.heard);
        let Some(tour) = self.tour else {
            return Err(OperatorError::NoRobots { address, topics: heard.topics });
        };
        let robots = tour.figures().map(|(robot, turns, held_s, did)| RobotReport {
            robot: robot.number(),
            turns,
            held_s,
            did,
        });
        Ok(OperatorReport {
            address,
            seconds: self.epoch.elapsed().as_secs_f64(),
            robots: robots.collect(),
            commands: self.commands,
            map: heard.picture.merged_map().map(|map| MapReport::of(&map)),
            link,
            notices: heard.notices.iter().cloned().collect(),
        })
    }
}

fn own_topic(robot: RobotId) -> String {
    format!("/cmd_vel_{}", robot.number())
}

/// As asked for; else so that every robot gets three turns, but none too short to get anywhere.
fn turn_s(args: &OperatorArgs, robots: usize) -> f64 {
    let fitting = args.seconds.map_or(20.0, |seconds| seconds / (3.0 * robots as f64));
    args.turn_seconds.unwrap_or(fitting.clamp(8.0, 20.0))
}
