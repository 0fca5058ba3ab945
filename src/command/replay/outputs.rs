//! Checks before a replay that its results can be written, and replace nothing that is read: mapping takes long.

use super::{ReplayArgs, ReplayError, Starts};
use crate::run::check_output;
use crate::session_file;
use formats::map_file;
use formats::overwriting::replaced_input;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Checks that the requested files can be written, and leaves no file behind.
pub fn check(args: &ReplayArgs) -> Result<(), ReplayError> {
    check_inputs_stay(args)?;
    for path in [&args.map, &args.trajectory, &args.save_session].into_iter().flatten() {
        check_output(path).map_err(Box::new)?;
    }
    let check =
        |path: &Path| check_file(path).map_err(|source| ReplayError::Write { path: path.to_owned(), source });
    if let Some(path) = &args.map {
        map_file::written_files(&map_file::stem(path)).iter().try_for_each(|file| check(file))?;
    }
    match &args.trajectory {
        // The folder is made with its parents.
        Some(folder) if args.merge.is_some() => {
            let is_there = |path: &&Path| path.exists() || path.as_os_str().is_empty();
            let above = folder.ancestors().find(is_there).unwrap_or(folder);
            check(&above.join("robot1.tum"))?;
        }
        Some(path) => check(path)?,
        None => {}
    }
    args.save_session.as_deref().map_or(Ok(()), check)
}

/// Refuses a result that would replace a file that the replay reads.
fn check_inputs_stay(args: &ReplayArgs) -> Result<(), ReplayError> {
    let mut inputs = args.logs.clone();
    inputs.extend(args.config.clone());
    if let Some(Starts::Known(file)) = &args.merge {
        inputs.push(file.clone());
    }
    match &args.session {
        // One that cannot be read is refused later, with its reason.
        Some(map) if session_file::is_map(map) => {
            inputs.extend(map_file::read_files(map).into_iter().flatten());
        }
        session => inputs.extend(session.clone()),
    }
    let mut outputs: Vec<PathBuf> = args.save_session.iter().cloned().collect();
    if let Some(map) = &args.map {
        outputs.extend(map_file::written_files(&map_file::stem(map)));
    }
    match &args.trajectory {
        Some(folder) if args.merge.is_some() => {
            let name = |robot| folder.join(format!("{robot}.tum"));
            outputs.extend(msg::RobotId::first(args.logs.len().min(msg::ROBOTS_MAX)).map(name));
        }
        file => outputs.extend(file.clone()),
    }
    replaced_input(&outputs, &inputs).map_or(Ok(()), |path| Err(ReplayError::Overwrites(path)))
}

fn check_file(path: &Path) -> std::io::Result<()> {
    if path.is_dir() {
        return Err(std::io::ErrorKind::IsADirectory.into());
    }
    // A device or a pipe, whose folder gets no file.
    if path.exists() && !path.is_file() {
        return Ok(());
    }
    let name = path.file_name().ok_or(std::io::ErrorKind::InvalidInput)?.to_string_lossy();
    let probe: PathBuf = path.with_file_name(format!(".{name}.{}.check", std::process::id()));
    File::create_new(&probe)?;
    std::fs::remove_file(&probe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_can_be_written_leaves_nothing_behind_and_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses.tum");
        check_file(&path).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        std::fs::write(&path, "old").unwrap();
        check_file(&path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(check_file(&folder.path().join("missing/poses.tum")).is_err());
        assert!(check_file(folder.path()).is_err());
    }
}
