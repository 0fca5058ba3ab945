//! Display of a running fleet: a table that is redrawn on a terminal, or printed every 10 s into a log.

use super::page;
use super::report::Report;
use crate::command::output::{note, note_text};
use crate::run::Run;
use reports::{Emphasis, FleetView, terminal};
use std::io::stderr;
use std::time::{Duration, Instant};

/// Period of the tables in a log.
const LOG_PERIOD: Duration = Duration::from_secs(10);
/// Period of the tables in the log of a fleet in the background, which may run for weeks: 0.3 MB a day.
const BACKGROUND_LOG_PERIOD: Duration = Duration::from_secs(600);
/// Age of the figures from which on the live table says so: they come once a second.
const FIGURES_AGE_MAX: Duration = Duration::from_secs(3);

/// Terminal or log of the launcher. It writes to standard error; standard output is for results.
pub(super) struct Screen {
    log_period: Duration,
    /// Size of the terminal at the last drawing, and the lines that it left on the screen.
    drawn: Option<((u16, u16), usize)>,
    /// Newest text on the terminal, and when its figures came.
    newest: Option<(String, Instant)>,
    /// Age of the figures that is shown, seconds.
    age_shown_s: u64,
    logged: Option<Instant>,
}

impl Screen {
    /// Prints what is being started.
    pub fn new(run: &Run, in_background: bool) -> Self {
        let Run { dir, port, config, .. } = run;
        note(&format!(
            "fleet of {} robots in {}; headsets connect to port {port}\nmaps and report go to {}",
            config.fleet.robots,
            config.world_name(),
            dir.display()
        ));
        let (size, is_coloured) = (terminal::size(&stderr()), terminal::style(&stderr()).is_coloured);
        page::describe(config, size, is_coloured).iter().for_each(|line| note(line));
        let log_period = if in_background { BACKGROUND_LOG_PERIOD } else { LOG_PERIOD };
        Self { log_period, drawn: None, newest: None, age_shown_s: 0, logged: None }
    }

    /// Prints an event above the table.
    pub fn show_event(&mut self, event: &str) {
        self.show_lines(&[format!("! {event}")]);
    }

    /// Prints lines, such as messages of processes, above the table.
    pub fn show_lines(&mut self, lines: &[String]) {
        match terminal::redrawn_size(&stderr()) {
            _ if lines.is_empty() => {}
            Some(size) => {
                let style = terminal::style(&stderr());
                let text = self.erase(size);
                note_text(&lines.iter().fold(text, |text, line| text + &style.wrap(line, 2)));
                self.draw(size);
            }
            None => lines.iter().for_each(|line| note(line)),
        }
    }

    /// Shows the newest figures; `help` lists the keys that work.
    pub fn show(&mut self, fleet: &FleetView, help: &str, elapsed: Duration, seconds: Option<f64>) {
        let elapsed = elapsed.as_secs_f64();
        let clock = seconds.map_or(format!("{elapsed:.0} s"), |s| format!("{elapsed:.0} of {s:.0} s"));
        if let Some(size) = terminal::redrawn_size(&stderr()) {
            let style = terminal::style(&stderr());
            let text = style.wrap(&format!("{clock}   {help}"), 2) + &fleet.live_table(&style);
            self.newest = Some((text, Instant::now()));
            self.age_shown_s = 0;
            let erase = self.erase(size);
            note_text(&erase);
            self.draw(size);
        } else if self.logged.is_none_or(|logged| logged.elapsed() >= self.log_period) {
            self.logged = Some(Instant::now());
            note(&format!("{clock}\n{}", fleet.live_table(&terminal::style(&stderr()))));
        }
    }

    /// Says in the live table when its figures are old.
    pub fn show_age(&mut self) {
        let Some((_, came)) = &self.newest else { return };
        let age = came.elapsed();
        let Some(size) = terminal::redrawn_size(&stderr()).filter(|_| age >= FIGURES_AGE_MAX) else { return };
        if age.as_secs() > self.age_shown_s {
            self.age_shown_s = age.as_secs();
            let erase = self.erase(size);
            note_text(&erase);
            self.draw(size);
        }
    }

    /// Returns what removes the last drawing from the terminal. After a change of its size, that is the whole screen:
    /// terminals differ in how they move lines then.
    fn erase(&mut self, size: (u16, u16)) -> String {
        match self.drawn.take() {
            Some((before, _)) if before != size => "\x1b[2J\x1b[H".into(),
            Some((_, lines)) if lines > 0 => format!("\x1b[{lines}A\r\x1b[J"),
            _ => String::new(),
        }
    }

    /// Draws the newest text, as many lines of it as fit.
    fn draw(&mut self, (columns, rows): (u16, u16)) {
        let Some((text, _)) = &self.newest else { return };
        let style = terminal::style(&stderr());
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        if self.age_shown_s > 0 {
            let age = style.paint(&format!("! figures are {} s old", self.age_shown_s), Emphasis::Alarm);
            lines.insert(0, age);
        }
        let room = usize::from(rows).saturating_sub(1).max(1);
        if lines.len() > room {
            let hidden = lines.len() - room + 1;
            lines.truncate(room - 1);
            lines.push(format!("({hidden} more lines: mr-slam status)"));
        }
        note_text(&(lines.join("\n") + "\n"));
        self.drawn = Some(((columns, rows), lines.len()));
    }

    /// Prints the summary of the run.
    pub fn end(&mut self, report: &Report) {
        // The summary has the newest figures.
        let erase = terminal::redrawn_size(&stderr()).map(|size| self.erase(size)).unwrap_or_default();
        note_text(&erase);
        self.newest = None;
        note_text(&report.summary(&terminal::style(&stderr())));
    }
}
