//! Faults of real robots' drivers, drawn at random: each is told of its robot and of no other, and without a fault nothing is told.

use super::tests::{edge, exact, payload};
use super::*;
use proptest::prelude::*;
use ros_messages::cdr::Reader;
use ros_messages::{LaserScan, TfMessage};

/// Length of a trial, and when the fault begins, seconds.
const TRIAL_S: f64 = 100.0;
const FAULT_S: f64 = 20.0;
/// Time of the run when the trial begins, seconds: the stamps of a clock that is behind are not before its beginning.
const BEGIN_S: f64 = 5000.0;
/// Time between two steps, ns: scans come each tenth of a second, odometry each twentieth.
const STEP_NS: i64 = 10_000_000;
/// How the robot moves changes after this time, seconds.
const MOTION_S: f64 = 4.0;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// Odometry was never there.
    NoOdometry,
    /// Odometry ends, and comes again.
    OdometryEnds,
    /// The LiDAR repeats one measurement.
    LidarHangs,
    /// The robot's clock is off by so much from the beginning, seconds.
    Clock(f64),
    /// Odometry loses its origin while it is published on.
    OdometryReset,
    /// The driver is started again under another publisher.
    DriverRestart,
    /// Nothing comes for a while: the network, or the robot, is away.
    Silence,
    /// Messages wait for a while, and then come at once.
    Stall(f64),
}

/// What the operator is to read of the fault, in this order, and nothing else.
fn expected(fault: Fault) -> &'static [&'static str] {
    match fault {
        Fault::None | Fault::Silence | Fault::Stall(_) | Fault::LidarHangs => &[],
        Fault::NoOdometry => &["but no odometry"],
        Fault::OdometryEnds => &["odometry has ended", "odometry comes again"],
        Fault::Clock(ahead_s) if ahead_s > 0.0 => &["ahead of this machine's clock"],
        Fault::Clock(_) => &["before they arrive"],
        Fault::OdometryReset => &["odometry jumps"],
        Fault::DriverRestart => &["its driver was started again"],
    }
}

#[derive(Clone, Debug)]
struct Trial {
    fault: Fault,
    /// How long it lasts, seconds.
    lasts_s: f64,
    is_odometry_topic: bool,
    /// Speeds, m/s and rad/s, one after another.
    motions: Vec<(f64, f64)>,
    /// Times from a stamp to the arrival, seconds, one after another.
    delays_s: Vec<f64>,
}

fn trials() -> impl Strategy<Value = Trial> {
    let fault = prop_oneof![
        Just(Fault::None),
        Just(Fault::NoOdometry),
        Just(Fault::OdometryEnds),
        Just(Fault::LidarHangs),
        (1.4..4000.0).prop_map(Fault::Clock),
        (-4000.0..-1.4).prop_map(Fault::Clock),
        Just(Fault::OdometryReset),
        Just(Fault::DriverRestart),
        Just(Fault::Silence),
        (0.2..1.5).prop_map(Fault::Stall),
    ];
    let motions = prop::collection::vec((0.15..0.6, -1.5..1.5), 4..12);
    // A driver may be away for a moment alone; what is to be noticed lasts longer.
    let lasts_s = prop_oneof![0.1..2.0, 2.0..8.0, 8.0..30.0];
    (fault, lasts_s, any::<bool>(), motions, prop::collection::vec(0.0..0.25, 5..40)).prop_map(
        |(fault, lasts_s, is_odometry_topic, motions, delays_s)| Trial {
            fault,
            lasts_s: if matches!(fault, Fault::OdometryEnds | Fault::LidarHangs) {
                8.0 + lasts_s
            } else {
                lasts_s
            },
            is_odometry_topic,
            motions,
            delays_s,
        },
    )
}

/// A robot with its driver, and what it has sent that is still on its way.
struct Driver {
    number: usize,
    fault: Fault,
    publisher: u8,
    /// True pose, and that of odometry's origin.
    world_from_base: Pose2,
    world_from_odom: Pose2,
    /// What odometry lost when it was reset.
    lost: Pose2,
    /// Messages on their way: when each arrives, seconds, who sent it, and whether it is a scan.
    on_way: Vec<(f64, Sender, bool, Vec<u8>)>,
    newest_arrival_s: f64,
    messages: usize,
}

/// What came of a trial.
#[derive(Default)]
struct Outcome {
    notices: Vec<String>,
    /// Refused scans of each robot: their times, seconds, and the reasons.
    refused: [Vec<(f64, String)>; 2],
    /// Accepted scans of each robot: their times.
    accepted: [Vec<f64>; 2],
    /// What odometry of the first robot lost by a reset.
    lost: Pose2,
}

impl Driver {
    fn new(number: usize, fault: Fault) -> Self {
        let at = Pose2::new(3.0 * number as f64, 1.0, 0.5);
        Self {
            number,
            fault,
            publisher: number as u8,
            world_from_base: at,
            world_from_odom: at,
            lost: Pose2::IDENTITY,
            on_way: Vec::new(),
            newest_arrival_s: 0.0,
            messages: 0,
        }
    }

    fn frame(&self, name: &str) -> String {
        format!("{name}_{}", self.number)
    }

    fn sender(&self) -> Sender {
        Sender { source: 1, publisher: Some([self.publisher; 16]) }
    }

    fn step(&mut self, trial: &Trial, now_s: f64, step: i64) {
        let since_s = now_s - FAULT_S;
        let is_wrong = (0.0..trial.lasts_s).contains(&since_s);
        let (v, w) = trial.motions[(now_s / MOTION_S) as usize % trial.motions.len()];
        let dt_s = STEP_NS as f64 * 1e-9;
        self.world_from_base = self.world_from_base * Pose2::new(v * dt_s, 0.0, w * dt_s);
        let begins = is_wrong && since_s < dt_s;
        match self.fault {
            Fault::OdometryReset if begins => {
                self.lost = self.world_from_odom.between(self.world_from_base);
                self.world_from_odom = self.world_from_base;
            }
            // Away for a while, then there with a new origin.
            Fault::DriverRestart if begins => self.publisher += 10,
            Fault::DriverRestart if since_s < 0.0 || !is_wrong => {}
            Fault::DriverRestart => self.world_from_odom = self.world_from_base,
            _ => {}
        }
        let is_away = is_wrong && matches!(self.fault, Fault::Silence | Fault::DriverRestart);
        if is_away {
            return;
        }
        let has_odometry = match self.fault {
            Fault::NoOdometry => false,
            Fault::OdometryEnds => !is_wrong,
            _ => true,
        };
        let ahead_s = if let Fault::Clock(ahead_s) = self.fault { ahead_s } else { 0.0 };
        let stamp = Stamp::from_seconds(BEGIN_S + now_s + ahead_s);
        if has_odometry && step % 5 == 2 {
            let bytes = self.odometry(stamp, trial.is_odometry_topic);
            self.send(trial, now_s, is_wrong, false, bytes);
        }
        if step % 10 == 0 {
            let hangs = self.fault == Fault::LidarHangs && is_wrong;
            let moment = if hangs { 0.0 } else { now_s };
            let ranges = (0..4).map(|beam| (1.5 + (moment * 1.7 + f64::from(beam)).sin()) as f32).collect();
            let scan = LaserScan {
                stamp,
                frame_id: self.frame("base_scan"),
                angle_min: -0.5,
                angle_increment: 0.5,
                scan_time: 0.1,
                range_min: 0.1,
                range_max: 3.5,
                ranges,
                ..LaserScan::default()
            };
            self.send(trial, now_s, is_wrong, true, payload(&scan));
        }
    }

    fn odometry(&self, stamp: Stamp, is_topic: bool) -> Vec<u8> {
        let pose = self.world_from_odom.between(self.world_from_base);
        let rotation = [0.0, 0.0, (0.5 * pose.yaw_rad).sin(), (0.5 * pose.yaw_rad).cos()];
        if is_topic {
            let position = [pose.x_m, pose.y_m, 0.0];
            return payload(&ros_messages::Odometry {
                stamp,
                frame_id: self.frame("odom"),
                child_frame_id: self.frame("base_link"),
                position,
                orientation: rotation,
                ..Default::default()
            });
        }
        let mut transform = edge(&self.frame("odom"), &self.frame("base_link"), stamp.0, pose.x_m, rotation);
        transform.translation[1] = pose.y_m;
        payload(&TfMessage { transforms: vec![transform] })
    }

    /// Puts a message on its way. The network keeps the order.
    fn send(&mut self, trial: &Trial, now_s: f64, is_wrong: bool, is_scan: bool, bytes: Vec<u8>) {
        let delay_s = trial.delays_s[self.messages % trial.delays_s.len()];
        self.messages += 1;
        let stalled_s = match self.fault {
            // It lasts once, from the beginning of the fault.
            Fault::Stall(stall_s) if is_wrong => FAULT_S + stall_s - now_s,
            _ => 0.0,
        };
        self.newest_arrival_s = (now_s + delay_s.max(stalled_s)).max(self.newest_arrival_s);
        self.on_way.push((self.newest_arrival_s, self.sender(), is_scan, bytes));
    }

    /// Lets arrive what has arrived.
    fn arrive(
        &mut self,
        trial: &Trial,
        now_s: f64,
        world: &mut ExternalWorld,
        clock: &mut SourceClock,
        outcome: &mut Outcome,
    ) {
        let arrived = self.on_way.iter().take_while(|(at_s, ..)| *at_s <= now_s).count();
        for (_, sender, is_scan, bytes) in self.on_way.drain(..arrived) {
            let id = RobotId::new(self.number).unwrap();
            let from = Reader::new(&bytes).unwrap();
            let message = match (is_scan, trial.is_odometry_topic) {
                (true, _) => Incoming::Scan(id, from),
                (false, true) => Incoming::Odometry(id, from),
                (false, false) => Incoming::Transforms(from),
            };
            let result = world.receive(sender, clock, message, Stamp::from_seconds(BEGIN_S + now_s));
            match result {
                Ok(()) if is_scan => outcome.accepted[self.number - 1].push(now_s),
                Ok(()) => {}
                Err(why) => outcome.refused[self.number - 1].push((now_s, why.to_string())),
            }
        }
    }
}

fn run(trial: &Trial) -> Outcome {
    let mut world = ExternalWorld::new(2, |_| {});
    let mut clock = exact();
    let mut drivers = [Driver::new(1, trial.fault), Driver::new(2, Fault::None)];
    let mut outcome = Outcome::default();
    for driver in &drivers {
        let mount =
            edge(&driver.frame("base_link"), &driver.frame("base_scan"), 0, 0.0, [0.0, 0.0, 0.0, 1.0]);
        let bytes = payload(&TfMessage { transforms: vec![mount] });
        let message = Incoming::StaticTransforms(None, Reader::new(&bytes).unwrap());
        world.receive(driver.sender(), &mut clock, message, Stamp::from_seconds(BEGIN_S)).unwrap();
    }
    for step in 0..(TRIAL_S / (STEP_NS as f64 * 1e-9)) as i64 {
        let now_s = (step * STEP_NS) as f64 * 1e-9;
        for driver in &mut drivers {
            driver.step(trial, now_s, step);
            driver.arrive(trial, now_s, &mut world, &mut clock, &mut outcome);
        }
        // Where the LiDARs are is told in each run.
        let notices = std::iter::from_fn(|| world.take_notice());
        outcome.notices.extend(notices.filter(|notice| !notice.contains("put the LiDAR")));
    }
    outcome.lost = drivers[0].lost;
    outcome
}

/// Less than this may be motion between two poses, metres and radians.
const VISIBLE_M: f64 = 0.6;
const VISIBLE_RAD: f64 = 0.9;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn each_fault_of_a_driver_is_told_of_its_robot_alone(trial in trials()) {
        let Outcome { notices, refused, accepted, lost } = run(&trial);
        let mut texts = expected(trial.fault);
        let is_visible = lost.x_m.hypot(lost.y_m) > VISIBLE_M || lost.yaw_rad.abs() > VISIBLE_RAD;
        if trial.fault == Fault::OdometryReset && !is_visible && notices.is_empty() {
            texts = &[];
        }
        prop_assert_eq!(notices.len(), texts.len(), "{:?}", notices);
        for (notice, text) in notices.iter().zip(texts) {
            prop_assert!(notice.starts_with("robot1: ") && notice.contains(text), "{notice}");
        }
        prop_assert!(refused[1].is_empty(), "{:?}", refused[1]);
        let is_in_fault = |at_s: f64| (FAULT_S..FAULT_S + trial.lasts_s + 1.0).contains(&at_s);
        if trial.fault == Fault::LidarHangs {
            let [refused, _] = &refused;
            prop_assert!(!refused.is_empty());
            prop_assert!(refused.iter().all(|(at_s, why)| is_in_fault(*at_s) && why.contains("robot1: its scans repeat")), "{refused:?}");
        } else {
            prop_assert!(refused[0].is_empty(), "{:?}", &refused[0]);
        }
        prop_assert!(accepted[0].last() > Some(&(TRIAL_S - 1.0)), "the robot's scans count again");
    }
}
