//! Health of the fleet's processes, as they report it.

use msg::{Monotonic, PROCESSES_MAX, ProcessHealth, ProcessStats, ROBOTS_MAX, RobotId, Role};

/// The newest report of each process: sim and slam of each robot, then merge, telemetry, bridge, record, nav, objects.
pub(crate) struct ProcessTable {
    robot_count: usize,
    slots: [Option<Report>; PROCESSES_MAX],
}

#[derive(Clone, Copy)]
struct Report {
    health: ProcessHealth,
    received: Monotonic,
    restarts: u64,
    /// Whether the process has reported. Until then there are only its role and robot, and since when a report is awaited.
    has_reported: bool,
}

impl ProcessTable {
    /// Creates the table of a fleet of this many robots.
    pub fn new(robot_count: usize) -> Self {
        Self { robot_count: robot_count.min(ROBOTS_MAX), slots: [None; PROCESSES_MAX] }
    }

    /// Adds a process of the fleet from which reports are awaited, so that one that never reports is listed, too.
    pub fn expect(&mut self, role: Role, robot: Option<RobotId>, now: Monotonic) {
        let robot = robot.map_or(0, |robot| robot.number() as u32);
        let health = ProcessHealth { role: role as u32, robot, ..ProcessHealth::default() };
        let Some(slot) = self.slot(&health).and_then(|slot| self.slots.get_mut(slot)) else { return };
        slot.get_or_insert(Report { health, received: now, restarts: 0, has_reported: false });
    }

    /// Records a report. One of a role or robot that the fleet does not have is ignored.
    pub fn receive(&mut self, health: &ProcessHealth, received: Monotonic) {
        let Some(slot) = self.slot(health).and_then(|slot| self.slots.get_mut(slot)) else { return };
        let counted = slot.filter(|report| report.has_reported).map_or(0, |report| {
            report.restarts + u64::from(report.health.header.incarnation != health.header.incarnation)
        });
        // The launcher knows of processes that died before their first report, and before this process started.
        let restarts = counted.max(health.restarts);
        *slot = Some(Report { health: *health, received, restarts, has_reported: true });
    }

    fn slot(&self, health: &ProcessHealth) -> Option<usize> {
        let robot = (health.robot as usize).checked_sub(1).filter(|index| *index < self.robot_count);
        match Role::from_code(health.role)? {
            Role::Sim => Some(2 * robot?),
            Role::Slam => Some(2 * robot? + 1),
            Role::Merge => Some(2 * self.robot_count),
            Role::Telemetry => Some(2 * self.robot_count + 1),
            Role::Bridge => Some(2 * self.robot_count + 2),
            Role::Record => Some(2 * self.robot_count + 3),
            Role::Nav => Some(2 * self.robot_count + 4),
            Role::Objects => Some(2 * self.robot_count + 5),
        }
    }

    /// Returns the newest reports, with their age and the number of restarts.
    pub fn health(&self, now: Monotonic) -> [ProcessStats; PROCESSES_MAX] {
        self.slots.map(|slot| {
            slot.map_or(ProcessStats::default(), |report| ProcessStats {
                health: report.health,
                age_s: now.since(report.received) as f64 * 1e-9,
                restarts: report.restarts,
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Header;

    fn health_of(role: Role, robot: u32, run: u64) -> ProcessHealth {
        ProcessHealth {
            header: Header { incarnation: run, ..Default::default() },
            role: role as u32,
            robot,
            ..Default::default()
        }
    }

    #[test]
    fn the_largest_fleet_has_a_row_for_every_process() {
        let mut processes = ProcessTable::new(ROBOTS_MAX);
        for role in Role::ALL {
            processes.receive(&health_of(role, ROBOTS_MAX as u32, 1), Monotonic(0));
        }
        let roles = processes.health(Monotonic(0)).map(|process| process.health.role);
        for role in Role::ALL {
            assert!(roles.contains(&(role as u32)), "{role:?} has no row in a fleet of {ROBOTS_MAX}");
        }
    }

    #[test]
    fn a_process_that_never_reports_is_listed_with_the_time_since_it_is_awaited() {
        let mut processes = ProcessTable::new(1);
        let robot = RobotId::new(1);
        processes.expect(Role::Slam, robot, Monotonic(1_000_000_000));
        processes.expect(Role::Merge, None, Monotonic(1_000_000_000));
        processes.expect(Role::Slam, RobotId::new(2), Monotonic(0));
        let now = Monotonic(4_000_000_000);
        let report = ProcessHealth { pid: 7, ..health_of(Role::Merge, 0, 1) };
        processes.receive(&report, now);
        let listed = processes.health(now).into_iter().filter(|process| process.health.role != 0);
        let listed: Vec<_> = listed
            .map(|process| (process.health.role, process.health.pid, process.age_s, process.restarts))
            .collect();
        assert_eq!(listed, [(Role::Slam as u32, 0, 3.0, 0), (Role::Merge as u32, 7, 0.0, 0)]);
        // A report is not forgotten.
        processes.expect(Role::Merge, None, now);
        assert_eq!(processes.health(now)[2].health.pid, 7);
    }

    #[test]
    fn counts_restarts_of_each_process() {
        let mut processes = ProcessTable::new(2);
        for run in [7, 7, 8, 9, 9] {
            processes.receive(&health_of(Role::Slam, 2, run), Monotonic(1_000_000_000));
        }
        processes.receive(&health_of(Role::Bridge, 0, 1), Monotonic(0));
        processes.receive(&health_of(Role::Sim, 3, 1), Monotonic(0));
        processes.receive(&ProcessHealth { role: 77, ..Default::default() }, Monotonic(0));
        let health = processes.health(Monotonic(3_500_000_000));
        assert_eq!((health[3].restarts, health[3].age_s), (2, 2.5));
        // What the launcher counts is the truth, also for a table that has just begun.
        let mut begun = ProcessTable::new(2);
        begun.receive(&ProcessHealth { restarts: 5, ..health_of(Role::Slam, 2, 9) }, Monotonic(0));
        assert_eq!(begun.health(Monotonic(0))[3].restarts, 5);
        assert_eq!(health[6].health.role, Role::Bridge as u32);
        assert_eq!(health.iter().filter(|process| process.health.role != 0).count(), 2);
    }
}
