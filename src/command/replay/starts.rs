//! File with the known starts of robots whose logs are merged.

use super::ReplayError;
use msg::Pose2;
use std::path::Path;

/// Largest size of the file with the robots' starts, bytes.
const STARTS_BYTES_MAX: u64 = 1 << 20;

/// Reads lines `index time x y theta`; the first robot has the index 0, and `#` begins a comment.
pub fn read(path: &Path, count: usize) -> Result<Vec<Option<Pose2>>, ReplayError> {
    let text = formats::limited::read_text(path, STARTS_BYTES_MAX)
        .map_err(|source| ReplayError::Read { path: path.to_owned(), source })?;
    let mut starts = vec![None; count];
    for (line, text) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        if text.trim_start().starts_with('#') {
            continue;
        }
        let wrong = || ReplayError::Starts { path: path.to_owned(), line: line + 1, found: text.into() };
        let numbers: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
        let Some([index, _, x_m, y_m, yaw_rad]) = numbers.as_deref() else { return Err(wrong()) };
        let robot = (0..starts.len()).find(|robot| *robot as f64 == *index).ok_or_else(wrong)?;
        let slot = &mut starts[robot];
        *slot = Some(Pose2::new(*x_m, *y_m, *yaw_rad)).filter(|pose| pose.is_finite());
        if slot.is_none() {
            return Err(wrong());
        }
    }
    Ok(starts)
}
