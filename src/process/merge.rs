//! The fleet's map: the robots' maps in, one map and where each robot's map lies out.

use super::Error;
use super::pulse::{Account, Pulse};
use crate::channel;
use crate::clock::now;
use crate::fleet;
use crate::run::Run;
use crate::shared_memory::{Bell, ChannelError, Gaps, MapReader, MapWriter, wait};
use crate::stop::Stop;
use ::merge::Merger;
use msg::{Monotonic, RobotId, Role};

pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let node = run.attach(Role::Merge, None)?;
    let mut pulse = Pulse::new(&node, run, Role::Merge, None)?;
    let mut maps = run
        .robots()
        .map(|robot| Ok((robot, node.map_reader(&channel::map(robot))?)))
        .collect::<Result<Vec<(RobotId, MapReader)>, ChannelError>>()?;
    let bells = run.robots().map(|robot| node.bell(&channel::map(robot))).collect::<Result<Vec<_>, _>>()?;
    let mut merged = node.map_writer(&channel::merged_map())?;
    let asks = merged.asks();
    let bells: Vec<&Bell> = bells.iter().chain([&*asks]).collect();
    let mut anchors = node.writer(&channel::anchors())?;
    let mut merger = Merger::new(&run.config.merge, &fleet::known_starts(&run.config)?);
    let mut refused = 0;
    let mut sending = false;
    while !stop.requested() {
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

fn sum(maps: &[(RobotId, MapReader)]) -> Gaps {
    maps.iter().fold(Gaps::default(), |mut sum, (_, reader)| {
        sum.received += reader.gaps().received;
        sum.lost += reader.gaps().lost;
        sum
    })
}
