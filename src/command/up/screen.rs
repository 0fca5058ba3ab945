//! Display of a running fleet: a table that is redrawn on a terminal, or printed every 10 s into a log.

use super::report::Report;
use crate::command::output::{note, note_text};
use crate::run::Run;
use crate::view::FleetView;
use std::io::{IsTerminal, stderr};
use std::time::{Duration, Instant};

/// Period of the tables in a log.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// Period of the tables in the log of a fleet in the background, which may run for weeks: 0.3 MB a day.
const BACKGROUND_LOG_PERIOD: Duration = Duration::from_secs(600);

/// Terminal or log of the launcher. It writes to standard error; standard output is for results.
pub(super) struct Screen {
    live: bool,
    lines_shown: usize,
    logged: Option<Instant>,
    log_period: Duration,
}

impl Screen {
    /// Prints what is being started.
    pub fn new(run: &Run, in_background: bool) -> Self {
        let Run { dir, port, config, .. } = run;
        note(&format!(
            "fleet of {} robots in {}; headsets connect to port {port}; maps and report go to {}",
            config.fleet.robots,
            config.world_name(),
            dir.display()
        ));
        let log_period = if in_background { BACKGROUND_LOG_PERIOD } else { LOG_PERIOD };
        Self { live: stderr().is_terminal(), lines_shown: 0, logged: None, log_period }
    }

    /// Prints an event.
    pub fn show_event(&mut self, event: &str) {
        self.lines_shown = 0;
        note(&format!("! {event}"));
    }

    /// Shows the newest figures; `help` lists the keys that work.
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
            note_text(&format!("{up}{text}"));
            self.lines_shown = text.lines().count();
        } else if self.logged.is_none_or(|logged| logged.elapsed() >= self.log_period) {
            self.logged = Some(Instant::now());
            note(&format!("{clock}\n{}", fleet.table()));
        }
    }

    /// Prints the summary of the run.
    pub fn end(&mut self, report: &Report) {
        self.lines_shown = 0;
        note_text(&report.summary());
    }
}
