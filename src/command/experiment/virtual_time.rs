//! A session on virtual time: the fleet in lockstep, and the link simulated on the same time.

use super::Experiment;
use super::room::{self, MERGED_MAP};
use crate::command::up::{Pictures, Report};
use crate::command::{Error, output};
use crate::config::{FleetConfig, RobotSource};
use crate::lockstep::Lockstep;
use crate::stop::Stop;
use msg::{MapTransforms, RobotId, VelocityCommand};
use reports::{FleetView, ScanRates, Series};
use sim::Simulator;
use std::collections::HashMap;
use std::path::Path;
use std::time::Duration;

/// Ticks of the simulators in a second.
const TICKS_PER_S: u32 = (1_000_000_000 / Simulator::TICK.as_nanos()) as u32;

/// What is seen of the messages of a fleet in lockstep.
#[derive(Default)]
struct Seen {
    /// Newest velocity of each robot, by the name of its channel.
    commands: HashMap<String, VelocityCommand>,
    map_transforms: Option<Box<MapTransforms>>,
}

impl Seen {
    fn receive(&mut self, channel: &str, message: &[u8]) {
        if channel.ends_with("/command") {
            if let Ok(command) = bytemuck::try_pod_read_unaligned::<VelocityCommand>(message) {
                self.commands.insert(channel.to_owned(), command);
            }
        } else if channel == "map_transforms" {
            self.map_transforms = bytemuck::try_pod_read_unaligned(message).ok().map(Box::new);
        }
    }

    fn command(&self, robot: usize, now_s: f64) -> Option<(VelocityCommand, f64)> {
        let command = *self.commands.get(&format!("{}/command", RobotId::new(robot + 1)?))?;
        Some((command, now_s - command.header.sent.0 as f64 * 1e-9))
    }
}

/// Runs a session on virtual time, with the operator of lockstep, who drives one robot after the other.
///
/// # Errors
/// The fleet cannot be built, or its report cannot be written.
pub fn run(
    experiment: &Experiment,
    config: &FleetConfig,
    folder: &Path,
    stop: &Stop,
) -> Result<Report, Error> {
    let seconds = experiment.args.seconds;
    let mut fleet = Lockstep::behind_link(config, experiment.link)?;
    let (mut seen, mut series, mut rates) = (Seen::default(), Series::default(), ScanRates::default());
    let mut view: Option<FleetView> = None;
    let robots_are_behind_link = config.world == RobotSource::Headset && !experiment.link.is_transparent();
    for second in 0..seconds {
        for _ in 0..TICKS_PER_S {
            fleet.tick(&mut |channel, message| seen.receive(channel, message));
        }
        let mut figures = FleetView::new(fleet.stats()).without_given_transforms(config.fleet.starts_known);
        rates.add(&figures);
        rates.fill(&mut figures);
        let now_s = fleet.now().seconds();
        series.add(&figures, |robot| seen.command(robot, now_s));
        // Virtual time itself has no jitter: without a link before the robots a figure of it would say nothing.
        if !robots_are_behind_link {
            figures = figures.on_virtual_time();
        }
        view = Some(figures);
        if second % 60 == 59 {
            output::note(&format!("{} of {seconds} s", second + 1));
        }
        if stop.requested() {
            break;
        }
    }
    if let Some(transforms) = &seen.map_transforms {
        series.set_map_transforms(transforms);
    }
    let mut pictures = Pictures::new(config);
    for (name, map) in fleet.maps() {
        pictures.add(name, map, &series);
        if let (Some(view), MERGED_MAP) = (&mut view, name) {
            room::compare(view, map, config)?;
        }
    }
    let elapsed = Duration::from_secs_f64(fleet.now().seconds());
    let report = Report { series, pictures, ..Report::of_figures(config, elapsed, view, None) };
    formats::folder::create(folder)?;
    report.write(folder)?;
    Ok(report)
}
