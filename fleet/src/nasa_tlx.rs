//! Answers to the raw NASA-TLX form of a run, in `nasa_tlx.json` in its folder.

use crate::clock::now;
use crate::run::Run;
use bridge::{SaveTlx, TlxAnswer, TlxError};
use msg::Monotonic;
use reports::TlxEntry;
use serde::{Deserialize, Serialize};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};

/// File below the run's folder.
const FILE: &str = "nasa_tlx.json";
/// Most answers of a run: more than people who take turns in one session.
const ANSWERS_MAX: usize = 64;
/// Largest size of the file, bytes.
const FILE_BYTES_MAX: u64 = 64 << 10;

/// Content of the file.
#[derive(Serialize, Deserialize)]
struct Answers {
    /// When the run began, nanoseconds of CLOCK_MONOTONIC: a folder may have held another run before.
    begun_ns: u64,
    answers: Vec<TlxEntry>,
}

/// Reads a run's answers, in the order in which they came; empty if there are none. Those of an earlier run in the same folder are
/// not this one's.
///
/// # Errors
/// The file is there and cannot be read.
pub fn read(dir: &Path, begun: Monotonic) -> io::Result<Vec<TlxEntry>> {
    match formats::limited::read_text(&dir.join(FILE), FILE_BYTES_MAX) {
        Ok(text) => {
            let kept: Answers = serde_json::from_str(&text).map_err(io::Error::other)?;
            Ok(if kept.begun_ns == begun.0 { kept.answers } else { Vec::new() })
        }
        Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(why) => Err(why),
    }
}

/// Adds an answer, given now, to those of the run that has begun then.
///
/// # Errors
/// The run has too many, or the file cannot be read or written.
pub fn add(dir: &Path, begun: Monotonic, now: Monotonic, answer: TlxAnswer) -> Result<(), TlxError> {
    let mut answers = read(dir, begun)?;
    if answers.len() >= ANSWERS_MAX {
        return Err(TlxError::Full(ANSWERS_MAX));
    }
    answers.push(TlxEntry { time_s: now.since(begun) as f64 * 1e-9, answer });
    let json = serde_json::to_vec_pretty(&Answers { begun_ns: begun.0, answers })?;
    Ok(formats::atomic::write_durably(&dir.join(FILE), |file| file.write_all(&json))?)
}

/// Returns what saves the answers of a run, on a thread of its own.
pub fn saver(run: &Run) -> SaveTlx {
    let (dir, begun): (PathBuf, _) = (run.dir.clone(), run.begun);
    // One at a time: each reads what is there, and adds to it.
    let turn = Arc::new(Mutex::new(()));
    Rc::new(move |answer| {
        let (dir, turn) = (dir.clone(), turn.clone());
        Box::pin(async move {
            let write = move || {
                let _turn = turn.lock().unwrap_or_else(PoisonError::into_inner);
                add(&dir, begun, now(), answer)
            };
            tokio::task::spawn_blocking(write).await.map_err(io::Error::other)?
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn answers_are_kept_in_order_and_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let (begun, another) = (Monotonic(7), Monotonic(8));
        assert!(read(folder.path(), begun).unwrap().is_empty());
        let answer = |effort| TlxAnswer {
            mental_demand: 0,
            physical_demand: 0,
            temporal_demand: 0,
            performance: 0,
            effort,
            frustration: 0,
        };
        for index in 0..ANSWERS_MAX {
            let now = begun + Duration::from_secs(index as u64);
            add(folder.path(), begun, now, answer(5 * (index as u8 % 20))).unwrap();
        }
        let why = add(folder.path(), begun, begun, answer(5)).unwrap_err().to_string();
        assert!(why.contains("64 answers"), "{why}");
        let entries = read(folder.path(), begun).unwrap();
        assert_eq!((entries.len(), entries[3].answer.effort, entries[3].time_s), (ANSWERS_MAX, 15, 3.0));
        assert!(read(folder.path(), another).unwrap().is_empty(), "they are of another run");
        add(folder.path(), another, another, answer(0)).unwrap();
        assert_eq!(read(folder.path(), another).unwrap().len(), 1);
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        assert!(read(folder.path(), another).is_err(), "a damaged file is no lack of answers");
    }
}
