//! What the machine may be asked beyond the ordinary: real-time priority, cores of one's own, memory that is never
//! paged out. The defaults ask for nothing; what is asked for and not permitted is said, and the process goes on
//! without it.

use msg::Role;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// The fleet file's `[realtime]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RealtimeConfig {
    /// Priority under SCHED_FIFO of the processes of `roles`, 1 to 99; 0: no real-time priority.
    pub priority: u8,
    /// Roles with real-time priority. The default has those with deadlines and little work; SLAM and merging compute
    /// for long and would keep others off a core.
    pub roles: Vec<String>,
    /// Whether the processes of `roles` keep all their memory resident.
    pub lock_memory: bool,
    /// Cores, from 0, on which the processes of a role may run, such as `merge = [1]`; other roles run on any core.
    pub cores: BTreeMap<String, Vec<usize>>,
}

impl Default for RealtimeConfig {
    fn default() -> Self {
        Self {
            priority: 0,
            roles: vec![Role::Sim.name().into(), Role::Bridge.name().into()],
            lock_memory: false,
            cores: BTreeMap::new(),
        }
    }
}

/// One wish, and what came of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// What was asked for.
    pub wish: String,
    /// `Err`: why it is not so, and what would permit it.
    pub result: Result<(), String>,
}

impl RealtimeConfig {
    /// Refuses what cannot be meant.
    pub fn validate(&self) -> Result<(), String> {
        if self.priority > 99 {
            return Err(format!("priority {}; expected 0 (none) to 99", self.priority));
        }
        let known = |name: &String| Role::ALL.iter().any(|role| role.name() == name);
        if let Some(name) = self.roles.iter().chain(self.cores.keys()).find(|name| !known(name)) {
            let names = Role::ALL.map(Role::name).join(", ");
            return Err(format!("`{name}` is no process of a fleet; there are {names}"));
        }
        match self.cores.iter().find(|(_, cores)| cores.iter().any(|core| *core >= CpuSet::MAX_CPU)) {
            Some((name, cores)) => {
                Err(format!("cores.{name} = {cores:?}; cores are 0 to {}", CpuSet::MAX_CPU - 1))
            }
            None => Ok(()),
        }
    }

    /// Asks the system for what a role is to have, for the calling thread and those it starts. Nothing asked for:
    /// nothing happens. `mr-slam doctor` may call it in a process of its own to learn what is permitted.
    pub fn apply(&self, role: Role) -> Vec<Outcome> {
        let mut outcomes = Vec::new();
        let mut ask = |wish: String, result: Result<(), String>| outcomes.push(Outcome { wish, result });
        if let Some(cores) = self.cores.get(role.name()).filter(|cores| !cores.is_empty()) {
            ask(format!("cores {cores:?}"), pin(cores));
        }
        let named = self.roles.iter().any(|name| name == role.name());
        if named && self.priority > 0 {
            ask(format!("SCHED_FIFO priority {}", self.priority), prioritise(self.priority));
        }
        if named && self.lock_memory {
            ask("locked memory".into(), lock());
        }
        outcomes
    }
}

fn pin(cores: &[usize]) -> Result<(), String> {
    let mut set = CpuSet::new();
    cores.iter().filter(|core| **core < CpuSet::MAX_CPU).for_each(|core| set.set(*core));
    sched_setaffinity(None, &set).map_err(|why| format!("{why}; does the machine have these cores?"))
}

fn prioritise(priority: u8) -> Result<(), String> {
    let value = ThreadPriorityValue::try_from(priority)?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), policy).map_err(
        |why| format!("{why:?}; it needs CAP_SYS_NICE, or `ulimit -r {priority}` (rtprio in limits.conf)"),
    )
}

fn lock() -> Result<(), String> {
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(|why| {
        format!("{why}; it needs CAP_IPC_LOCK, or `ulimit -l unlimited` (memlock in limits.conf)")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_asks_for_nothing_and_nonsense_is_named() {
        let config = RealtimeConfig::default();
        assert_eq!(config.validate(), Ok(()));
        assert!(Role::ALL.iter().all(|role| config.apply(*role).is_empty()));
        let wrong = RealtimeConfig { roles: vec!["robot".into()], ..config.clone() };
        assert!(wrong.validate().unwrap_err().contains("`robot` is no process"));
        assert!(RealtimeConfig { priority: 100, ..config }.validate().unwrap_err().contains("100"));
    }

    #[test]
    fn what_cannot_be_had_is_said() {
        let cores = BTreeMap::from([("merge".to_string(), vec![CpuSet::MAX_CPU - 1])]);
        let config = RealtimeConfig { cores, ..RealtimeConfig::default() };
        // On a thread of its own, which ends with the test.
        let outcomes = std::thread::spawn(move || config.apply(Role::Merge)).join().unwrap();
        assert_eq!(outcomes.len(), 1);
        assert!(outcomes[0].result.as_ref().unwrap_err().contains("these cores"), "{outcomes:?}");
    }
}
