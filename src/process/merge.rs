//! The fleet's map: the robots' maps in, one map and where each robot's map lies out. The joint graph that finds where
//! they lie, and straightens them, works beside it (`graph`).

use super::Error;
use super::graph::{self, Places, PlacesSlot};
use super::pulse::{Account, Pulse};
use crate::channel;
use crate::clock::now;
use crate::fleet;
use crate::run::Run;
use crate::shared_memory::{Bell, ChannelError, Gaps, MapReader, MapWriter, wait};
use crate::stop::Stop;
use ::merge::{Fleet, Merger};
use msg::{Monotonic, Pose2, RobotId, Role};
use std::sync::atomic::{AtomicBool, Ordering};

pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let starts = fleet::known_starts(&run.config)?;
    let (slot, done) = (PlacesSlot::default(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let joint = Fleet::new(&run.config.merge.align, &starts);
        let beside = scope.spawn(|| graph::run(run, joint, &slot, &done));
        let drawn = draw(run, &starts, &slot, &|| stop.requested() || beside.is_finished());
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
        run.robots().map(|robot| node.bell(&channel::map(robot))).collect::<Result<Vec<_>, _>>()?;
    bells.push(node.bell(&channel::merge_edges())?);
    let mut merged = node.map_writer(&channel::merged_map())?;
    let asks = merged.asks();
    let bells: Vec<&Bell> = bells.iter().chain([&*asks]).collect();
    let mut anchors = node.writer(&channel::anchors())?;
    let mut merger = Merger::new(&run.config.merge, starts);
    anchors.send(&merger.anchors());
    let mut refused = 0;
    let mut sending = false;
    while !over() {
        let soon = Monotonic(now().0 + MapWriter::PAUSE.as_nanos() as u64);
        wait(&bells, if sending { soon.min(pulse.due()) } else { pulse.due() });
        let mut changed = false;
        for (robot, reader) in &mut maps {
            if reader.look() {
                let taken = pulse.work(|| merger.update_tiles(*robot, reader.map())).is_ok();
                refused += u64::from(!taken);
                changed |= taken;
            }
        }
        if let Some(places) = slot.take() {
            refused += pulse.work(|| settle(&mut merger, &places));
            changed = true;
        }
        if changed {
            // The anchors do not ring; the merged map does, and finds them there.
            anchors.send(&merger.anchors());
            pulse.work(|| merger.compose());
        }
        sending = !merged.send(merger.merged_tiles());
        anchors.refresh();
        pulse.beat(|| Account { gaps: sum(&maps), refused, ..Account::default() });
    }
    Ok(())
}

/// Takes over what the joint graph says of every robot. How many maps could not be.
fn settle(merger: &mut Merger, places: &Places) -> u64 {
    let robots = RobotId::first(places.len()).zip(places);
    robots.map(|(robot, (place, map))| u64::from(merger.settle(robot, *place, map.as_ref()).is_err())).sum()
}

fn sum(maps: &[(RobotId, MapReader)]) -> Gaps {
    maps.iter().fold(Gaps::default(), |mut sum, (_, reader)| {
        sum.received += reader.gaps().received;
        sum.lost += reader.gaps().lost;
        sum
    })
}
