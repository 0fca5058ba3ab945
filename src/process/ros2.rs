//! The ROS 2 door of the bridge process: a thread of its own, which the headset's door never waits for.

use super::Error;
use super::bridge::{Asker, fleet_tasks, forward, on_ring, stopped};
use crate::channel;
use crate::config::World;
use crate::fleet;
use crate::run::Run;
use crate::shared_memory::Participant;
use crate::stop::Stop;
use ::bridge::Bridge;
use ::bridge::dds::{Door, Heard};
use msg::{Clock, RobotId, Role};
use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::{JoinHandle, LocalSet, spawn_local};

/// Messages heard that wait for the bridge; more are dropped there.
const HEARD_MAX: usize = 256;
/// What tells this door's questions to SLAM from others'.
const ASKER_KIND: u64 = 2;
/// How often the headset is told the time where ROS has none of its own.
const CLOCK_PERIOD: Duration = Duration::from_millis(20);

/// Starts the thread, and hears what it hears.
pub fn open(run: &Run, stop: &Stop, bridge: &Rc<Bridge>) -> Result<JoinHandle<()>, Error> {
    let (hear, mut heard) = mpsc::channel::<Heard>(HEARD_MAX);
    let epoch = run.epoch;
    let outside = run.config.world == World::Ros;
    let (run, stop) = (run.clone(), stop.clone());
    std::thread::Builder::new().name("ros2".into()).spawn(move || {
        if let Err(why) = serve(&run, &stop, hear) {
            eprintln!("bridge: {why}; ROS 2 is not served");
        }
    })?;
    let bridge = bridge.clone();
    Ok(spawn_local(async move {
        // A simulator's time, such as Gazebo's, is on /clock; real robots go by the wall's.
        let has_clock = Cell::new(!outside);
        let hearing = async {
            while let Some(message) = heard.recv().await {
                has_clock.set(has_clock.get() || message.is_clock());
                bridge.hear_ros(&message);
            }
        };
        let telling = async {
            while !has_clock.get() {
                let mut clock = Clock::default();
                clock.header.stamp = fleet::stamp_now(epoch);
                bridge.clock(&clock);
                tokio::time::sleep(CLOCK_PERIOD).await;
            }
        };
        tokio::join!(hearing, telling);
    }))
}

fn serve(run: &Run, stop: &Stop, hear: mpsc::Sender<Heard>) -> Result<(), Error> {
    // A presence of its own: shared memory's ports stay on the thread that made them.
    let node = run.attach_thread(Role::Bridge, None, "ros2")?;
    let outside = run.config.world == World::Ros;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, async {
        let door = Rc::new(Door::open(&run.config.bridge, run.config.fleet.robots, outside)?);
        let mut tasks = fleet_tasks(&node, run, &door)?;
        let asker = Rc::new(RefCell::new(Asker::open(&node, run, ASKER_KIND)?));
        for robot in run.robots() {
            tasks.push(answers(&node, &door, &asker, robot)?);
            if outside {
                let pass = move |door: &Door, command: &msg::VelocityCommand| door.command(robot, command);
                tasks.push(forward(&node, &door, &channel::command(robot), pass)?);
            }
        }
        let hear = move |message| drop(hear.try_send(message));
        let ask = move |robot, request| asker.borrow_mut().ask(robot, request);
        tasks.push(spawn_local(door.serve(hear, ask)));
        stopped(stop.clone()).await;
        tasks.iter().for_each(JoinHandle::abort);
        Ok(())
    })
}

/// Passes a robot's answers to the door.
fn answers(
    node: &Participant,
    door: &Rc<Door>,
    asker: &Rc<RefCell<Asker>>,
    robot: RobotId,
) -> Result<JoinHandle<()>, Error> {
    let mut reader = node.reader(&channel::slam_response(robot))?;
    let (door, asker) = (door.clone(), asker.clone());
    on_ring(node.listener(&channel::slam_response(robot))?, move || {
        while let Some(answer) = reader.receive() {
            let ours = answer.client == asker.borrow().client;
            if let Some(next) = door.answered(robot, &answer, ours) {
                asker.borrow_mut().ask(robot, next);
            }
        }
    })
}
