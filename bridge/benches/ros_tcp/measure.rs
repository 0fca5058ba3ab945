//! Times, and how they are printed.

use msg::{Header, RobotFrame, RobotFrameTransform, Stamp, Transforms};
use std::time::Instant;

pub fn nanoseconds(begin: Instant) -> i64 {
    begin.elapsed().as_nanos() as i64
}

pub fn header(begin: Instant) -> Header {
    Header { stamp: Stamp(nanoseconds(begin)), ..Header::default() }
}

pub fn print_us(what: &str, mut values_ns: Vec<i64>) {
    if values_ns.is_empty() {
        return println!("{what:<52} nothing arrived");
    }
    values_ns.sort_unstable();
    let at = |share: f64| values_ns[((values_ns.len() - 1) as f64 * share) as usize] as f64 / 1e3;
    let [p50, p95, p99, max] = [0.5, 0.95, 0.99, 1.0].map(at);
    println!(
        "{what:<52} p50 {p50:8.1}  p95 {p95:8.1}  p99 {p99:8.1}  max {max:8.1} us  n {}",
        values_ns.len()
    );
}

/// Returns the processor time of the calling thread, nanoseconds.
pub fn thread_cpu_ns() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|field| field.parse().ok()).unwrap_or(0)
}

pub fn resident_kb() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    text.split(' ').nth(1).and_then(|field| field.parse::<u64>().ok()).unwrap_or(0) * 4
}

/// Returns the stamp at an offset of the payload, nanoseconds.
pub fn stamp_at(payload: &[u8], offset: usize) -> i64 {
    let word = |at: usize| u32::from_le_bytes(payload[at..at + 4].try_into().unwrap());
    i64::from(word(offset)) * 1_000_000_000 + i64::from(word(offset + 4))
}

pub fn transforms(header: Header) -> Transforms {
    let mut message = Transforms { header, len: 6, ..Transforms::default() };
    for (transform, child) in message.transforms.iter_mut().zip(&RobotFrame::ALL[1..]) {
        *transform = RobotFrameTransform {
            parent_frame: RobotFrame::Odom as u32,
            child_frame: *child as u32,
            ..RobotFrameTransform::default()
        };
    }
    message
}
