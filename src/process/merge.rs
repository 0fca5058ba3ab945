//! The fleet's map: the robots' maps in, one map and where each robot's map lies out.

use super::Error;
use super::pulse::{Account, Pulse};
use crate::channel;
use crate::fleet;
use crate::run::Run;
use crate::shared_memory::{Bell, ChannelError, Gaps, MapReader, wait};
use crate::stop::Stop;
use ::merge::Merger;
use msg::{RobotId, Role, TileMap};

pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let node = run.attach(Role::Merge, None)?;
    let mut pulse = Pulse::new(&node, run, Role::Merge, None)?;
    let mut maps = run
        .robots()
        .map(|robot| Ok((robot, node.map_reader(&channel::map(robot))?)))
        .collect::<Result<Vec<(RobotId, MapReader)>, ChannelError>>()?;
    let bells = run.robots().map(|robot| node.bell(&channel::map(robot))).collect::<Result<Vec<_>, _>>()?;
    let bells: Vec<&Bell> = bells.iter().collect();
    let mut merged = node.map_writer(&channel::merged_map())?;
    let mut anchors = node.writer(&channel::anchors())?;
    let mut merger = Merger::new(&run.config.merge, &fleet::known_starts(&run.config)?);
    let mut refused = 0;
    let mut fleet_map = TileMap::default();
    while !stop.requested() {
        wait(&bells, pulse.due());
        let mut changed = false;
        for (robot, reader) in &mut maps {
            if reader.look() {
                let taken = pulse.work(|| merger.update_tiles(*robot, reader.map())).is_ok();
                refused += u64::from(!taken);
                changed |= taken;
            }
        }
        if changed {
            // The anchors do not ring; the merged map does, and finds them there.
            anchors.send(&merger.anchors());
            fleet_map = pulse.work(|| merger.merged_tiles().clone());
        }
        merged.send(&fleet_map);
        anchors.refresh();
        pulse.beat(|| Account { gaps: sum(&maps), refused, ..Account::default() });
    }
    Ok(())
}

fn sum(maps: &[(RobotId, MapReader)]) -> Gaps {
    maps.iter().fold(Gaps::default(), |mut sum, (_, reader)| {
        sum.received += reader.gaps().received;
        sum.lost += reader.gaps().lost;
        sum
    })
}
