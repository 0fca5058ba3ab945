//! Plan of the faults that lockstep injects, drawn from a seed.

use msg::Monotonic;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::{Rng, SeedableRng};
use std::fmt;
use std::time::Duration;

/// Smallest and largest duration of a disturbance of messages, disk or queues, milliseconds.
const WINDOW_MS: [u64; 2] = [200, 3000];
/// Smallest and largest delay of a late message, milliseconds.
const LATE_MS: [u64; 2] = [5, 400];
/// Smallest and largest time for which a process is stopped, milliseconds.
const FREEZE_MS: [u64; 2] = [100, 3000];
/// Smallest and largest jump of the clock, milliseconds.
const CLOCK_STEP_MS: [u64; 2] = [50, 4000];
/// Largest number of faults of one kind in a run.
const COUNT_MAX: u64 = 3;
/// Kinds of faults at one moment that are drawn.
const FAULT_KINDS: usize = 11;
/// Number that chooses the bridge among the processes.
pub const BRIDGE: usize = usize::MAX;

/// Delivery of a message to one reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// It is lost.
    Lost,
    /// It arrives at once, this many times.
    Copies(usize),
    /// It arrives at this moment.
    Late(Monotonic),
}

/// Fault at one moment.
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
    /// The operator sends no velocity for a while.
    LetGo(Duration),
    /// The operator's client disconnects, and connects again after a while.
    OperatorLeaves(Duration),
    /// The operator's client is stopped for a while, with its connection open.
    OperatorFrozen(Duration),
    /// A second operator drives a robot for a while; the number chooses the robot.
    Contend(usize, Duration),
    /// The person at the laptop sets the emergency stop for a while.
    EmergencyStop(Duration),
}

/// Interval of time: from a moment to another.
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

/// Disturbance of messages during an interval; probabilities in thousandths.
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
    /// Intervals in which channels refuse messages.
    full: Vec<Window>,
    /// Intervals in which the disk is full.
    disk_full: Vec<Window>,
    /// Intervals in which the network between clients and the bridge is cut.
    cut: Vec<Window>,
    /// Intervals in which the queue from a scan path to its back end has room for nodes only.
    events_lost: Vec<Window>,
    faults: Vec<(Monotonic, Fault)>,
}

impl fmt::Display for Window {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(to, "from {:.2} to {:.2} s", self.from.seconds(), self.until.seconds())
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kill(BRIDGE) => write!(to, "the bridge is killed"),
            Self::Kill(_) => write!(to, "a process is killed"),
            Self::Freeze(BRIDGE, time) => write!(to, "the bridge is stopped for {time:?}"),
            Self::Freeze(_, time) => write!(to, "a process is stopped for {time:?}"),
            Self::ClockStep(time) => write!(to, "time jumps by {time:?}"),
            Self::ResetMap(_) => write!(to, "a robot's map is reset"),
            Self::Pause(_, time) => write!(to, "a robot's SLAM is paused for {time:?}"),
            Self::LetGo(time) => write!(to, "the operator sends no velocity for {time:?}"),
            Self::OperatorLeaves(time) => write!(to, "the operator's client leaves for {time:?}"),
            Self::OperatorFrozen(time) => write!(to, "the operator's client is stopped for {time:?}"),
            Self::Contend(_, time) => write!(to, "a second operator drives a robot for {time:?}"),
            Self::EmergencyStop(time) => write!(to, "the emergency stop is set for {time:?}"),
        }
    }
}

/// Lists the faults in words, each on a line.
impl fmt::Display for FaultPlan {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rng: _, shuffled, disturbances, full, disk_full, cut, events_lost, faults } = self;
        let order = if *shuffled { "drawn" } else { "fixed" };
        write!(to, "faults; the order of processes that are due at one moment is {order}")?;
        for Disturbance { window, lost, late, doubled } in disturbances {
            let [lost, late, doubled] = [lost, late, doubled].map(|thousandths| *thousandths as f64 / 10.0);
            write!(
                to,
                "\n  {window}: {lost:.1} % of the messages are lost, {late:.1} % late, {doubled:.1} % doubled"
            )?;
        }
        let kinds = [
            (full, "channels refuse messages"),
            (disk_full, "the disk is full"),
            (cut, "the network between clients and the bridge is cut"),
            (events_lost, "the queues from scan paths to back ends have room for nodes only"),
        ];
        for (windows, what) in kinds {
            windows.iter().try_for_each(|window| write!(to, "\n  {window}: {what}"))?;
        }
        faults.iter().try_for_each(|(at, fault)| write!(to, "\n  at {:.2} s: {fault}", at.seconds()))
    }
}

impl FaultPlan {
    /// Creates a plan without faults; the order of components is fixed.
    pub fn none() -> Self {
        Self {
            rng: Pcg32::seed_from_u64(0),
            shuffled: false,
            disturbances: Vec::new(),
            full: Vec::new(),
            disk_full: Vec::new(),
            cut: Vec::new(),
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
        for kind in 0..4 {
            for _ in 0..plan.below(2) {
                let window = plan.window(quiet);
                [&mut plan.full, &mut plan.disk_full, &mut plan.events_lost, &mut plan.cut][kind]
                    .push(window);
            }
        }
        for kind in 0..FAULT_KINDS {
            for _ in 0..plan.below(COUNT_MAX) {
                let fault = plan.fault(kind);
                let at = plan.moment(quiet);
                plan.faults.push((at, fault));
            }
        }
        plan.faults.sort_by_key(|(at, _)| *at);
        plan
    }

    fn fault(&mut self, kind: usize) -> Fault {
        let chosen = self.below(1 << 20) as usize;
        let duration = self.duration(if kind == 2 { CLOCK_STEP_MS } else { FREEZE_MS });
        match kind {
            0 => Fault::Kill(chosen),
            1 => Fault::Freeze(chosen, duration),
            2 => Fault::ClockStep(duration),
            3 => Fault::ResetMap(chosen),
            4 => Fault::Pause(chosen, duration),
            5 => Fault::LetGo(duration),
            6 if chosen.is_multiple_of(2) => Fault::Freeze(BRIDGE, duration),
            6 => Fault::Kill(BRIDGE),
            7 => Fault::OperatorLeaves(duration),
            8 => Fault::OperatorFrozen(duration),
            9 => Fault::Contend(chosen, duration),
            _ => Fault::EmergencyStop(duration),
        }
    }

    /// Adds one fault to a plan, for tests of one kind.
    pub fn with(mut self, at: Monotonic, fault: Fault) -> Self {
        self.faults.push((at, fault));
        self.faults.sort_by_key(|(at, _)| *at);
        self
    }

    /// Adds an interval in which the queue from scan paths to back ends has room for nodes only.
    pub fn with_lost_events(mut self, from: Monotonic, until: Monotonic) -> Self {
        self.events_lost.push(Window { from, until });
        self
    }

    /// Adds an interval in which the network between clients and the bridge is cut.
    pub fn with_cut(mut self, from: Monotonic, until: Monotonic) -> Self {
        self.cut.push(Window { from, until });
        self
    }

    /// Adds an interval in which the disk is full.
    pub fn with_full_disk(mut self, from: Monotonic, until: Monotonic) -> Self {
        self.disk_full.push(Window { from, until });
        self
    }

    /// Takes the next fault that is due.
    pub fn take_due(&mut self, now: Monotonic) -> Option<Fault> {
        let due = self.faults.first().is_some_and(|(at, _)| *at <= now);
        due.then(|| self.faults.remove(0).1)
    }

    /// Returns when the next fault is due.
    pub fn next_due(&self) -> Option<Monotonic> {
        self.faults.first().map(|(at, _)| *at)
    }

    /// Returns how a message that is sent now reaches one reader.
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

    /// Returns whether channels refuse messages now.
    pub fn is_full(&self, now: Monotonic) -> bool {
        self.full.iter().any(|window| window.contains(now))
    }

    /// Returns whether the disk is full now.
    pub fn is_disk_full(&self, now: Monotonic) -> bool {
        self.disk_full.iter().any(|window| window.contains(now))
    }

    /// Returns whether the network between clients and the bridge is cut now.
    pub fn is_cut(&self, now: Monotonic) -> bool {
        self.cut.iter().any(|window| window.contains(now))
    }

    /// Returns when the network that is cut now is whole again.
    pub fn cut_until(&self, now: Monotonic) -> Option<Monotonic> {
        self.cut.iter().filter(|window| window.contains(now)).map(|window| window.until).max()
    }

    /// Returns whether events of scan paths other than nodes are lost now.
    pub fn loses_events(&self, now: Monotonic) -> bool {
        self.events_lost.iter().any(|window| window.contains(now))
    }

    /// Returns whether components that are due at one moment run in an order drawn from the seed.
    pub fn is_shuffled(&self) -> bool {
        self.shuffled
    }

    /// Returns which of `count` components that are due runs first.
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
