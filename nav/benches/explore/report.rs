//! Tables and JSON of the runs.

use crate::methods::Kind;
use crate::run::{Outcome, SHARES};
use crate::world::Starts;
use serde_json::{Value, json};

/// One line about a run, while the bench goes on.
pub fn line(outcome: &Outcome) -> String {
    let case = &outcome.case;
    let time = |time: Option<f64>| time.map_or("-".to_owned(), |s| format!("{s:.0}"));
    let [t90, t95, t99] = outcome.times_s.map(time);
    let mut line = format!(
        "{:<10}{:>3} {:?} {:<12} seed {:>3}: T90 {t90:>5} T95 {t95:>5} T99 {t99:>5} s, {:.2} % after {:.0} s ({}), {:.0} m, \
         {} contacts, {:.2} m apart, stood {:.0} s, {} plans, {:.1}+{:.1} ms/s, longest {:.0} ms",
        case.room.name(),
        case.robots,
        case.starts,
        case.method.name(),
        case.seed,
        outcome.coverage * 100.0,
        outcome.end_s,
        outcome.stopped_by,
        outcome.travelled_m,
        outcome.contacts.len(),
        outcome.separation_m,
        outcome.stood_s,
        outcome.plans,
        outcome.choose_ms,
        outcome.drive_ms,
        outcome.longest_choice_ms,
    );
    for contact in &outcome.contacts {
        line += &format!("\n    {contact}");
    }
    if outcome.times_s[2].is_none() {
        for left in &outcome.leftovers {
            line += &format!("\n    {left}");
        }
    }
    line
}

/// Figures of all runs of one method under the same conditions.
struct Summary {
    runs: usize,
    /// Mean and standard deviation of each time, seconds; runs that did not get there count with their end.
    times_s: [(f64, f64); 3],
    reached: usize,
    travelled_m: f64,
    overlap: f64,
    contacts: usize,
    /// Longest time in which no robot left its place, of all runs, seconds.
    stood_s: f64,
    cpu_ms: f64,
    plans: f64,
}

fn summarize<'a>(outcomes: impl Iterator<Item = &'a Outcome>) -> Option<Summary> {
    let outcomes: Vec<&Outcome> = outcomes.collect();
    let count = outcomes.len() as f64;
    if outcomes.is_empty() {
        return None;
    }
    let mean = |value: &dyn Fn(&Outcome) -> f64| outcomes.iter().map(|o| value(o)).sum::<f64>() / count;
    let times_s = [0, 1, 2].map(|i| {
        let time = |o: &Outcome| o.times_s[i].unwrap_or(o.case.limit_s as f64);
        let middle = mean(&time);
        (middle, mean(&|o| (time(o) - middle).powi(2)).sqrt())
    });
    Some(Summary {
        runs: outcomes.len(),
        times_s,
        reached: outcomes.iter().filter(|o| o.times_s[2].is_some()).count(),
        travelled_m: mean(&|o| o.travelled_m),
        overlap: mean(&|o| o.overlap),
        contacts: outcomes.iter().map(|o| o.contacts.len()).sum(),
        stood_s: outcomes.iter().map(|o| o.stood_s).fold(0.0, f64::max),
        cpu_ms: mean(&|o| o.choose_ms + o.drive_ms),
        plans: mean(&|o| f64::from(o.plans)),
    })
}

/// Prints a table of means, and the ratios to the baselines.
pub fn print(outcomes: &[Outcome]) {
    let mut groups: Vec<(&str, usize, Starts)> = Vec::new();
    for outcome in outcomes {
        let group = (outcome.case.room.name(), outcome.case.robots, outcome.case.starts);
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    println!(
        "{:<10}{:>6} {:<5}{:<12}{:>5}{:>12}{:>12}{:>12}{:>6}{:>8}{:>8}{:>9}{:>8}{:>7}{:>8}",
        "world",
        "robots",
        "start",
        "method",
        "runs",
        "T90 s",
        "T95 s",
        "T99 s",
        "99 %",
        "travel",
        "overlap",
        "contacts",
        "stood s",
        "plans",
        "ms/s"
    );
    for group in &groups {
        for kind in Kind::ALL {
            let is_in = |o: &&Outcome| {
                (o.case.room.name(), o.case.robots, o.case.starts) == *group && o.case.method == kind
            };
            print_row(group.0, group.1, group.2, kind, outcomes.iter().filter(is_in));
        }
    }
    print_all(outcomes);
}

fn print_row<'a>(
    world: &str,
    robots: usize,
    starts: Starts,
    kind: Kind,
    outcomes: impl Iterator<Item = &'a Outcome>,
) -> Option<f64> {
    let summary = summarize(outcomes)?;
    let [t90, t95, t99] = summary.times_s.map(|(mean, deviation)| format!("{mean:.0}±{deviation:.0}"));
    println!(
        "{world:<10}{robots:>6} {:<5}{:<12}{:>5}{t90:>12}{t95:>12}{t99:>12}{:>6}{:>8.0}{:>8.2}{:>9}{:>8.0}{:>7.0}{:>8.1}",
        format!("{starts:?}").to_lowercase(),
        kind.name(),
        summary.runs,
        summary.reached,
        summary.travelled_m,
        summary.overlap,
        summary.contacts,
        summary.stood_s,
        summary.plans,
        summary.cpu_ms,
    );
    Some(summary.times_s[1].0)
}

/// Prints the means over all worlds, and the ratios of T95: each world counts as much.
fn print_all(outcomes: &[Outcome]) {
    let mut fleets: Vec<(usize, Starts)> = Vec::new();
    for outcome in outcomes {
        let fleet = (outcome.case.robots, outcome.case.starts);
        if !fleets.contains(&fleet) {
            fleets.push(fleet);
        }
    }
    for (robots, starts) in fleets {
        for kind in Kind::ALL {
            let is_in =
                |o: &&Outcome| (o.case.robots, o.case.starts) == (robots, starts) && o.case.method == kind;
            print_row("all", robots, starts, kind, outcomes.iter().filter(is_in));
        }
        for ours in [Kind::Navigated, Kind::Coordinated] {
            for baseline in [Kind::Burgard, Kind::Greedy, Kind::Tour] {
                let ratio = |i: usize| {
                    let ratio = mean_ratio(outcomes, (robots, starts), (ours, baseline), i)?;
                    Some(format!("T{:.0} {ratio:.2}", SHARES[i] * 100.0))
                };
                let ratios: Vec<String> = (0..SHARES.len()).filter_map(ratio).collect();
                if !ratios.is_empty() {
                    println!("    {} / {}: {}", ours.name(), baseline.name(), ratios.join(", "));
                }
            }
        }
    }
}

/// Mean over worlds and seeds of the ratio of a time to a baseline's in the same run.
fn mean_ratio(
    outcomes: &[Outcome],
    fleet: (usize, Starts),
    (ours, baseline): (Kind, Kind),
    time: usize,
) -> Option<f64> {
    let of = |kind: Kind| {
        outcomes.iter().filter(move |o| (o.case.robots, o.case.starts) == fleet && o.case.method == kind)
    };
    let seconds = |o: &Outcome| o.times_s[time].unwrap_or(o.case.limit_s as f64);
    let ratios: Vec<f64> = of(ours)
        .filter_map(|ours| {
            let is_same = |o: &&Outcome| (o.case.room, o.case.seed) == (ours.case.room, ours.case.seed);
            of(baseline).find(is_same).map(|theirs| seconds(ours) / seconds(theirs))
        })
        .collect();
    (!ratios.is_empty()).then(|| ratios.iter().sum::<f64>() / ratios.len() as f64)
}

/// All runs as JSON.
pub fn json(outcomes: &[Outcome]) -> String {
    let run = |o: &Outcome| -> Value {
        json!({
            "world": o.case.room.name(), "seed": o.case.seed, "robots": o.case.robots,
            "starts": format!("{:?}", o.case.starts).to_lowercase(), "method": o.case.method.name(),
            "t90_s": o.times_s[0], "t95_s": o.times_s[1], "t99_s": o.times_s[2], "end_s": o.end_s,
            "coverage": o.coverage, "travelled_m": o.travelled_m, "overlap": o.overlap, "contacts": o.contacts.len(), "contact_places": o.contacts,
            "separation_m": o.separation_m.is_finite().then_some(o.separation_m), "stood_s": o.stood_s,
            "plans": o.plans,
            "path_plans": o.path_plans, "choose_ms_per_robot_s": o.choose_ms, "drive_ms_per_robot_s": o.drive_ms,
            "longest_choice_ms": o.longest_choice_ms, "stopped_by": o.stopped_by, "leftovers": o.leftovers,
        })
    };
    let runs: Vec<Value> = outcomes.iter().map(run).collect();
    serde_json::to_string_pretty(&json!({ "runs": runs })).unwrap_or_default()
}
