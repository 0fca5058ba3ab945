//! Robots that drive to goals in the test world.

mod fleet;
mod place_search;
mod waypoints;
mod zones;

use super::*;
use crate::observation::{BURGER_BASE_FROM_SCAN, MapView, RobotObservation, ScanView};
use crate::test_world::{RANGE_MAX_M, RANGE_MIN_M, STEP_S, TestWorld, beam_angle_rad};
use msg::pose::wrap_angle;
use msg::{ExclusionZone, Pose2};

fn id(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

/// A world with a navigator, whose robots know the map and, but for a settable correction, their poses.
pub(super) struct Drive {
    pub(super) world: TestWorld,
    pub(super) navigator: FleetNavigator,
    pub(super) steps: u64,
    pub(super) map_from_world: Pose2,
    /// Pose of the map as drawn, seen from where it should be.
    pub(super) map_error: Pose2,
    pub(super) in_merged_map: bool,
    /// Whether the robots know where they are.
    pub(super) knows_poses: bool,
    pub(super) zones: Vec<ExclusionZone>,
    /// Index of a robot that is dead: its poses and scans are those of that moment.
    pub(super) dead: Option<(usize, Stamp)>,
}

impl Drive {
    pub(super) fn new(world: TestWorld) -> Self {
        Self {
            world,
            navigator: FleetNavigator::new(NavigatorConfig::default()),
            steps: 0,
            map_from_world: Pose2::IDENTITY,
            map_error: Pose2::IDENTITY,
            in_merged_map: true,
            knows_poses: true,
            zones: Vec::new(),
            dead: None,
        }
    }

    pub(super) fn now(&self) -> Stamp {
        Stamp::from_seconds(self.steps as f64 * STEP_S)
    }

    pub(super) fn go(&mut self, robot: usize, position_m: [f64; 2]) {
        let frame = if self.in_merged_map { GoalFrame::MergedMap } else { GoalFrame::RobotMap };
        let goal = NavigationGoal::position(frame, position_m).unwrap();
        self.navigator.set_goal(self.now(), id(robot), goal);
    }

    pub(super) fn state(&self, robot: usize) -> NavigationState {
        self.navigator.robots().find(|navigation| navigation.robot == id(robot)).unwrap().state
    }

    pub(super) fn step(&mut self) {
        if self.steps.is_multiple_of(2) {
            self.world.scan_and_map();
        }
        let now = self.now();
        let dead = self.dead;
        let died_at = |index: usize| dead.filter(|(robot, _)| *robot == index).map(|(_, at)| at);
        let mut map = self.world.known_map().clone();
        map.header.origin = self.map_from_world * self.map_error * map.header.origin;
        let view = MapView::from_log_odds(map.view());
        let robots: Vec<NavigatedRobot> = (0..self.world.robot_count())
            .map(|i| NavigatedRobot {
                observation: RobotObservation {
                    robot: id(i + 1),
                    map: view,
                    in_merged_map: self.in_merged_map,
                    map_from_base: self.knows_poses.then(|| self.map_from_world * self.world.pose(i)),
                    scan: Some(scan(&self.world, i, died_at(i).unwrap_or(now))),
                },
                // The frame of the wheels lies anywhere.
                odom_from_base: died_at(i).is_none().then(|| Pose2::new(1.0, -2.0, 0.7) * self.world.pose(i)),
                map_from_robot_map: None,
                uncertainty: None,
            })
            .collect();
        let input = NavigationInput { stamp: now, robots: &robots, exclusion_zones: &self.zones };
        self.navigator.step(&input);
        self.world.stop_all();
        let twists: Vec<_> = self.navigator.robots().map(|n| (n.robot, n.twist)).collect();
        for (robot, twist) in twists {
            self.world.set_velocity(robot, twist.unwrap_or(Twist::STOP));
        }
        self.world.move_robots();
        self.steps += 1;
    }

    /// Steps until a condition holds; returns after how many seconds, or `None` if it never did.
    pub(super) fn run_until(&mut self, seconds: f64, is_done: impl Fn(&Self) -> bool) -> Option<f64> {
        let start = self.steps;
        for _ in 0..(seconds / STEP_S) as u64 {
            self.step();
            if is_done(self) {
                return Some((self.steps - start) as f64 * STEP_S);
            }
        }
        None
    }
}

fn scan(world: &TestWorld, i: usize, now: Stamp) -> ScanView<'_> {
    ScanView {
        received: now,
        base_from_scan: BURGER_BASE_FROM_SCAN,
        angle_min_rad: beam_angle_rad(0),
        angle_increment_rad: beam_angle_rad(1) - beam_angle_rad(0),
        range_min_m: RANGE_MIN_M,
        range_max_m: RANGE_MAX_M,
        ranges_m: world.ranges_m(i),
    }
}

fn distance_m(world: &TestWorld, robot: usize, to: [f64; 2]) -> f64 {
    let pose = world.pose(robot - 1);
    crate::geometry::distance_m([pose.x_m, pose.y_m], to)
}

#[test]
fn a_robot_reaches_goals_all_over_the_room_and_touches_nothing() {
    for (seed, goal) in [(0, [5.2, 7.2]), (1, [0.5, 0.6]), (2, [1.7, 2.8]), (3, [5.0, 3.5])] {
        let mut drive = Drive::new(TestWorld::new(1, seed));
        drive.go(1, goal);
        let done = drive.run_until(120.0, |drive| !drive.state(1).is_active());
        assert_eq!(drive.state(1), NavigationState::Reached, "seed {seed} after {done:?} s");
        let away_m = distance_m(&drive.world, 1, goal);
        assert!(away_m < 0.16, "seed {seed}: at {:?}", drive.world.pose(0));
        let said_m = drive.navigator.robots().next().unwrap().remaining_m.unwrap();
        assert!((said_m - away_m).abs() < 0.02, "seed {seed}: {said_m} m from the goal, in truth {away_m} m");
        assert_eq!(drive.world.bumps(), 0, "seed {seed}");
        assert!(!drive.navigator.is_active());
        let twist = drive.navigator.robots().next().unwrap().twist;
        assert_eq!(twist, Some(Twist::STOP), "the last command stops the robot");
        drive.step();
        assert_eq!(drive.navigator.robots().next().unwrap().twist, None, "then it is free for others");
    }
}

#[test]
fn the_heading_of_a_goal_is_turned_to_and_waypoints_are_passed_in_order() {
    let mut drive = Drive::new(TestWorld::new(1, 0));
    let pose = |x, y, yaw_rad| GoalPose { position_m: [x, y], yaw_rad };
    let poses = vec![pose(2.6, 1.8, None), pose(0.6, 1.8, Some(-2.0))];
    let goal = NavigationGoal::new(GoalFrame::MergedMap, poses).unwrap();
    drive.navigator.set_goal(Stamp(0), id(1), goal);
    let first = |drive: &Drive| drive.navigator.robots().next().unwrap().next_pose == Some(1);
    drive.run_until(60.0, first).expect("the first waypoint is passed");
    assert!(distance_m(&drive.world, 1, [2.6, 1.8]) < 0.2);
    drive.run_until(60.0, |drive| !drive.state(1).is_active());
    assert_eq!(drive.state(1), NavigationState::Reached);
    let pose = drive.world.pose(0);
    assert!((pose.yaw_rad + 2.0).abs() < 0.15 && distance_m(&drive.world, 1, [0.6, 1.8]) < 0.2, "{pose:?}");
}

#[test]
fn headings_at_one_place_are_turned_through_in_their_order() {
    let mut drive = Drive::new(TestWorld::new(1, 0));
    let yaws_rad = [0.0, 1.5, 3.0, -1.8];
    let pose = |yaw_rad| GoalPose { position_m: [2.6, 1.8], yaw_rad: Some(yaw_rad) };
    let goal = NavigationGoal::new(GoalFrame::MergedMap, yaws_rad.map(pose).to_vec()).unwrap();
    drive.navigator.set_goal(Stamp(0), id(1), goal);
    drive.run_until(60.0, |drive| drive.navigator.robots().next().unwrap().next_pose == Some(1));
    let (mut last_rad, mut turned_rad) = (drive.world.pose(0).yaw_rad, 0.0);
    while drive.state(1).is_active() && drive.steps < 1200 {
        drive.step();
        let yaw_rad = drive.world.pose(0).yaw_rad;
        turned_rad += wrap_angle(yaw_rad - last_rad);
        last_rad = yaw_rad;
    }
    assert_eq!(drive.state(1), NavigationState::Reached);
    assert!((last_rad + 1.8).abs() < 0.15, "{last_rad}");
    // The short way from the first to the last heading is the other way round.
    assert!((4.0..5.0).contains(&turned_rad), "{turned_rad}");
}

#[test]
fn goals_that_cannot_be_reached_fail_and_say_why() {
    use NavigationFailure::{GoalOccupied, GoalOutsideMap, GoalUnreachable};
    // A wall, beyond the walls' thickness of known space, and outside the map.
    for (goal, failure) in
        [([3.0, 4.5], GoalOccupied), ([3.0, -0.3], GoalUnreachable), ([90.0, 0.0], GoalOutsideMap)]
    {
        let mut drive = Drive::new(TestWorld::new(1, 0));
        drive.go(1, goal);
        drive.run_until(40.0, |drive| !drive.state(1).is_active()).expect("it gives up");
        assert_eq!(drive.state(1), NavigationState::Failed(failure));
        assert!(drive.world.pose(0).distance_m(TestWorld::new(1, 0).pose(0)) < 0.01, "it did not move");
    }
}

#[test]
fn a_zone_is_driven_around() {
    let mut drive = Drive::new(TestWorld::new(1, 0));
    let zone = [[0.2, 1.0], [1.1, 1.0], [1.1, 1.6], [0.2, 1.6]];
    drive.zones = vec![ExclusionZone::new(&zone).unwrap()];
    drive.go(1, [0.6, 2.0]);
    let mut entered = false;
    while drive.state(1).is_active() && drive.steps < 1200 {
        drive.step();
        let pose = drive.world.pose(0);
        entered |= (0.2..1.1).contains(&pose.x_m) && (1.0..1.6).contains(&pose.y_m);
    }
    assert_eq!(drive.state(1), NavigationState::Reached);
    assert!(!entered);
}

#[test]
fn a_map_that_moves_makes_no_robot_jump_or_circle() {
    for moved in [Pose2::new(0.5, -0.3, 0.2), Pose2::new(-2.0, 1.0, 2.5)] {
        let straight = driven(None);
        let corrected = driven(Some(moved));
        assert!(corrected.0 < straight.0 + 0.4, "{} m instead of {} m", corrected.0, straight.0);
        assert!(corrected.1 < straight.1 + 1.0, "{} rad instead of {} rad", corrected.1, straight.1);
    }
}

/// Length and turns of a drive on which the map moves under the robot, and the goal with it.
fn driven(moved: Option<Pose2>) -> (f64, f64) {
    let mut drive = Drive::new(TestWorld::new(1, 0));
    let goal = [3.0, 3.9];
    drive.go(1, goal);
    let (mut metres, mut turned_rad, mut last) = (0.0, 0.0, drive.world.pose(0));
    while drive.state(1).is_active() && drive.steps < 2400 {
        if drive.steps == 200
            && let Some(moved) = moved
        {
            drive.map_from_world = moved;
            drive.go(1, moved.apply(goal));
        }
        drive.step();
        let pose = drive.world.pose(0);
        metres += last.distance_m(pose);
        turned_rad += msg::pose::wrap_angle(pose.yaw_rad - last.yaw_rad).abs();
        last = pose;
    }
    assert_eq!(drive.state(1), NavigationState::Reached);
    assert_eq!(drive.world.bumps(), 0);
    (metres, turned_rad)
}

#[test]
fn a_paused_robot_stands_until_it_is_resumed() {
    let mut drive = Drive::new(TestWorld::new(1, 0));
    drive.go(1, [0.6, 2.0]);
    drive.run_until(3.0, |_| false);
    drive.navigator.pause(id(1));
    drive.step();
    assert_eq!(drive.navigator.robots().next().unwrap().twist, Some(Twist::STOP));
    let at = drive.world.pose(0);
    drive.run_until(60.0, |_| false);
    assert_eq!((drive.state(1), drive.world.pose(0)), (NavigationState::Paused, at));
    drive.navigator.resume(drive.now(), id(1));
    drive.run_until(60.0, |drive| !drive.state(1).is_active());
    assert_eq!(drive.state(1), NavigationState::Reached);
}

#[test]
fn a_robot_without_scan_or_pose_stands() {
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let goal = NavigationGoal::position(GoalFrame::MergedMap, [1.0, 1.0]).unwrap();
    navigator.set_goal(Stamp(0), id(1), goal.clone());
    let robots = [NavigatedRobot::unknown(id(1))];
    navigator.step(&NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] });
    let state = navigator.robots().next().unwrap().state;
    assert_eq!(state, NavigationState::Blocked(NavigationFailure::NoScan));
    navigator.step(&NavigationInput { stamp: Stamp::from_seconds(26.0), robots: &[], exclusion_zones: &[] });
    let navigation = navigator.robots().next().unwrap();
    assert_eq!(navigation.state, NavigationState::Failed(NavigationFailure::NoScan));
    assert_eq!(navigation.twist, Some(Twist::STOP));
}

#[test]
fn goals_are_checked() {
    let position = |position_m| NavigationGoal::position(GoalFrame::MergedMap, position_m);
    assert_eq!(position([f64::NAN, 0.0]), Err(GoalError::NotFinite(0)));
    assert_eq!(NavigationGoal::new(GoalFrame::MergedMap, Vec::new()), Err(GoalError::Empty));
    let poses = vec![GoalPose { position_m: [0.0, 0.0], yaw_rad: None }; 65];
    assert_eq!(NavigationGoal::new(GoalFrame::MergedMap, poses), Err(GoalError::TooManyPoses(65)));
}
