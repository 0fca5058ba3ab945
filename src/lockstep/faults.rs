//! Faults drawn from a seed: what goes wrong in a fleet in lockstep, and when.

use msg::Monotonic;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::time::Duration;

/// The length of a window in which messages are disturbed, or something does not work, milliseconds.
const WINDOW_MS: [u64; 2] = [200, 3000];
/// How late a late message comes, milliseconds.
const LATE_MS: [u64; 2] = [5, 400];
/// How long a process is stopped, milliseconds.
const FREEZE_MS: [u64; 2] = [100, 3000];
/// How far the clock jumps, milliseconds.
const CLOCK_STEP_MS: [u64; 2] = [50, 4000];
/// The most faults of one kind in a run.
const COUNT_MAX: u64 = 3;

/// What becomes of a message on its way to one reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// It is lost.
    Lost,
    /// It arrives so often, at once.
    Copies(usize),
    /// It arrives at this moment.
    Late(Monotonic),
}

/// Something that goes wrong at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A process is killed; the number chooses one.
    Kill(usize),
    /// A process is stopped for a while, as by SIGSTOP.
    Freeze(usize, Duration),
    /// Time jumps, as on a machine that slept.
    ClockStep(Duration),
    /// A person resets a robot's map.
    ResetMap(usize),
    /// A person pauses a robot's SLAM for a while.
    Pause(usize, Duration),
    /// The operator lets go of all sticks for a while.
    LetGo(Duration),
}

/// A time from a moment on to another.
#[derive(Clone, Copy, Debug)]
struct Window {
    from: Monotonic,
    until: Monotonic,
}

impl Window {
    fn contains(&self, now: Monotonic) -> bool {
        (self.from..self.until).contains(&now)
    }
}

/// How messages are disturbed in a window, in thousandths.
#[derive(Clone, Copy, Debug)]
struct Disturbance {
    window: Window,
    lost: u64,
    late: u64,
    doubled: u64,
}

/// All faults of a run.
#[derive(Clone, Debug)]
pub struct FaultPlan {
    rng: Pcg32,
    /// Whether components that could run at the same moment run in an order drawn from the seed.
    shuffled: bool,
    disturbances: Vec<Disturbance>,
    /// When channels take no message.
    full: Vec<Window>,
    /// When the disk takes nothing.
    disk_full: Vec<Window>,
    /// When the queue from a scan path to its back end has room for nodes only.
    events_lost: Vec<Window>,
    faults: Vec<(Monotonic, Fault)>,
}

impl FaultPlan {
    /// Nothing goes wrong, and the order of components is fixed.
    pub fn none() -> Self {
        Self {
            rng: Pcg32::seed_from_u64(0),
            shuffled: false,
            disturbances: Vec::new(),
            full: Vec::new(),
            disk_full: Vec::new(),
            events_lost: Vec::new(),
            faults: Vec::new(),
        }
    }

    /// Draws the faults of a run, all of them before `quiet`.
    pub fn draw(seed: u64, quiet: Monotonic) -> Self {
        let mut plan = Self { rng: Pcg32::seed_from_u64(seed), shuffled: true, ..Self::none() };
        for _ in 0..plan.below(COUNT_MAX + 1) {
            let window = plan.window(quiet);
            let [lost, late, doubled] = [200, 200, 100].map(|most| plan.below(most));
            plan.disturbances.push(Disturbance { window, lost, late, doubled });
        }
        for kind in 0..3 {
            for _ in 0..plan.below(2) {
                let window = plan.window(quiet);
                [&mut plan.full, &mut plan.disk_full, &mut plan.events_lost][kind].push(window);
            }
        }
        for kind in 0..6 {
            for _ in 0..plan.below(COUNT_MAX) {
                let at = plan.moment(quiet);
                let chosen = plan.below(1 << 20) as usize;
                let fault = match kind {
                    0 => Fault::Kill(chosen),
                    1 => Fault::Freeze(chosen, plan.duration(FREEZE_MS)),
                    2 => Fault::ClockStep(plan.duration(CLOCK_STEP_MS)),
                    3 => Fault::ResetMap(chosen),
                    4 => Fault::Pause(chosen, plan.duration(FREEZE_MS)),
                    _ => Fault::LetGo(plan.duration(FREEZE_MS)),
                };
                plan.faults.push((at, fault));
            }
        }
        plan.faults.sort_by_key(|(at, _)| *at);
        plan
    }

    /// Adds one fault to a plan, for tests of one kind.
    pub fn with(mut self, at: Monotonic, fault: Fault) -> Self {
        self.faults.push((at, fault));
        self.faults.sort_by_key(|(at, _)| *at);
        self
    }

    /// Adds a time in which the queue from scan paths to back ends has room for nodes only.
    pub fn with_lost_events(mut self, from: Monotonic, until: Monotonic) -> Self {
        self.events_lost.push(Window { from, until });
        self
    }

    /// Takes the next fault that is due.
    pub fn take_due(&mut self, now: Monotonic) -> Option<Fault> {
        let due = self.faults.first().is_some_and(|(at, _)| *at <= now);
        due.then(|| self.faults.remove(0).1)
    }

    /// When the next fault is due.
    pub fn next_due(&self) -> Option<Monotonic> {
        self.faults.first().map(|(at, _)| *at)
    }

    /// What becomes of a message that is sent now, on its way to one reader.
    pub fn deliver(&mut self, now: Monotonic) -> Delivery {
        let Some(Disturbance { lost, late, doubled, .. }) =
            self.disturbances.iter().find(|disturbance| disturbance.window.contains(now)).copied()
        else {
            return Delivery::Copies(1);
        };
        let drawn = self.below(1000);
        if drawn < lost {
            Delivery::Lost
        } else if drawn < lost + late {
            Delivery::Late(Monotonic(now.0 + self.duration(LATE_MS).as_nanos() as u64))
        } else if drawn < lost + late + doubled {
            Delivery::Copies(2)
        } else {
            Delivery::Copies(1)
        }
    }

    /// Whether channels take no message now.
    pub fn is_full(&self, now: Monotonic) -> bool {
        self.full.iter().any(|window| window.contains(now))
    }

    /// Whether the disk takes nothing now.
    pub fn is_disk_full(&self, now: Monotonic) -> bool {
        self.disk_full.iter().any(|window| window.contains(now))
    }

    /// Whether events of scan paths other than nodes are lost now.
    pub fn loses_events(&self, now: Monotonic) -> bool {
        self.events_lost.iter().any(|window| window.contains(now))
    }

    /// Whether components that could run at one moment run in an order drawn from the seed.
    pub fn is_shuffled(&self) -> bool {
        self.shuffled
    }

    /// Which of `count` components that could run now runs first.
    pub fn choose(&mut self, count: usize) -> usize {
        self.below(count as u64) as usize
    }

    fn below(&mut self, count: u64) -> u64 {
        (u64::from(self.rng.next_u32()) * count) >> 32
    }

    fn duration(&mut self, [least, most]: [u64; 2]) -> Duration {
        Duration::from_millis(least + self.below(most - least))
    }

    fn moment(&mut self, before: Monotonic) -> Monotonic {
        let ms = before.0 / 1_000_000;
        Monotonic(self.below(ms.max(1)) * 1_000_000)
    }

    fn window(&mut self, quiet: Monotonic) -> Window {
        let from = self.moment(quiet);
        let until = Monotonic(from.0 + self.duration(WINDOW_MS).as_nanos() as u64).min(quiet);
        Window { from, until }
    }
}
