//! What a person sees while a fleet runs: a table that renews itself on a terminal, a line now and
//! then in a log.

use crate::report::Report;
use crate::run::Run;
use crate::view::FleetView;
use std::io::{IsTerminal, Write, stderr};
use std::time::{Duration, Instant};

/// How often a log gets a line.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// The launcher's terminal. It writes to stderr; stdout is for results.
pub struct Screen {
    live: bool,
    lines_shown: usize,
    logged: Option<Instant>,
}

impl Screen {
    /// Says what is being started.
    pub fn new(run: &Run) -> Self {
        let Run { dir, port, config, .. } = run;
        eprintln!(
            "fleet of {} in {}: headsets attach on port {port}; maps and report go to {}",
            config.fleet.robots,
            config.world_name(),
            dir.display()
        );
        Self { live: stderr().is_terminal(), lines_shown: 0, logged: None }
    }

    /// Something happened.
    pub fn tell(&mut self, event: &str) {
        self.lines_shown = 0;
        eprintln!("! {event}");
    }

    /// The newest figures. `help` says which keys work.
    pub fn show(&mut self, fleet: &FleetView, help: &str, elapsed: Duration, seconds: Option<f64>) {
        let elapsed = elapsed.as_secs_f64();
        let clock = seconds.map_or(format!("{elapsed:.0} s"), |s| format!("{elapsed:.0} of {s:.0} s"));
        if self.live {
            let text = format!("{clock}; {help}\n{}", fleet.table());
            let up = if self.lines_shown > 0 {
                format!("\x1b[{}A\x1b[J", self.lines_shown)
            } else {
                String::new()
            };
            let _ = write!(stderr(), "{up}{text}");
            self.lines_shown = text.lines().count();
        } else if self.logged.is_none_or(|logged| logged.elapsed() >= LOG_PERIOD) {
            self.logged = Some(Instant::now());
            eprintln!("{clock}\n{}", fleet.table());
        }
    }

    /// The run is over.
    pub fn end(&mut self, report: &Report) {
        self.lines_shown = 0;
        eprint!("{}", report.summary());
    }
}
