//! What a person stops stays stopped, whatever navigation has read by then: it hangs or dies in lockstep, around the moment at which
//! it gets something to do and at which a person interrupts that.

use bridge::ros;
use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::lockstep::client::Client;
use mr_slam::lockstep::faults::{Fault, FaultPlan};
use msg::{Monotonic, VelocityCommand};
use std::time::Duration;

/// Navigation's place among the processes of a fleet of one: sim, slam, merge, telemetry, bridge, nav.
const NAVIGATION: usize = 5;
/// When it hangs or dies.
const FAULT_S: f64 = 4.0;

/// What the robot gets to do.
#[derive(Clone, Copy, Debug)]
enum Task {
    Goal,
    Exploration,
}

/// How a person interrupts it.
#[derive(Clone, Copy, Debug)]
enum Interruption {
    EmergencyStop,
    Velocity,
    TakeControl,
}

struct Scene {
    fleet: Lockstep,
    client: Client,
    velocities: Vec<u8>,
}

impl Scene {
    fn new(faults: FaultPlan, explores: bool) -> Self {
        let mut config = FleetConfig::default();
        (config.fleet.robots, config.fleet.seed, config.fleet.explore) = (1, 1, explores);
        let fleet = Lockstep::with_navigation(&config, faults).unwrap();
        let mut client = fleet.client(([127, 0, 0, 1], 7).into());
        client.advertise::<ros::PoseStamped>("/robot1/goal_pose");
        client.advertise::<ros::Empty>("/robot1/cancel_navigation");
        client.advertise::<ros::Bool>("/explore/resume");
        client.advertise::<ros::Bool>("/emergency_stop");
        client.advertise::<ros::Empty>("/emergency_stop_release");
        client.advertise::<ros::Twist>("/robot1/cmd_vel");
        client.advertise::<ros::Int32>("/take_control");
        let mut scene = Self { fleet, client, velocities: Vec::new() };
        scene.run_until(2.0);
        scene.client.connect();
        scene
    }

    fn run_until(&mut self, seconds: f64) {
        while self.fleet.now().seconds() < seconds {
            let velocities = &mut self.velocities;
            self.fleet.tick(&mut |channel, bytes| {
                if channel == "robot1/command" {
                    velocities.extend_from_slice(bytes);
                }
            });
            self.client.receive(|_, _| {});
        }
    }

    fn give(&mut self, task: Task) {
        match task {
            Task::Goal => {
                let goal = ros::PoseStamped {
                    frame_id: "map_1".into(),
                    position: [1.0, 0.0, 0.0],
                    orientation: [0.0, 0.0, 0.0, 1.0],
                    ..Default::default()
                };
                self.client.publish("/robot1/goal_pose", &goal);
            }
            Task::Exploration => self.client.publish("/explore/resume", &ros::Bool(true)),
        }
    }

    fn interrupt(&mut self, by: Interruption) {
        match by {
            Interruption::EmergencyStop => {
                self.client.publish("/emergency_stop", &ros::Bool(true));
                let now = self.fleet.now().seconds();
                self.run_until(now + 0.1);
                self.client.publish("/emergency_stop_release", &ros::Empty);
            }
            Interruption::Velocity => {
                let twist = ros::Twist { linear: [0.0; 3], angular: [0.0, 0.0, 0.2] };
                self.client.publish("/robot1/cmd_vel", &twist);
            }
            Interruption::TakeControl => self.client.publish("/take_control", &ros::Int32(1)),
        }
    }

    /// Whether the robot is driven from now on until `seconds`.
    fn is_driven_until(&mut self, seconds: f64) -> bool {
        self.velocities.clear();
        self.run_until(seconds);
        self.velocities.chunks_exact(size_of::<VelocityCommand>()).any(|command| {
            let command: VelocityCommand = bytemuck::pod_read_unaligned(command);
            (command.linear_m_s, command.angular_rad_s) != (0.0, 0.0)
        })
    }
}

fn faults() -> [Option<Fault>; 3] {
    [None, Some(Fault::Freeze(NAVIGATION, Duration::from_millis(1500))), Some(Fault::Kill(NAVIGATION))]
}

#[test]
fn what_a_person_interrupts_does_not_go_on_by_itself() {
    for fault in faults() {
        for task in [Task::Goal, Task::Exploration] {
            for by in [Interruption::EmergencyStop, Interruption::Velocity, Interruption::TakeControl] {
                // Before and after the fault; the interruption comes before navigation is back.
                for (given_s, after_s) in [(3.5, 0.7), (3.95, 0.15), (4.02, 0.1), (4.3, 0.3)] {
                    let plan = fault.map_or(FaultPlan::none(), |fault| {
                        FaultPlan::none().with(Monotonic((FAULT_S * 1e9) as u64), fault)
                    });
                    let mut scene = Scene::new(plan, false);
                    scene.run_until(given_s);
                    scene.give(task);
                    scene.run_until(given_s + after_s);
                    scene.interrupt(by);
                    // The lease of a person who drives lasts for a second, a velocity for 0.3 s.
                    scene.run_until(given_s + after_s + 0.5);
                    let is_driven = scene.is_driven_until(9.0);
                    assert!(!is_driven, "{task:?} at {given_s} s, {by:?} {after_s} s later, {fault:?}");
                }
            }
        }
    }
}

#[test]
fn what_nobody_interrupts_goes_on_after_a_fault() {
    for fault in faults().into_iter().flatten() {
        for task in [Task::Goal, Task::Exploration] {
            let mut scene =
                Scene::new(FaultPlan::none().with(Monotonic((FAULT_S * 1e9) as u64), fault), false);
            scene.run_until(4.02);
            scene.give(task);
            assert!(scene.is_driven_until(9.0), "{task:?}, {fault:?}");
        }
    }
}

/// The state cannot be written while navigation is told what to do, and it dies: it does not know what was cancelled since.
#[test]
fn commands_of_before_are_not_carried_out_again_where_the_state_could_not_be_written() {
    let at = |seconds: f64| Monotonic((seconds * 1e9) as u64);
    for explores in [false, true] {
        let faults =
            FaultPlan::none().with_full_disk(at(2.2), at(30.0)).with(at(6.0), Fault::Kill(NAVIGATION));
        let mut scene = Scene::new(faults, explores);
        scene.run_until(2.5);
        if explores {
            scene.client.publish("/explore/resume", &ros::Bool(false));
        } else {
            scene.give(Task::Goal);
            scene.run_until(3.5);
            scene.client.publish("/robot1/cancel_navigation", &ros::Empty);
        }
        scene.run_until(4.5);
        assert!(!scene.is_driven_until(12.0), "explores: {explores}");
        // It works as ever afterwards.
        scene.give(Task::Goal);
        assert!(scene.is_driven_until(16.0), "explores: {explores}");
    }
}
