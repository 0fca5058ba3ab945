//! The fleet's processes, by their own accounts.

use msg::{Beat, Monotonic, PROCESSES_MAX, ProcessHealth, ROBOTS_MAX, Role};

/// Slots: sim and slam of each robot, then merge, telemetry, bridge.
pub(crate) struct Processes {
    robot_count: usize,
    slots: [Option<Seen>; PROCESSES_MAX],
}

#[derive(Clone, Copy)]
struct Seen {
    beat: Beat,
    received: Monotonic,
    restarts: u64,
}

impl Processes {
    pub fn new(robot_count: usize) -> Self {
        Self { robot_count: robot_count.min(ROBOTS_MAX), slots: [None; PROCESSES_MAX] }
    }

    /// A beat of a role or robot that the fleet does not have is ignored.
    pub fn beat(&mut self, beat: &Beat, received: Monotonic) {
        let Some(slot) = self.slot(beat).and_then(|slot| self.slots.get_mut(slot)) else { return };
        let restarts =
            slot.map_or(0, |seen| seen.restarts + u64::from(seen.beat.header.run != beat.header.run));
        *slot = Some(Seen { beat: *beat, received, restarts });
    }

    fn slot(&self, beat: &Beat) -> Option<usize> {
        let robot = (beat.robot as usize).checked_sub(1).filter(|index| *index < self.robot_count);
        match Role::from_code(beat.role)? {
            Role::Sim => Some(2 * robot?),
            Role::Slam => Some(2 * robot? + 1),
            Role::Merge => Some(2 * self.robot_count),
            Role::Telemetry => Some(2 * self.robot_count + 1),
            Role::Bridge => Some(2 * self.robot_count + 2),
        }
    }

    pub fn health(&self, now: Monotonic) -> [ProcessHealth; PROCESSES_MAX] {
        self.slots.map(|slot| {
            slot.map_or(ProcessHealth::default(), |seen| ProcessHealth {
                beat: seen.beat,
                age_s: now.since(seen.received) as f64 * 1e-9,
                restarts: seen.restarts,
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Header;

    #[test]
    fn counts_restarts_of_each_process() {
        let mut processes = Processes::new(2);
        let beat = |role: Role, robot, run| Beat {
            header: Header { run, ..Default::default() },
            role: role as u32,
            robot,
            ..Default::default()
        };
        for run in [7, 7, 8, 9, 9] {
            processes.beat(&beat(Role::Slam, 2, run), Monotonic(1_000_000_000));
        }
        processes.beat(&beat(Role::Bridge, 0, 1), Monotonic(0));
        processes.beat(&beat(Role::Sim, 3, 1), Monotonic(0));
        processes.beat(&Beat { role: 77, ..Default::default() }, Monotonic(0));
        let health = processes.health(Monotonic(3_500_000_000));
        assert_eq!((health[3].restarts, health[3].age_s), (2, 2.5));
        assert_eq!(health[6].beat.role, Role::Bridge as u32);
        assert_eq!(health.iter().filter(|process| process.beat.role != 0).count(), 2);
    }
}
