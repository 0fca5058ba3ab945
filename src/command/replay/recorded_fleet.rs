//! Replay of a fleet's own recording: the robots send what they sent, and SLAM, merging and figures run in lockstep.

use super::{ReplayArgs, ReplayError, log_files, player, serve};
use crate::command::output;
use crate::config::FleetConfig;
use crate::config::room::RecordedRoom;
use crate::lockstep::Lockstep;
use crate::process::record::description::{CONFIGURATION, EPOCH, ROOM_SHA256, STARTS};
use crate::process::record::{PLANAR_ODOMETRY, map_hash};
use crate::stop::Stop;
use formats::bag_folder::files_of;
use formats::map_file;
use msg::Scan;
use recording::fleet::{FleetRecording, SensorMessage};
use recording::{METADATA, RecordingReader, ScanGaps};
use reports::{FleetView, Style};
use ros_messages::RobotNames;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Returns the configuration of the fleet whose recording this is; `None` if it is one from elsewhere.
pub fn configuration(path: &Path) -> Result<Option<FleetConfig>, ReplayError> {
    let mut reader = open(&files_of(path)?[0])?;
    reader.next_message().map_err(|why| bag_error(path, why))?;
    let Some(text) = reader.metadata(METADATA).and_then(|metadata| metadata.get(CONFIGURATION)) else {
        return Ok(None);
    };
    let mut config = FleetConfig::from_text(path, text)?;
    config.recording.enabled = false;
    Ok(Some(config))
}

fn open(path: &Path) -> Result<RecordingReader<BufReader<File>>, ReplayError> {
    let file = File::open(path).map_err(|source| ReplayError::Read { path: path.to_owned(), source })?;
    Ok(RecordingReader::new(BufReader::new(file)))
}

fn bag_error(path: &Path, why: recording::ReadError) -> ReplayError {
    ReplayError::Bag { path: path.to_owned(), why: why.into() }
}

/// Replays the files of one recording, writes the requested maps and prints figures and the hash of the maps.
pub fn run(args: &ReplayArgs, config: &FleetConfig) -> Result<(), ReplayError> {
    let begun = Instant::now();
    let (mut recording, missing) = read(&args.logs, config)?;
    let (config, room) = with_recorded_room(&args.logs[0], config)?;
    recording.has_room = room.is_usable();
    let config = &with_known_starts(&config, &recording);
    let begins_s = recording.begins().seconds();
    let seconds = recording.ends().seconds() - begins_s;
    let figures = Figures {
        seconds,
        malformed: recording.malformed + recording.left_out,
        missing: &missing,
        room,
        times_real_time: None,
    };
    if args.serving.serve {
        let stop = Stop::on_signals().map_err(|why| ReplayError::Replay(why.to_string()))?;
        let mut player = serve::run(args, config, recording, &stop)?;
        let seconds = player.playback().position_s() - begins_s;
        return finish(args, player.fleet(), &Figures { seconds, ..figures });
    }
    let ticks = player::ticks(&recording);
    let failed = |why: Box<dyn std::error::Error>| ReplayError::Replay(why.to_string());
    let mut fleet = Lockstep::replay(config, recording).map_err(failed)?;
    for _ in ticks {
        fleet.tick(&mut |_, _| {});
    }
    let times_real_time = Some(seconds / begun.elapsed().as_secs_f64().max(1e-9));
    finish(args, &mut fleet, &Figures { times_real_time, ..figures })
}

/// Figures of a replay beside those of the fleet.
struct Figures<'a> {
    /// Time that was replayed, seconds.
    seconds: f64,
    /// Number of messages that could not be used.
    malformed: u64,
    /// What of the recording is missing.
    missing: &'a Missing,
    /// Whether the room's files are those of the recorded run.
    room: RecordedRoom,
    /// Speed of the replay; `None`: it was one for people.
    times_real_time: Option<f64>,
}

/// Writes the requested maps and prints figures and hash.
fn finish(args: &ReplayArgs, fleet: &mut Lockstep, figures: &Figures<'_>) -> Result<(), ReplayError> {
    let Figures { seconds, malformed, missing, room, times_real_time } = figures;
    let hash = map_hash(fleet.maps());
    if let Some(path) = &args.map {
        // The merged map under this name, and each robot's beside it.
        let stem = map_file::stem(path);
        let of_robot = |name: &str| {
            stem.with_file_name(format!("{}_{name}", stem.file_name().unwrap_or_default().display()))
        };
        fleet.write_maps(|name| if name == "merged_map" { stem.clone() } else { of_robot(name) })?;
    }
    let view = FleetView::new(fleet.stats()).on_virtual_time().with_edges(fleet.merge_edges());
    let summary = serde_json::json!({
        "maps_sha256": hash, "seconds": seconds, "malformed_messages": malformed, "damage": missing.damages,
        "not_read": missing.not_read, "gaps": missing.gaps,
        "times_real_time": times_real_time, "room": room, "fleet": view,
    });
    let text = || {
        let times = times_real_time.map_or(String::new(), |times| format!("{times:.0} times real time, "));
        format!(
            "{}{seconds:.1} s, {times}{malformed} malformed messages; SHA-256 of the maps {hash}\n",
            view.table(&Style::PLAIN),
        )
    };
    Ok(output::print_either(args.json, &summary, text)?)
}

/// Returns the configuration with the robots' starts of the recording, and whether the room's files are those of the recorded run;
/// says it where they are not.
///
/// # Errors
/// The recording cannot be read, or its room is not there and it does not say where the robots started.
fn with_recorded_room(path: &Path, config: &FleetConfig) -> Result<(FleetConfig, RecordedRoom), ReplayError> {
    let mut reader = open(&files_of(path)?[0])?;
    reader.next_message().map_err(|why| bag_error(path, why))?;
    let recorded = |key| reader.metadata(METADATA).and_then(|metadata| metadata.get(key));
    let mut config = config.clone();
    let room = RecordedRoom::compare(&config.fleet.room, recorded(ROOM_SHA256).map(String::as_str));
    room.note(&config.fleet.room).iter().for_each(|note| output::note(note));
    if config.fleet.starts.is_empty() {
        let starts = recorded(STARTS).and_then(|text| serde_json::from_str(text).ok());
        let is_known = starts.is_some_and(|starts| config.set_starts(starts));
        if !is_known && !room.is_usable() {
            return Err(ReplayError::Recording(
                "the recording does not say where the robots started; expected the room of the recorded run"
                    .into(),
            ));
        }
    }
    Ok((config, room))
}

/// Returns the configuration, without the robots' starts if the recording begins after them: each robot's map then begins where
/// the recording does, and nobody knows where that is.
fn with_known_starts(config: &FleetConfig, recording: &FleetRecording) -> FleetConfig {
    let mut config = config.clone();
    if config.fleet.starts_known && recording.begins_midway() {
        config.fleet.starts_known = false;
        output::note(
            "the recording begins when the robots have driven already: where their maps begin is unknown, so that maps are merged \
             by what they show, and `map` is one of them",
        );
    }
    config
}

/// Returns what says of which run a file is: when the run began, and its configuration.
fn run_of(reader: &RecordingReader<BufReader<File>>) -> [Option<String>; 2] {
    let metadata = reader.metadata(METADATA);
    [EPOCH, CONFIGURATION].map(|key| metadata.and_then(|metadata| metadata.get(key)).cloned())
}

/// What of a recording is missing.
struct Missing {
    /// What of the files is damaged.
    damages: Vec<String>,
    /// Files of its folder that are not read.
    not_read: Vec<String>,
    /// Pauses in the robots' scans, by the robot.
    gaps: BTreeMap<String, ScanGaps>,
}

/// Reads the files of one recording; returns it, and what of it is missing.
fn read(paths: &[PathBuf], config: &FleetConfig) -> Result<(FleetRecording, Missing), ReplayError> {
    let mut damages = Vec::new();
    let mut first: Option<[Option<String>; 2]> = None;
    let scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    let mut recording = FleetRecording::new(&config.robot_names(), PLANAR_ODOMETRY, scan);
    let files = paths.iter().map(|path| files_of(path)).collect::<Result<Vec<_>, _>>()?;
    let not_read = paths.iter().zip(&files).flat_map(|(path, files)| log_files::note_unlisted(path, files));
    let not_read = not_read.collect();
    let files = files.concat();
    for path in &files {
        let mut reader = open(path)?;
        while let Some(message) = reader.next_message().map_err(|why| bag_error(path, why))? {
            recording.add(&message);
        }
        let (run, path_of_first) = (run_of(&reader), paths[0].display());
        if *first.get_or_insert_with(|| run.clone()) != run {
            let path = path.display();
            return Err(ReplayError::Recording(format!(
                "{path} is of another run than {path_of_first}: expected the files of one recording"
            )));
        }
        if let Some(why) = reader.damage() {
            let damage = format!("{}: {why}", path.display());
            output::note(&damage);
            damages.push(damage);
        }
    }
    recording.sort();
    if recording.duplicates > 0 {
        let count = recording.duplicates;
        output::note(&format!("{count} messages of the robots are in several files; each is used once"));
    }
    recording.check_pauses().map_err(|why| ReplayError::Recording(why.to_string()))?;
    if !recording.has_scans() {
        return Err(ReplayError::Recording("the recording has no scans of the fleet's robots".into()));
    }
    let gaps = note_missing(&recording, &config.robot_names());
    Ok((recording, Missing { damages, not_read, gaps }))
}

/// Says which robots' scans pause, or come without odometry; returns the pauses.
fn note_missing(recording: &FleetRecording, names: &RobotNames) -> BTreeMap<String, ScanGaps> {
    let mut gaps_of_robots = BTreeMap::new();
    for (robot, of_robot) in names.robots().zip(&recording.robots) {
        let scans =
            || of_robot.messages.iter().filter(|(_, message)| matches!(message, SensorMessage::Scan(_)));
        let odometry = of_robot.messages.len() - scans().count();
        if scans().next().is_some() && odometry == 0 {
            output::note(&format!(
                "{robot}: the recording has its scans and no odometry of it: it is mapped by scans alone"
            ));
        }
        if let Some(at) = of_robot.unexplained_return() {
            output::note(&format!(
                "{robot}: its odometry is back where it began at {:.2} s, as after a restart of its driver, and the recording does not say \
                 so: from there on its map may be wrong",
                at.seconds()
            ));
        }
        if let Some(gaps) = ScanGaps::find(scans().map(|(at, _)| *at)) {
            output::note(&format!("{robot}: {gaps}"));
            gaps_of_robots.insert(robot.to_string(), gaps);
        }
    }
    gaps_of_robots
}
