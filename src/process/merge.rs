//! The fleet's map: the robots' maps in, one map and where each robot's map lies out. The joint graph that finds where
//! they lie, and straightens them, works beside it (`graph`).

use super::Error;
use super::graph::{self, Places, PlacesSlot};
use super::pulse::{Account, Pulse};
use crate::channel;
use crate::clock::now;
use crate::fleet;
use crate::merge_memory::MergeMemory;
use crate::ports::{ChannelError, Gaps, MAP_PAUSE, ReadMapPort, WriteMapPort};
use crate::run::Run;
use crate::shared_memory::{MapReader, Reader, wait};
use crate::stop::Stop;
use ::merge::{FleetPoseGraph, Merger};
use msg::{Correction, Monotonic, Pose2, RobotId, Role, TrackingState};
use std::sync::atomic::{AtomicBool, Ordering};

pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let starts = fleet::known_starts(&run.config)?;
    let (slot, done) = (PlacesSlot::default(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let mut joint = FleetPoseGraph::new(&run.config.merge.align, &starts);
        // What a process before this one knew: robots lie where they lay from the first map on.
        let memory = MergeMemory::recalled(run, &mut joint);
        let begun: Vec<_> = run.robots().map(|robot| joint.map_from_robot_map(robot)).collect();
        let beside = scope.spawn(|| graph::run(run, joint, memory, &slot, &done));
        let drawn = draw(run, &begun, &slot, &|| stop.requested() || beside.is_finished());
        done.store(true, Ordering::Relaxed);
        beside.join().map_err(|_| "the joint graph failed")??;
        drawn
    })
}

/// Draws the merged map, and never waits for anything else.
fn draw(
    run: &Run,
    starts: &[Option<Pose2>],
    slot: &PlacesSlot,
    over: &dyn Fn() -> bool,
) -> Result<(), Error> {
    let node = run.attach(Role::Merge, None)?;
    let mut pulse = Pulse::new(&node, run, Role::Merge, None)?;
    let mut maps = run
        .robots()
        .map(|robot| Ok((robot, node.map_reader(&channel::map(robot))?)))
        .collect::<Result<Vec<(RobotId, MapReader)>, ChannelError>>()?;
    let mut bells =
        run.robots().map(|robot| node.listener(&channel::map(robot))).collect::<Result<Vec<_>, _>>()?;
    bells.push(node.listener(&channel::merge_edges())?);
    let mut places = run
        .robots()
        .map(|robot| Ok((robot, node.reader(&channel::correction(robot))?)))
        .collect::<Result<Vec<(RobotId, Reader<Correction>)>, ChannelError>>()?;
    let mut merged = node.map_writer(&channel::merged_map())?;
    let mut map_transforms = node.writer(&channel::map_transforms())?;
    let mut merger = Merger::new(&run.config.merge, starts);
    map_transforms.send(&merger.map_transforms());
    let mut refused = 0;
    let mut sending = false;
    while !over() {
        let soon = Monotonic(now().0 + MAP_PAUSE.as_nanos() as u64);
        wait(
            bells.iter().chain([merged.requests()]),
            if sending { soon.min(pulse.due()) } else { pulse.due() },
        );
        let mut changed = false;
        for (robot, reader) in &mut maps {
            if reader.poll() {
                let taken = pulse.work(|| merger.update_tiles(*robot, reader.map())).is_ok();
                refused += u64::from(!taken);
                changed |= taken;
            }
        }
        for (robot, reader) in &mut places {
            changed |= stand(&mut merger, *robot, reader, run.config.slam.map.robot_radius_m);
        }
        if let Some(believed) = slot.take() {
            refused += pulse.work(|| settle(&mut merger, &believed));
            changed = true;
        }
        if changed {
            // The map_transforms do not ring; the merged map does, and finds them there.
            map_transforms.send(&merger.map_transforms());
            pulse.work(|| merger.compose());
        }
        sending = !merged.send(merger.merged_tiles());
        map_transforms.refresh();
        pulse.beat(|| Account { gaps: sum(&maps), refused, ..Account::default() });
    }
    Ok(())
}

/// Takes over what the joint graph says of every robot. How many maps could not be.
fn settle(merger: &mut Merger, places: &Places) -> u64 {
    let robots = RobotId::first(places.len()).zip(places);
    robots
        .map(|(robot, (place, map))| {
            u64::from(merger.apply_fleet_estimate(robot, *place, map.as_ref()).is_err())
        })
        .sum()
}

/// Where a robot has been since the last look: after the maps, so that what they show of it is not older. A robot that
/// is lost does not know. Nobody is woken for it: a peer's map is what shows a robot where it stands.
fn stand(merger: &mut Merger, robot: RobotId, reader: &mut Reader<Correction>, radius_m: f64) -> bool {
    let mut changed = false;
    while let Some(at) = reader.receive() {
        if at.state() != TrackingState::Lost {
            changed |= merger.set_robot_footprint(robot, at.map_from_base, radius_m);
        }
    }
    changed
}

fn sum(maps: &[(RobotId, MapReader)]) -> Gaps {
    maps.iter().fold(Gaps::default(), |mut sum, (_, reader)| {
        sum.received += reader.gaps().received;
        sum.lost += reader.gaps().lost;
        sum
    })
}
