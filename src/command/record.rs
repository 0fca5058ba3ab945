//! Tool `mr-slam record`, which records a running fleet.

use super::exit_code::UsageError;
use super::run_args::RunArgs;
use super::{Error, output};
use crate::channel::{Opener, Program};
use crate::process::record::{self, Summary, new_files, write_summary};
use crate::run::Run;
use crate::shared_memory::Participant;
use crate::stop::Stop;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Recordings of one second that get names of their own.
const NAMES_TRIED_MAX: u32 = 100;

/// Record a running fleet as MCAP with ROS 2 messages; the numbers of messages go to a .json beside it
#[derive(Clone, Debug, clap::Args)]
pub struct RecordArgs {
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
    /// File of the recording [default: TIME.mcap in recording/ below the run's folder]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Seconds until the recording ends [default: until Ctrl-C]
    #[arg(long, value_name = "S", value_parser = super::up::seconds)]
    pub seconds: Option<f64>,
    /// Size at which the next file begins, megabytes [default: the fleet's recording.split_mb]
    #[arg(long, value_name = "MB")]
    pub split_mb: Option<u64>,
    /// Print the numbers of messages as JSON
    #[arg(long)]
    pub json: bool,
}

/// Records the fleet and prints what was recorded.
pub fn run(args: &RecordArgs, stop: &Stop) -> Result<(), Error> {
    let mut run = args.run.open()?;
    run.config.recording.split_mb = args.split_mb.unwrap_or(run.config.recording.split_mb);
    run.config.recording.validate()?;
    let (path, summary_path) = match &args.out {
        Some(path) if !is_named_as_recording(path) => {
            return Err(UsageError(format!(
                "{}: expected a name that ends in .mcap, which `mr-slam replay` reads",
                path.display()
            ))
            .into());
        }
        Some(path) => reserve(path)?,
        None => reserve_name(&run.dir.join(record::FOLDER))?,
    };
    let recorded = record_to(&path, args, &run, stop);
    let summary = recorded.inspect_err(|_| {
        // Nothing was recorded: the name is free again.
        let _ = std::fs::remove_file(&summary_path);
    })?;
    write_summary(&summary_path, &summary)?;
    output::print_either(args.json, &summary, || summary_text(&summary))?;
    let described = record::describe_parts(&summary.bag, &summary.files);
    match summary.ended {
        Some(why) => Err(why.into()),
        None => Ok(described?),
    }
}

/// Records the fleet until it ends, or the recording is to end.
fn record_to(path: &Path, args: &RecordArgs, run: &Run, stop: &Stop) -> Result<Summary, Error> {
    let files = new_files(path, &run.config.recording)?;
    let name = format!("record {}", std::process::id());
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::RecordTool), &name)?;
    output::note(&format!("recording {} to {}", run.dir.display(), path.display()));
    let begun = Instant::now();
    let is_over = || {
        let elapsed = begun.elapsed().as_secs_f64();
        stop.requested() || args.seconds.is_some_and(|seconds| elapsed >= seconds) || !run.is_alive()
    };
    record::record(&node, run, files, stop, &is_over)
}

fn is_named_as_recording(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// Creates the file with the numbers of a recording at this path, so that no other recorder has it, and returns both paths.
fn reserve(path: &Path) -> Result<(PathBuf, PathBuf), Error> {
    let taken = |path: &Path| -> Error {
        UsageError(format!("{}: exists already; choose another name for the recording", path.display()))
            .into()
    };
    if let Some(folder) = path.parent().filter(|folder| *folder != Path::new("")) {
        formats::folder::create(folder)?;
    }
    let summary_path = path.with_extension("json");
    match File::create_new(&summary_path) {
        Ok(_) if path.exists() => {
            let _ = std::fs::remove_file(&summary_path);
            Err(taken(path))
        }
        Ok(_) => match write_summary(&summary_path, &Summary::begun(vec![path.to_owned()])) {
            Ok(()) => Ok((path.to_owned(), summary_path)),
            Err(why) => {
                let _ = std::fs::remove_file(&summary_path);
                Err(why.into())
            }
        },
        Err(why) if why.kind() == io::ErrorKind::AlreadyExists => Err(taken(&summary_path)),
        Err(why) => Err(format!("cannot write {}: {why}", summary_path.display()).into()),
    }
}

/// Reserves a path named by the time in a folder.
fn reserve_name(folder: &Path) -> Result<(PathBuf, PathBuf), Error> {
    let now = crate::run::folder_name_now();
    let named = |suffix: String| folder.join(format!("{now}{suffix}.mcap"));
    let is_free = |path: &PathBuf| !path.exists() && !path.with_extension("json").exists();
    let others = (2..NAMES_TRIED_MAX).map(|number| named(format!("-{number}")));
    let names = std::iter::once(named(String::new())).chain(others);
    // Another recorder may take a name meanwhile.
    let reserved = names.filter(is_free).find_map(|path| reserve(&path).ok());
    reserved.map_or_else(|| reserve(&named(String::new())), Ok)
}

/// Formats files and numbers of messages for a terminal.
fn summary_text(summary: &Summary) -> String {
    let mut text = String::new();
    for topic in summary.topics.iter().filter(|topic| topic.messages > 0) {
        text += &format!(
            "{:32} {:8} messages {:10.1} kB\n",
            topic.topic,
            topic.messages,
            topic.bytes as f64 / 1e3
        );
    }
    let number = |count: Option<u64>| count.map_or_else(|| "not known".into(), |count| count.to_string());
    text += &format!("messages dropped: {}, lost: {}\n", number(summary.dropped), number(summary.lost));
    for file in &summary.files {
        text += &format!("{}\n", file.display());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_recorders_and_no_file_that_is_there_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/a.mcap");
        let (recording, numbers) = reserve(&path).unwrap();
        assert_eq!((recording, numbers.is_file()), (path.clone(), true));
        // What a recorder leaves that is killed.
        let left: serde_json::Value = serde_json::from_slice(&std::fs::read(&numbers).unwrap()).unwrap();
        assert!(left["ended"].as_str().is_some_and(|why| why.contains("killed")), "{left}");
        assert_eq!(left["files"][0].as_str(), path.to_str());
        assert!(left["dropped"].is_null() && left["lost"].is_null(), "not counted: {left}");
        // Another recorder of this moment, before either has written anything.
        let why = reserve(&path).unwrap_err().to_string();
        assert!(why.contains("a.json: exists already"), "{why}");
        let other = folder.path().join("b.mcap");
        std::fs::write(&other, "a recording").unwrap();
        let why = reserve(&other).unwrap_err().to_string();
        assert!(why.contains("b.mcap: exists already") && !other.with_extension("json").exists(), "{why}");
        let names: Vec<PathBuf> = (0..3).map(|_| reserve_name(folder.path()).unwrap().0).collect();
        assert!(names[0] != names[1] && names[1] != names[2] && names[0] != names[2], "{names:?}");
    }
}
