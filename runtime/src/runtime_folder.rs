//! Folder of the user for the sockets and locks of running fleets, in which each fleet is found.
//!
//! A running fleet has a folder of its own in it: `lock`, which the launcher holds, `run-dir` with the path of the run's
//! folder, and what the processes need to talk to each other. Only this user can write there, so that nobody can put
//! files in its way or pretend to be a fleet. Folders that others own or may write to are ignored.

pub use crate::file_lock::Lock;
use std::fs::{self, DirBuilder};
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// Longest wait for another launcher that starts at the same time.
const START_WAIT_MAX: Duration = Duration::from_secs(2);
/// Pause between two attempts to be the only launcher that starts.
const START_PAUSE: Duration = Duration::from_millis(20);
/// Age after which a fleet's folder without a lock is a leftover: it is locked at once when it is made.
const UNLOCKED_AGE_MAX: Duration = Duration::from_secs(60);
/// Name of the file that a launcher holds locked.
const LOCK: &str = "lock";

/// Reason why a folder or file is not trusted.
#[derive(Debug, thiserror::Error)]
pub enum TrustError {
    /// It does not exist, or cannot be looked at.
    #[error("{path}: {why}")]
    Missing {
        /// Path of the folder or file.
        path: PathBuf,
        /// Error of the operating system.
        why: io::Error,
    },
    /// It is a symbolic link, or of another kind than expected.
    #[error("{path} is no {expected} (a symbolic link is not followed)")]
    Kind {
        /// Path of the folder or file.
        path: PathBuf,
        /// Expected kind, `folder` or `file`.
        expected: &'static str,
    },
    /// Another user owns it.
    #[error("{path} belongs to user {owner}, not to user {user}")]
    Owner {
        /// Path of the folder or file.
        path: PathBuf,
        /// Id of the owner.
        owner: u32,
        /// Id of this process's user.
        user: u32,
    },
    /// Other users may write to it, or read what must be private.
    #[error("{path} is open to other users (mode {mode:o}); expected: chmod {expected} {path}")]
    Mode {
        /// Path of the folder or file.
        path: PathBuf,
        /// Permission bits of the folder or file.
        mode: u32,
        /// Change of the permissions that makes it acceptable.
        expected: &'static str,
    },
}

/// Permissions that other users must not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Forbidden {
    /// Any: the folder or file is private.
    Everything,
    /// Writing by anybody but the owner.
    Writing,
    /// Writing by everybody. A user's own group may write, as the usual mask of some systems has it.
    WritingByAll,
}

impl Forbidden {
    fn bits_and_advice(self) -> (u32, &'static str) {
        match self {
            Self::Everything => (0o077, "go="),
            Self::Writing => (0o022, "go-w"),
            Self::WritingByAll => (0o002, "o-w"),
        }
    }
}

fn user() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// Checks that this user owns a folder, and that others cannot do what is forbidden.
pub fn check_folder(path: &Path, forbidden: Forbidden) -> Result<(), TrustError> {
    check(path, forbidden, "folder", fs::FileType::is_dir)
}

/// Checks that this user owns a file, and that others cannot do what is forbidden.
pub fn check_file(path: &Path, forbidden: Forbidden) -> Result<(), TrustError> {
    check(path, forbidden, "file", fs::FileType::is_file)
}

fn check(
    path: &Path,
    forbidden: Forbidden,
    expected: &'static str,
    is_expected: fn(&fs::FileType) -> bool,
) -> Result<(), TrustError> {
    let path = || path.to_path_buf();
    let about = fs::symlink_metadata(path()).map_err(|why| TrustError::Missing { path: path(), why })?;
    let (bits, advice) = forbidden.bits_and_advice();
    let mode = about.mode() & 0o7777;
    if !is_expected(&about.file_type()) {
        Err(TrustError::Kind { path: path(), expected })
    } else if about.uid() != user() {
        Err(TrustError::Owner { path: path(), owner: about.uid(), user: user() })
    } else if mode & bits != 0 {
        Err(TrustError::Mode { path: path(), mode, expected: advice })
    } else {
        Ok(())
    }
}

/// Places for the folder, best first. The folder of the session ends with the session; the others stay.
fn places(outlives_session: bool) -> Vec<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let of_session = [absolute("XDG_RUNTIME_DIR"), Some(format!("/run/user/{}", user()).into())];
    let of_session = of_session.into_iter().flatten().filter(|folder| is_trusted(folder));
    let of_session = of_session.map(|folder| folder.join("mr-slam"));
    let temporary = std::env::temp_dir().join(format!("mr-slam-{}", user()));
    let state = absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")));
    let state = state.map(|state| state.join("mr-slam/run"));
    let mut places: Vec<PathBuf> =
        of_session.filter(|_| !outlives_session).chain([temporary]).chain(state).collect();
    places.dedup();
    places
}

/// Returns whether a folder is this user's and private; says so if it is there and is not.
fn is_trusted(folder: &Path) -> bool {
    match check_folder(folder, Forbidden::Everything) {
        Ok(()) => true,
        Err(TrustError::Missing { .. }) => false,
        Err(why) => {
            tracing::warn!("{why}; the folder is ignored");
            false
        }
    }
}

/// Returns the folder for a new fleet; it is made if it does not exist. A fleet that `outlives_session` is not put into
/// the session's folder, which is removed at the end of the session.
fn home(outlives_session: bool) -> Result<PathBuf, TrustError> {
    let mut refused = None;
    for place in places(outlives_session) {
        if let Some(parent) = place.parent() {
            let _ = fs::create_dir_all(parent);
        }
        let made = DirBuilder::new().mode(0o700).create(&place);
        match (made, check_folder(&place, Forbidden::Everything)) {
            (_, Ok(())) => return Ok(place),
            (Err(why), Err(TrustError::Missing { path, .. })) => {
                refused = Some(TrustError::Missing { path, why });
            }
            (_, Err(why)) => {
                tracing::warn!("{why}; the folder is ignored");
                refused = Some(why);
            }
        }
    }
    let missing = || TrustError::Missing { path: std::env::temp_dir(), why: io::ErrorKind::NotFound.into() };
    Err(refused.unwrap_or_else(missing))
}

/// Place of a new fleet in the folder.
#[derive(Debug)]
pub struct FleetPlace {
    /// Name of the fleet, unique and not predictable.
    pub name: String,
    /// The fleet's own folder.
    pub root: PathBuf,
    /// Locks of a file in the folder and of the folder itself, held while the launcher lives.
    pub locks: [Lock; 2],
}

/// Makes the folder of a new fleet. `remove` is called before with the name and folder of each fleet whose launcher is
/// dead.
pub fn create_place(
    outlives_session: bool,
    mut remove: impl FnMut(&str, &Path),
) -> Result<FleetPlace, TrustError> {
    let home = home(outlives_session)?;
    let others = places(false).into_iter().filter(|place| *place != home && is_trusted(place));
    others.for_each(|place| remove_leftovers(&place, &mut remove));
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |why: io::Error| TrustError::Missing { path, why }
    };
    // Only one launcher makes or removes folders at a time. One that does not go on is not waited for.
    let begun = Instant::now();
    let mut turn = Lock::acquire(&home.join(LOCK)).map_err(failed(&home))?;
    while turn.is_none() && begun.elapsed() < START_WAIT_MAX {
        std::thread::sleep(START_PAUSE);
        turn = Lock::acquire(&home.join(LOCK)).map_err(failed(&home))?;
    }
    if turn.is_some() {
        leftovers(&home, remove);
    }
    let random = std::hash::RandomState::new().build_hasher().finish() as u32;
    let name = format!("{}_{random:08x}", std::process::id());
    let root = home.join(&name);
    DirBuilder::new().mode(0o700).create(&root).map_err(failed(&root))?;
    let held = |lock: io::Result<Option<Lock>>| {
        lock.and_then(|lock| lock.ok_or(io::ErrorKind::WouldBlock.into())).map_err(failed(&root))
    };
    let locks = [held(Lock::acquire(&root.join(LOCK)))?, held(Lock::acquire_folder(&root))?];
    Ok(FleetPlace { name, root, locks })
}

/// Calls `remove` for each fleet in a folder whose launcher is dead, unless another launcher makes or removes folders there now.
fn remove_leftovers(home: &Path, remove: &mut impl FnMut(&str, &Path)) {
    if let Ok(Some(_turn)) = Lock::acquire(&home.join(LOCK)) {
        leftovers(home, remove);
    }
}

/// Calls `remove` for each fleet in a folder whose launcher is dead.
fn leftovers(home: &Path, mut remove: impl FnMut(&str, &Path)) {
    for root in subfolders(home) {
        let Some(name) = root.file_name().and_then(|name| name.to_str()) else { continue };
        let lock = root.join(LOCK);
        let is_young = || {
            let age = fs::metadata(&root).and_then(|about| about.modified()).ok();
            age.and_then(|changed| SystemTime::now().duration_since(changed).ok())
                .is_none_or(|age| age < UNLOCKED_AGE_MAX)
        };
        let is_unlocked = if lock.exists() { !Lock::is_held(&lock) } else { !is_young() };
        let is_dead = is_unlocked && !Lock::is_held(&root);
        if is_dead {
            remove(name, &root);
        }
    }
}

/// Returns the private folders in a folder.
fn subfolders(home: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(home).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.filter(|path| check_folder(path, Forbidden::Everything).is_ok()).collect()
}

/// Returns whether the launcher of the fleet in this folder is known to live.
pub fn is_alive(root: &Path) -> bool {
    has_launcher(root).unwrap_or(false)
}

/// Returns whether the launcher of the fleet in this folder lives. A fleet that has ended has no folder, or one without a lock.
///
/// # Errors
/// The folder cannot be reached, or is not this user's alone: whether the fleet lives is not known.
pub fn has_launcher(root: &Path) -> Result<bool, TrustError> {
    match check_folder(root, Forbidden::Everything) {
        Ok(()) => Ok(Lock::is_held(&root.join(LOCK)) || Lock::is_held(root)),
        Err(TrustError::Missing { why, .. }) if why.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(why) => Err(why),
    }
}

/// Returns the folders of all fleets of this user whose launcher lives.
pub fn live_fleets() -> Vec<PathBuf> {
    let homes = places(false).into_iter().filter(|home| is_trusted(home));
    homes.flat_map(|home| subfolders(&home)).filter(|root| is_alive(root)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    fn private(path: PathBuf) -> PathBuf {
        DirBuilder::new().mode(0o700).create(&path).unwrap();
        path
    }

    #[test]
    fn open_linked_and_foreign_folders_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = private(folder.path().join("a"));
        check_folder(&path, Forbidden::Everything).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o750)).unwrap();
        assert!(matches!(check_folder(&path, Forbidden::Everything), Err(TrustError::Mode { .. })));
        check_folder(&path, Forbidden::Writing).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o777)).unwrap();
        let why = check_folder(&path, Forbidden::WritingByAll).unwrap_err().to_string();
        assert!(why.contains("777") && why.contains("chmod o-w"), "{why}");
        let link = folder.path().join("link");
        symlink(private(folder.path().join("b")), &link).unwrap();
        assert!(matches!(check_folder(&link, Forbidden::Everything), Err(TrustError::Kind { .. })));
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        assert!(matches!(check_folder(&file, Forbidden::Writing), Err(TrustError::Kind { .. })));
        check_file(&file, Forbidden::Writing).unwrap();
        // Only root may give folders away.
        if user() == 0 {
            let foreign = private(folder.path().join("c"));
            std::os::unix::fs::chown(&foreign, Some(1234), None).unwrap();
            let why = check_folder(&foreign, Forbidden::Everything).unwrap_err();
            assert!(matches!(why, TrustError::Owner { owner: 1234, .. }), "{why}");
        }
    }

    #[test]
    fn a_fleet_holds_its_folder_whose_files_may_be_removed() {
        let folder = tempfile::tempdir().unwrap();
        let home = private(folder.path().join("home"));
        let root = private(home.join("fleet"));
        let file = Lock::acquire(&root.join(LOCK)).unwrap().unwrap();
        let folder_lock = Lock::acquire_folder(&root).unwrap().unwrap();
        fs::remove_file(root.join(LOCK)).unwrap();
        drop(Lock::acquire(&root.join(LOCK)).unwrap());
        let mut found = Vec::new();
        leftovers(&home, |name, _| found.push(name.to_owned()));
        assert!(is_alive(&root) && found.is_empty(), "{found:?}");
        drop((file, folder_lock));
        leftovers(&home, |name, _| found.push(name.to_owned()));
        assert!(!is_alive(&root) && found == ["fleet"], "{found:?}");
    }

    #[test]
    fn what_dead_launchers_left_in_other_places_is_removed_in_turn() {
        let folder = tempfile::tempdir().unwrap();
        let home = private(folder.path().join("home"));
        drop(Lock::acquire(&private(home.join("dead")).join(LOCK)).unwrap());
        let found = || {
            let mut found = Vec::new();
            remove_leftovers(&home, &mut |name: &str, _: &Path| found.push(name.to_owned()));
            found
        };
        let turn = Lock::acquire(&home.join(LOCK)).unwrap().unwrap();
        assert!(found().is_empty(), "another launcher is at it");
        drop(turn);
        assert_eq!(found(), ["dead"]);
    }

    #[test]
    fn only_fleets_whose_launcher_is_dead_are_leftovers() {
        let folder = tempfile::tempdir().unwrap();
        let home = private(folder.path().join("home"));
        let place = |name: &str| private(home.join(name));
        let _alive = Lock::acquire(&place("alive").join(LOCK)).unwrap().unwrap();
        drop(Lock::acquire(&place("dead").join(LOCK)).unwrap());
        // It is just being made.
        place("new");
        // Not private: somebody else could have put it there.
        let open = place("open");
        fs::set_permissions(&open, fs::Permissions::from_mode(0o777)).unwrap();
        let mut found = Vec::new();
        leftovers(&home, |name, _| found.push(name.to_owned()));
        assert_eq!(found, ["dead"]);
        assert!(is_alive(&home.join("alive")) && !is_alive(&home.join("dead")));
        let ended = ["dead", "missing"].map(|name| has_launcher(&home.join(name)).unwrap());
        assert_eq!(ended, [false; 2]);
        // A folder below a file cannot be reached.
        for unknown in [open, home.join("alive").join(LOCK).join("below")] {
            assert!(has_launcher(&unknown).is_err() && !is_alive(&unknown), "{unknown:?}");
        }
    }
}
