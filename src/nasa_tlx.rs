//! Answers to the raw NASA-TLX form of a run, in `nasa_tlx.json` in its folder.

use crate::clock::now;
use crate::run::Run;
use bridge::{SaveTlx, TlxAnswer, TlxError};
use reports::TlxEntry;
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

/// Reads a run's answers, in the order in which they came; empty if there are none.
///
/// # Errors
/// The file is there and cannot be read.
pub fn read(dir: &Path) -> io::Result<Vec<TlxEntry>> {
    match formats::limited::read_text(&dir.join(FILE), FILE_BYTES_MAX) {
        Ok(text) => serde_json::from_str(&text).map_err(io::Error::other),
        Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(why) => Err(why),
    }
}

/// Adds an answer to a run's.
///
/// # Errors
/// The run has too many, or the file cannot be read or written.
pub fn add(dir: &Path, time_s: f64, answer: TlxAnswer) -> Result<(), TlxError> {
    let mut entries = read(dir)?;
    if entries.len() >= ANSWERS_MAX {
        return Err(TlxError::Full(ANSWERS_MAX));
    }
    entries.push(TlxEntry { time_s, answer });
    let json = serde_json::to_vec_pretty(&entries)?;
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
                add(&dir, now().since(begun) as f64 * 1e-9, answer)
            };
            tokio::task::spawn_blocking(write).await.map_err(io::Error::other)?
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_kept_in_order_and_bounded() {
        let folder = tempfile::tempdir().unwrap();
        assert!(read(folder.path()).unwrap().is_empty());
        let answer = |effort| TlxAnswer {
            mental_demand: 0,
            physical_demand: 0,
            temporal_demand: 0,
            performance: 0,
            effort,
            frustration: 0,
        };
        for index in 0..ANSWERS_MAX {
            add(folder.path(), index as f64, answer(5 * (index as u8 % 20))).unwrap();
        }
        let why = add(folder.path(), 99.0, answer(5)).unwrap_err().to_string();
        assert!(why.contains("64 answers"), "{why}");
        let entries = read(folder.path()).unwrap();
        assert_eq!((entries.len(), entries[3].answer.effort, entries[3].time_s), (ANSWERS_MAX, 15, 3.0));
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        assert!(read(folder.path()).is_err(), "a damaged file is no lack of answers");
    }
}
