//! Settings of processes and threads: time slices, scheduling priority, processor cores and locked memory.
//!
//! The defaults need no permission. A process reports a setting that the system does not permit, and continues
//! without it.

use crate::time_slice;
use msg::Role;
use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io;
use std::time::Duration;
use thread_priority::unix::{
    NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// Highest priority of SCHED_FIFO on Linux: sched(7).
const PRIORITY_MAX: u8 = 99;

/// Roles whose processes robots and clients wait for, and which compute for a millisecond at a time or less.
const PUNCTUAL_ROLES: [Role; 4] = [Role::Sim, Role::Slam, Role::Telemetry, Role::Bridge];

/// Section `[realtime]` of the fleet's configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RealtimeConfig {
    /// Time slice of the threads that robots and clients wait for, microseconds, 100 to 100000; 0 keeps the system's. A thread
    /// that wakes takes its core at once from threads with a longer slice; otherwise it waits for up to 3 ms where other
    /// programs compute. It needs no permission, but Linux 6.12 or newer: on older ones nothing changes.
    pub slice_us: u32,
    /// SCHED_FIFO priority of the processes of `roles`, 1 to 99; 0 keeps the normal scheduling.
    pub priority: u8,
    /// Roles with the priority and locked memory, such as `sim` and `bridge`, which have deadlines and little
    /// work. SLAM and merging compute for long and would block other processes on their core.
    pub roles: Vec<String>,
    /// Whether the processes of `roles` keep all their memory resident.
    pub lock_memory: bool,
    /// Cores, from 0, that the processes of a role may run on. A role that is missing may use all cores.
    pub cores: BTreeMap<String, Vec<usize>>,
}

impl Default for RealtimeConfig {
    fn default() -> Self {
        Self {
            slice_us: 100,
            priority: 0,
            roles: vec![Role::Sim.name().into(), Role::Bridge.name().into()],
            lock_memory: false,
            cores: BTreeMap::new(),
        }
    }
}

/// A requested setting with its result.
#[derive(Debug)]
pub struct SettingResult {
    /// Description of the setting, for people.
    pub setting: String,
    /// Success, or the reason of the refusal with the permission that is missing.
    pub result: Result<(), SettingError>,
}

/// Reason why the section `[realtime]` is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RealtimeConfigError {
    /// The time slice is out of range.
    #[error(
        "realtime.slice_us is {0}; expected 0 (the system's) or {least} to {most}",
        least = time_slice::SLICE_MIN.as_micros(),
        most = time_slice::SLICE_MAX.as_micros()
    )]
    Slice(u32),
    /// The priority is out of range.
    #[error("realtime.priority is {0}; expected 0 (none) to {PRIORITY_MAX}")]
    Priority(u8),
    /// A role is none of a fleet's processes.
    #[error("realtime.{key} names `{name}`; expected {}", Role::ALL.map(Role::name).join(", "))]
    UnknownRole {
        /// Key below `realtime`.
        key: String,
        /// Name as the file has it.
        name: String,
    },
    /// No machine has such a core.
    #[error("realtime.cores.{role} has core {core}; expected 0 to {}", CpuSet::MAX_CPU - 1)]
    Core {
        /// Name of the role.
        role: String,
        /// Number of the core, from 0.
        core: usize,
    },
}

impl RealtimeConfigError {
    /// Returns the path of the key below `realtime`.
    pub fn key(&self) -> String {
        match self {
            Self::Slice(_) => "slice_us".into(),
            Self::Priority(_) => "priority".into(),
            Self::UnknownRole { key, .. } => key.clone(),
            Self::Core { role, .. } => format!("cores.{role}"),
        }
    }
}

/// Reason why the system refuses a setting.
#[derive(Debug, thiserror::Error)]
pub enum SettingError {
    /// The time slice is refused.
    #[error("{0}")]
    Slice(io::Error),
    /// The cores are refused.
    #[error("{0}; does the machine have these cores?")]
    Cores(Errno),
    /// The priority is no number that the library takes.
    #[error("priority {priority} is refused: {why}")]
    PriorityValue {
        /// The wished priority.
        priority: u8,
        /// The library's reason.
        why: String,
    },
    /// The priority is not permitted.
    #[error(
        "priority {priority}: {why}; it needs CAP_SYS_NICE, or `ulimit -r {priority}` (rtprio in limits.conf)"
    )]
    Priority {
        /// The wished priority.
        priority: u8,
        /// The system's reason.
        why: thread_priority::Error,
    },
    /// The memory cannot be locked.
    #[error("{0}; it needs CAP_IPC_LOCK, or `ulimit -l unlimited` (memlock in limits.conf)")]
    Memory(Errno),
}

impl RealtimeConfig {
    /// Returns the time slice of punctual threads; `None` for the system's.
    fn slice(&self) -> Option<Duration> {
        (self.slice_us > 0).then(|| Duration::from_micros(self.slice_us.into()))
    }

    /// Checks all values. The error names the first invalid one and its range.
    pub fn validate(&self) -> Result<(), RealtimeConfigError> {
        let slice = self.slice();
        if slice.is_some_and(|slice| !(time_slice::SLICE_MIN..=time_slice::SLICE_MAX).contains(&slice)) {
            return Err(RealtimeConfigError::Slice(self.slice_us));
        }
        if self.priority > PRIORITY_MAX {
            return Err(RealtimeConfigError::Priority(self.priority));
        }
        let check_role = |key: String, name: &String| {
            let is_known = Role::ALL.iter().any(|role| role.name() == name);
            let error = || RealtimeConfigError::UnknownRole { key, name: name.clone() };
            if is_known { Ok(()) } else { Err(error()) }
        };
        for (index, name) in self.roles.iter().enumerate() {
            check_role(format!("roles[{index}]"), name)?;
        }
        for (role, cores) in &self.cores {
            check_role(format!("cores.{role}"), role)?;
            if let Some(core) = cores.iter().find(|core| **core >= CpuSet::MAX_CPU) {
                return Err(RealtimeConfigError::Core { role: role.clone(), core: *core });
            }
        }
        Ok(())
    }

    /// Applies a role's settings to the calling thread and to the threads that it starts. `mr-slam doctor`
    /// calls it in a process of its own to find out what is permitted.
    pub fn apply(&self, role: Role) -> Vec<SettingResult> {
        let mut outcomes = Vec::new();
        let mut record = |setting: String, result: Result<(), SettingError>| {
            outcomes.push(SettingResult { setting, result })
        };
        // Before the priority: a real-time thread has no slice.
        if let Some(slice) = self.slice().filter(|_| PUNCTUAL_ROLES.contains(&role)) {
            record(
                format!("a time slice of {slice:?}"),
                time_slice::request(slice).map_err(SettingError::Slice),
            );
        }
        if let Some(cores) = self.cores.get(role.name()).filter(|cores| !cores.is_empty()) {
            record(format!("cores {cores:?}"), set_cores(cores));
        }
        let named = self.roles.iter().any(|name| name == role.name());
        if named && self.priority > 0 {
            record(format!("SCHED_FIFO priority {}", self.priority), set_priority(self.priority));
        }
        if named && self.lock_memory {
            record("locked memory".into(), lock_memory());
        }
        outcomes
    }
}

fn set_cores(cores: &[usize]) -> Result<(), SettingError> {
    let mut set = CpuSet::new();
    cores.iter().filter(|core| **core < CpuSet::MAX_CPU).for_each(|core| set.set(*core));
    sched_setaffinity(None, &set).map_err(SettingError::Cores)
}

fn set_priority(priority: u8) -> Result<(), SettingError> {
    let value = ThreadPriorityValue::try_from(priority)
        .map_err(|why| SettingError::PriorityValue { priority, why })?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), policy)
        .map_err(|why| SettingError::Priority { priority, why })
}

fn lock_memory() -> Result<(), SettingError> {
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(SettingError::Memory)
}

/// Leaves the processor to others first (nice(2)). On Linux it applies to the calling thread and to threads that it starts later.
/// Where it is refused, the priority stays.
pub fn lower_priority(niceness: i32) {
    let _ = rustix::process::nice(niceness);
}

/// Has the calling thread, which may have a real-time priority or a short time slice of its process, compute for long without keeping
/// others from the processor. Niceness does not apply to a real-time thread.
pub fn work_in_background(niceness: i32) {
    time_slice::use_normal_policy();
    lower_priority(niceness);
}

/// Lets the calling thread run only while its core has nothing else to do (`SCHED_IDLE`, sched(7)). It needs no permission, and cannot
/// be undone without one.
///
/// # Errors
/// The system refuses it.
pub fn yield_to_all_others() -> Result<(), thread_priority::Error> {
    let policy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, policy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_needs_no_permission_and_invalid_values_are_named() {
        let config = RealtimeConfig::default();
        assert_eq!(config.validate(), Ok(()));
        // The settings apply to a thread of its own, which ends with the test.
        let outcomes = std::thread::spawn(|| Role::ALL.map(|role| RealtimeConfig::default().apply(role)));
        for (role, outcomes) in Role::ALL.into_iter().zip(outcomes.join().unwrap()) {
            assert_eq!(outcomes.len(), usize::from(PUNCTUAL_ROLES.contains(&role)), "{role:?}");
            assert!(outcomes.iter().all(|outcome| outcome.setting.contains("time slice")), "{outcomes:?}");
        }
        for slice_us in [1, 99, 100_001] {
            let wrong = RealtimeConfig { slice_us, ..config.clone() };
            assert_eq!(wrong.validate(), Err(RealtimeConfigError::Slice(slice_us)));
        }
        let wrong = RealtimeConfig { roles: vec!["robot".into()], ..config.clone() };
        assert!(
            wrong
                .validate()
                .unwrap_err()
                .to_string()
                .contains("realtime.roles[0] names `robot`; expected sim")
        );
        assert!(
            RealtimeConfig { priority: 100, ..config }.validate().unwrap_err().to_string().contains("100")
        );
    }

    #[test]
    fn a_setting_that_is_not_permitted_is_reported() {
        let cores = BTreeMap::from([("merge".to_string(), vec![CpuSet::MAX_CPU - 1])]);
        let config = RealtimeConfig { cores, ..RealtimeConfig::default() };
        // The setting applies to a thread of its own, which ends with the test.
        let outcomes = std::thread::spawn(move || config.apply(Role::Merge)).join().unwrap();
        assert_eq!(outcomes.len(), 1);
        assert!(outcomes[0].result.as_ref().unwrap_err().to_string().contains("these cores"), "{outcomes:?}");
    }

    #[test]
    fn a_thread_in_the_background_has_no_realtime_priority_and_its_niceness() {
        // The settings apply to a thread of its own, which ends with the test.
        let background = std::thread::spawn(|| {
            // It may be refused, which leaves the normal policy.
            let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
            let lowest = ThreadPriority::Crossplatform(ThreadPriorityValue::try_from(1).unwrap());
            let _ = set_thread_priority_and_policy(thread_native_id(), lowest, policy);
            let before = rustix::process::getpriority_process(None).unwrap();
            work_in_background(3);
            // The C library remembers the policy that it has set itself; field 41 is the system's (proc_pid_stat(5)).
            let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
            let policy = stat.rsplit_once(')').unwrap().1.split_whitespace().nth(38).map(str::to_owned);
            (policy, rustix::process::getpriority_process(None).unwrap() - before)
        });
        let (policy, more) = background.join().unwrap();
        assert_eq!(policy.as_deref(), Some("0"), "SCHED_OTHER");
        assert!((0..=3).contains(&more), "{more}");
    }
}
