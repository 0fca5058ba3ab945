//! Time slices of threads under the normal scheduling policy.
//!
//! A thread that wakes takes its core at once from a thread with a longer slice, as long as it has had less than its share of the
//! processor. With the same slice it waits until the other's is used up: 3 ms by default. Linux takes slices of 0.1 to 100 ms from
//! threads, without a permission, since 6.12; an older one accepts the call and changes nothing
//! (sched(7); Linux, Documentation/scheduler/sched-eevdf.rst).
//!
//! glibc has a wrapper for the system call since 2.41 only, and no crate has one: this is the second file with unsafe code.

use rustix::process::getpriority_process;
use std::io;
use std::time::Duration;

/// Shortest slice that Linux takes.
pub const SLICE_MIN: Duration = Duration::from_micros(100);
/// Longest slice that Linux takes.
pub const SLICE_MAX: Duration = Duration::from_millis(100);

/// Flag that keeps the thread's policy: a real-time thread is refused instead of losing its priority.
const KEEP_POLICY: u64 = 0x08;

/// First version of `struct sched_attr`: sched_setattr(2).
#[derive(Default)]
#[repr(C)]
struct Attributes {
    size: u32,
    policy: u32,
    flags: u64,
    nice: i32,
    priority: u32,
    runtime_ns: u64,
    deadline_ns: u64,
    period_ns: u64,
}

/// Asks for a time slice for the calling thread and the threads that it starts.
///
/// # Errors
/// The thread has another policy than the normal ones, or the system refuses the call.
pub fn request(slice: Duration) -> io::Result<()> {
    set(slice.clamp(SLICE_MIN, SLICE_MAX).as_nanos() as u64, KEEP_POLICY)
}

/// Has the calling thread use the system's time slice again: for threads that compute for long and inherit a short one. A real-time
/// thread stays as it is.
pub fn request_default() {
    let _ = set(0, KEEP_POLICY);
}

/// Has the calling thread use the normal policy, with the system's time slice: for threads that inherit a real-time priority.
pub fn use_normal_policy() {
    let _ = set(0, 0);
}

/// Returns the calling thread's time slice; `None` if this Linux has none of its own for each thread.
///
/// # Errors
/// The system refuses the call.
pub fn granted() -> io::Result<Option<Duration>> {
    let mut attributes = Attributes::default();
    // SAFETY: thread 0 is the caller; the structure is as long as is said, any bits are a value of it, and it is written during the
    // call alone.
    let result =
        unsafe { libc::syscall(libc::SYS_sched_getattr, 0, &raw mut attributes, size_of::<Attributes>(), 0) };
    if result != 0 {
        return Err(io::Error::last_os_error());
    }
    Ok((attributes.runtime_ns > 0).then(|| Duration::from_nanos(attributes.runtime_ns)))
}

fn set(runtime_ns: u64, flags: u64) -> io::Result<()> {
    let attributes = Attributes {
        size: size_of::<Attributes>() as u32,
        flags,
        nice: getpriority_process(None)?,
        runtime_ns,
        ..Attributes::default()
    };
    // SAFETY: thread 0 is the caller; the structure is as long as its field says, and is only read during the call.
    let result = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_asks_for_a_slice_and_gives_it_back() {
        // The settings apply to a thread of its own, which ends with the test.
        let thread = std::thread::spawn(|| {
            let niceness = getpriority_process(None).unwrap();
            let slices = [SLICE_MIN, SLICE_MAX].map(|slice| request(slice).and_then(|()| granted()));
            request_default();
            assert_eq!(getpriority_process(None).unwrap(), niceness);
            (slices, granted())
        });
        // Linux before 6.12 has no such slices, and an emulated or confined one may refuse the calls.
        if let ([shortest, longest], Ok(Some(default))) = thread.join().unwrap() {
            assert_eq!((shortest.unwrap(), longest.unwrap()), (Some(SLICE_MIN), Some(SLICE_MAX)));
            assert!(default > SLICE_MIN && default < SLICE_MAX, "{default:?}");
        }
    }
}
