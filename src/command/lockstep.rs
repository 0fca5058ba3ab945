//! Tool `mr-slam lockstep`, which runs a fleet on virtual time.

mod exploration;

use self::exploration::{ExplorationOutcome, WatchedExploration};
use super::exit_code::UsageError;
use super::fleet_args::FleetArgs;
use super::{Error, output};
use crate::config::FleetConfig;
use crate::config::room::{self, RecordedRoom};
use crate::lockstep::Lockstep;
use crate::lockstep::faults::FaultPlan;
use crate::lockstep::invariants::{Checker, quiet_from};
use crate::lockstep::queues::MemoryPorts;
use crate::process::record::{self, Recording};
use crate::run::{keep_earlier_results, lock_folder};
use crate::runtime_folder::Lock;
use crate::session_file;
use crate::sessions;
use crate::stop::Stop;
use crate::world;
use formats::map_file::written_files;
use formats::overwriting::replaced_input;
use msg::{ROBOTS_MAX, RobotId};
use reports::{FleetView, Style};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Run a fleet in one process on virtual time
#[derive(Clone, Debug, clap::Args)]
pub struct LockstepArgs {
    /// Options that describe the fleet.
    #[command(flatten)]
    pub fleet: FleetArgs,
    /// Duration of the run in virtual time, seconds; an exploration ends it
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    pub seconds: u32,
    /// Drive the robots one after the other, as one operator would, and not all at once
    #[arg(long)]
    pub in_turn: bool,
    /// Folder for the maps, and the robots' sessions
    #[arg(long, value_name = "DIR")]
    pub run_dir: Option<PathBuf>,
    /// Record all messages into this file, as MCAP with ROS 2 messages; see `mr-slam replay`
    #[arg(long, value_name = "FILE", conflicts_with = "faults")]
    pub record: Option<PathBuf>,
    /// Draw faults from this seed, and check what must hold whatever goes wrong
    #[arg(long, value_name = "SEED")]
    pub faults: Option<u64>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the fleet, and prints its figures and the hash of all its messages.
pub fn run(args: &LockstepArgs, stop: &Stop) -> Result<(), Error> {
    let config = simulated_config(args)?;
    let room_digest = room::sha256(&config.fleet.room)?;
    let _lock = args.run_dir.as_deref().map(lock_run_dir).transpose()?;
    let mut fleet = Lockstep::with_faults(&config, !args.in_turn, draw_faults(args))?;
    let mut checker = Checker::new(&config)?;
    let mut exploration = config.fleet.explore.then(|| WatchedExploration::new(config.fleet.robots));
    let mut hash = Sha256::new();
    let mut recording =
        args.record.as_ref().map(|path| begin_recording(path, &config, &fleet)).transpose()?;
    let begun = Instant::now();
    for second in 0..args.seconds {
        for _ in 0..100 {
            fleet.tick(&mut |channel, message| {
                hash.update(channel);
                hash.update(message);
                checker.receive(channel, message);
                exploration.iter_mut().for_each(|exploration| exploration.receive(channel, message));
            });
            checker.check_bounds(&fleet);
            recording.iter_mut().for_each(|recording| _ = recording.step());
        }
        exploration.iter_mut().for_each(WatchedExploration::end_second);
        note_progress(second + 1, args.seconds);
        if stop.requested() || exploration.as_ref().is_some_and(WatchedExploration::has_ended) {
            break;
        }
    }
    let hash = format!("{:x}", hash.finalize());
    let faster = fleet.now().seconds() / begun.elapsed().as_secs_f64().max(1e-9);
    let written = args.run_dir.as_ref().map_or(Ok(()), |dir| write_results(dir, &config, &mut fleet));
    let maps_hash = record::map_hash(fleet.maps());
    let recorded = recording.map(Recording::finish);
    let described =
        recorded.as_ref().map_or(Ok(()), |summary| record::describe_parts(&summary.bag, &summary.files));
    let exploration = exploration.map(WatchedExploration::outcome);
    let view = FleetView::new(fleet.stats()).on_virtual_time().with_edges(fleet.merge_edges());
    let view = view.without_given_transforms(config.fleet.starts_known);
    let report = serde_json::json!({
        "sha256": hash, "maps_sha256": maps_hash, "times_real_time": faster, "fleet": view, "recording": recorded,
        "exploration": exploration,
    });
    let text = || {
        format!(
            "{}{}{faster:.0} times real time; SHA-256 of all messages {hash}, of the maps {maps_hash}\n",
            view.table(&Style::PLAIN),
            exploration.as_ref().map_or_else(String::new, ExplorationOutcome::text),
        )
    };
    output::print_either(args.json, &report, text)?;
    // What could not be written or recorded is no reason to lose the figures.
    written?;
    check_room_stayed(&config, room_digest.as_deref())?;
    described?;
    if let Some(why) = recorded.and_then(|recorded| recorded.ended) {
        return Err(format!("the recording is not whole: {why}").into());
    }
    check_end(args, stop, checker, &fleet)
}

/// Returns why the run does not count: it was interrupted, or something did not hold.
fn check_end(args: &LockstepArgs, stop: &Stop, checker: Checker, fleet: &Lockstep) -> Result<(), Error> {
    if stop.requested() {
        let seconds = fleet.now().seconds();
        return Err(
            format!("interrupted: the results are those of {seconds:.0} of {} s", args.seconds).into()
        );
    }
    let violations = if args.faults.is_some() { checker.finish(fleet) } else { Vec::new() };
    if violations.is_empty() {
        Ok(())
    } else {
        Err(format!("did not hold: {}", violations.join("; ")).into())
    }
}

/// Says every ten seconds of the run how far it is.
fn note_progress(done_s: u32, of_s: u32) {
    if done_s.is_multiple_of(10) {
        output::note(&format!("{done_s} of {of_s} s"));
    }
}

/// Refuses results that are of two rooms: the room's files changed while the run read them.
fn check_room_stayed(config: &FleetConfig, digest: Option<&str>) -> Result<(), Error> {
    let room = &config.fleet.room;
    match RecordedRoom::compare(room, digest) {
        RecordedRoom::Changed => {
            Err(format!("room {room}: its files changed during the run: the results may be of two rooms")
                .into())
        }
        _ => Ok(()),
    }
}

/// Draws the faults of the run, and prints them.
fn draw_faults(args: &LockstepArgs) -> FaultPlan {
    let Some(seed) = args.faults else { return FaultPlan::none() };
    let faults = FaultPlan::draw(seed, quiet_from(args.seconds));
    output::note(&faults.to_string());
    faults
}

/// Returns the configuration of the fleet; an error if its robots are not simulated, or a result would replace its room.
fn simulated_config(args: &LockstepArgs) -> Result<FleetConfig, Error> {
    let config = args.fleet.config()?;
    if config.world.is_external() {
        let why = "lockstep simulates its own world; expected world = \"simulator\"";
        return Err(UsageError(why.into()).into());
    }
    check_room_stays(args, &config)?;
    Ok(config)
}

/// Refuses a folder whose results, which the run replaces, are the run's room.
fn check_room_stays(args: &LockstepArgs, config: &FleetConfig) -> Result<(), Error> {
    let Some(dir) = &args.run_dir else { return Ok(()) };
    let robots = RobotId::first(ROBOTS_MAX).map(|robot| format!("{robot}_map"));
    let maps = robots.chain(["merged_map".into()]).map(|name| dir.join(name));
    let results: Vec<_> = maps.flat_map(|stem| written_files(&stem)).collect();
    match replaced_input(&results, &room::files(&config.fleet.room)) {
        Some(path) => Err(UsageError(format!(
            "{}: is the room, and a result of the run would replace it; expected another --run-dir, or a copy of the map",
            path.display()
        ))
        .into()),
        None => Ok(()),
    }
}

/// Creates and locks the folder of the results, before the run: a folder that cannot be written, or in which a fleet runs, is
/// said at once.
fn lock_run_dir(dir: &Path) -> Result<Lock, Error> {
    formats::folder::create(dir)?;
    Ok(lock_folder(dir)?)
}

/// Writes the maps and the robots' sessions into a folder.
fn write_results(dir: &Path, config: &FleetConfig, fleet: &mut Lockstep) -> Result<(), Error> {
    keep_earlier_results(dir)?;
    fleet.write_maps(|name| dir.join(name))?;
    let folder = dir.join(sessions::FOLDER);
    let begin_with = config.sessions.folder();
    sessions::create_folder(&folder, fleet.known_starts(), begin_with, world::has_own_frame(config))?;
    for (robot, session) in fleet.sessions() {
        session_file::write(&sessions::file(&folder, robot), &session)?;
    }
    Ok(())
}

/// Begins to record all messages of a fleet into a new file.
fn begin_recording(
    path: &Path,
    config: &FleetConfig,
    fleet: &Lockstep,
) -> Result<Recording<MemoryPorts>, Error> {
    fleet.record(record::new_files(path, &config.recording)?)
}
