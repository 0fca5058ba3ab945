//! Records of the log beside a robot's session: nodes that came after the session was saved.
//!
//! A restarted SLAM process goes on with them, and a later fleet that begins with the folder has them, too: a fleet that was killed,
//! or whose disk was full at its end, has saved them in the log alone.

use crate::storage::Storage;
use ::slam::session::log::{LogContents, LogPosition, LogRecord, continuation};
use ::slam::{InitialPose, Session, SessionIdentity, SlamConfig};
use msg::SlamMode;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Bytes of one file at which a session is saved in its place: about 4000 nodes of a dense LiDAR.
pub const FILE_BYTES_MAX: u64 = 64 << 20;
/// Bytes that wait for the scan path's state; more are dropped, and a session is saved instead.
pub const WAITING_BYTES_MAX: usize = 8 << 20;

/// Kinds of the files into which a run's log is written in turns.
const OWN_KINDS: [&str; 2] = ["log0", "log1"];
/// Kinds of the files of the run before in the same folder, whose session this run has begun with.
const BEGUN_WITH_KINDS: [&str; 2] = ["begun0", "begun1"];

/// Returns the two files of the log beside a robot's session file.
pub fn files(session: &Path) -> [PathBuf; 2] {
    OWN_KINDS.map(|kind| session.with_extension(kind))
}

/// Returns all files of logs that may be beside a robot's session file.
pub fn all_files(session: &Path) -> [PathBuf; 4] {
    let ([own0, own1], [begun0, begun1]) = (OWN_KINDS, BEGUN_WITH_KINDS);
    [own0, own1, begun0, begun1].map(|kind| session.with_extension(kind))
}

/// Renames the log beside a robot's session file, with which a run in the same folder begins: this run's own log takes its place.
///
/// # Errors
/// Those of the operating system, with the file.
pub fn keep_for_next_run(session: &Path) -> Result<(), (PathBuf, std::io::Error)> {
    for (from, to) in OWN_KINDS.into_iter().zip(BEGUN_WITH_KINDS) {
        let [from, to] = [from, to].map(|kind| session.with_extension(kind));
        match std::fs::rename(&from, to) {
            Err(why) if why.kind() != ErrorKind::NotFound => return Err((from, why)),
            _ => {}
        }
    }
    Ok(())
}

/// Records that continue a session, and where they end.
pub struct Records {
    /// The records in order.
    pub chain: Vec<LogRecord>,
    /// Index of the file with the newest of them, and its end in that file, bytes.
    pub end: Option<(usize, u64)>,
    /// Files that are there and cannot be read, with the reason.
    pub unreadable: Vec<(PathBuf, std::io::Error)>,
}

/// Reads the records of one robot's run that follow `newest` from files, of which some may be missing or cut off.
pub fn read(
    storage: &impl Storage,
    files: &[PathBuf],
    identity: &SessionIdentity,
    newest: LogPosition,
) -> Records {
    let mut records = Vec::new();
    let mut ends = Vec::new();
    let mut unreadable = Vec::new();
    for (file, path) in files.iter().enumerate() {
        let bytes = match storage.read(path, FILE_BYTES_MAX + WAITING_BYTES_MAX as u64 * 2) {
            Ok(bytes) => bytes,
            Err(why) if why.kind() == ErrorKind::NotFound => continue,
            Err(why) => {
                unreadable.push((path.clone(), why));
                continue;
            }
        };
        let contents = LogContents::decode(&bytes);
        if let Some((end, why)) = contents.incomplete_tail {
            let cut = bytes.len() as u64 - end;
            tracing::warn!("{}: the last {cut} bytes are cut off: the file {why}", path.display());
        }
        for (record, end) in contents.records {
            if (record.identity.run, record.identity.robot) == (identity.run, identity.robot) {
                ends.push((record.position, file, end));
                records.push(record);
            }
        }
    }
    let chain = continuation(newest, records);
    let newest = chain.last().and_then(|last| ends.iter().find(|(position, ..)| *position == last.position));
    Records { end: newest.map(|&(_, file, end)| (file, end)), chain, unreadable }
}

/// Returns a session with the nodes that its run has logged after it; the session itself if there are none.
pub fn with_records(storage: &impl Storage, path: &Path, session: Session, config: &SlamConfig) -> Session {
    let records = read(storage, &all_files(path), &session.identity, session.log);
    for (file, why) in &records.unreadable {
        tracing::warn!("{}: {why}; its nodes are left out", file.display());
    }
    if records.chain.is_empty() {
        return session;
    }
    let (identity, mode) = (session.identity, session.mode);
    let mut config = config.clone();
    config.graph.trajectory_max = 0;
    replayed(config, (Some(session), mode, InitialPose::Continue), records.chain, identity)
}

/// Returns the session of a process that begins with another one, or with nothing, and receives the nodes of these records.
pub fn replayed(
    config: SlamConfig,
    (begins_with, mode, pose): (Option<Session>, SlamMode, InitialPose),
    records: Vec<LogRecord>,
    identity: SessionIdentity,
) -> Session {
    // That of a map that was reset has no nodes.
    let begins_with = begins_with.filter(|session| !session.back.nodes.is_empty());
    let (_, mut back) = ::slam::create_or_resume(config, begins_with, mode, pose);
    let front = back.replay(records);
    back.session(identity, front, &[])
}
