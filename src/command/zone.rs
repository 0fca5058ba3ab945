//! Tool `mr-slam zone`, which shows, adds and removes the exclusion zones of a running fleet.

use super::output;
use super::run_args::RunArgs;
use crate::channel::{self, Opener, Program};
use crate::ports::ChannelError;
use crate::run::{Run, RunError};
use crate::shared_memory::{Participant, wait};
use msg::{ExclusionZone, ExclusionZones, Monotonic, ZoneCommand, ZoneError, ZoneRefusal};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Longest time without an answer of the navigator: its start after a death takes less.
const PATIENCE: Duration = Duration::from_secs(10);
/// Period at which an answer is looked for, nanoseconds.
const POLL_NS: u64 = 20_000_000;

/// Show the areas that navigation keeps robots out of, add one or remove it
///
/// Navigation and exploration drive around a zone. A person who drives a robot by hand can enter it. A robot whose map is not
/// merged yet does not know where the zones lie.
#[derive(Clone, Debug, clap::Args)]
pub struct ZoneArgs {
    /// Change to make; without it, show the zones
    #[command(subcommand)]
    pub action: Option<ZoneChange>,
    /// Print the result as JSON
    #[arg(long, global = true)]
    pub json: bool,
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
}

/// Change of the zones.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum ZoneChange {
    /// Keep robots out of a polygon
    Add {
        /// Corners in order in the frame `map`, metres: 3 to 16, such as 1,0 2,0 2,3
        #[arg(value_name = "X,Y", value_parser = corner, required = true, num_args = 1..)]
        corners: Vec<Corner>,
    },
    /// Let robots into a zone again
    Remove {
        /// Number of the zone
        #[arg(value_name = "NUMBER")]
        number: u32,
    },
    /// Remove all zones
    Clear,
}

/// Corner of a zone in the frame `map`, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner([f64; 2]);

/// Text that is no corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected X,Y in metres")]
pub struct CornerError;

/// Parses a corner from `X,Y`.
fn corner(text: &str) -> Result<Corner, CornerError> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some([x_m, y_m]) => Ok(Corner([*x_m, *y_m])),
        _ => Err(CornerError),
    }
}

/// Reason why the zones were not shown or changed.
#[derive(Debug, thiserror::Error)]
pub enum ZoneToolError {
    /// No run, or several and none was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Shared memory of the run.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The corners make no zone.
    #[error(transparent)]
    Corners(#[from] ZoneError),
    /// The navigator did not carry it out.
    #[error("the zones are as before: {0}")]
    Refused(ZoneRefusal),
    /// The navigator did not answer.
    #[error("run {}: navigation does not answer within {} s; see `mr-slam status`", run.display(), PATIENCE.as_secs_f64())]
    Silent {
        /// Folder of the run.
        run: PathBuf,
    },
    /// The result cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// A zone as JSON.
#[derive(Serialize)]
struct ZoneView {
    number: u32,
    corners_m: Vec<[f64; 2]>,
    /// Label of the furniture that it stands for; `None`: a person or program added it.
    furniture: Option<String>,
}

/// Does what the arguments say.
pub fn run(args: &ZoneArgs) -> Result<(), ZoneToolError> {
    let run = if args.action.is_some() { args.run.open_to_change()? } else { args.run.open()? };
    let now = crate::clock::now().0;
    let command = match &args.action {
        None => None,
        Some(ZoneChange::Add { corners }) => {
            let corners_m: Vec<[f64; 2]> = corners.iter().map(|corner| corner.0).collect();
            Some(ZoneCommand::add(now, ExclusionZone::new(&corners_m)?))
        }
        Some(ZoneChange::Remove { number }) => Some(ZoneCommand::remove(now, *number)),
        Some(ZoneChange::Clear) => Some(ZoneCommand::clear(now)),
    };
    let (zones, refusal) = exchange(&run, command.as_ref())?;
    if let Some(refusal) = refusal {
        return Err(ZoneToolError::Refused(refusal));
    }
    let view = |zone: &ExclusionZone| ZoneView {
        number: zone.number,
        corners_m: zone.corners_m().to_vec(),
        furniture: Some(zone.source()).filter(|label| !label.is_empty()).map(str::to_owned),
    };
    let views: Vec<ZoneView> = zones.zones().iter().map(view).collect();
    output::print_either(args.json, &views, || table(&views))?;
    Ok(())
}

/// Sends the command, and returns the zones after it and why it was refused; without a command, the present ones.
fn exchange(
    run: &Run,
    command: Option<&ZoneCommand>,
) -> Result<(ExclusionZones, Option<ZoneRefusal>), ZoneToolError> {
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::ZoneTool), "zone")?;
    let mut states = node.reader(&channel::exclusion_zones())?;
    let mut commands = node.writer(&channel::zone_command())?;
    if let Some(command) = command {
        commands.send(command);
    }
    let begun = Instant::now();
    loop {
        if command.is_some() {
            // A navigator that starts again needs the command once more.
            commands.refresh();
        }
        if let Some(zones) = states.newest() {
            match command.map(|command| zones.answer(command.number)) {
                None => return Ok((*zones, None)),
                Some(Some(answer)) => return Ok((*zones, answer.refusal())),
                Some(None) => {}
            }
        }
        if begun.elapsed() > PATIENCE {
            return Err(ZoneToolError::Silent { run: run.dir.clone() });
        }
        wait([], Monotonic(crate::clock::now().0 + POLL_NS));
    }
}

/// The zones as text.
fn table(zones: &[ZoneView]) -> String {
    if zones.is_empty() {
        return "no exclusion zones\n".into();
    }
    let line = |zone: &ZoneView| {
        let corners: Vec<String> = zone.corners_m.iter().map(|[x, y]| format!("({x:.2}, {y:.2})")).collect();
        let source = zone.furniture.as_ref().map_or(String::new(), |label| format!(" ({label} of the room)"));
        format!("zone {}{source}: {}\n", zone.number, corners.join(" "))
    };
    zones.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_has_two_numbers() {
        assert_eq!(corner("1.5, -2"), Ok(Corner([1.5, -2.0])));
        for text in ["", "1", "1,2,3", "1,x"] {
            assert_eq!(corner(text), Err(CornerError), "{text}");
        }
    }
}
