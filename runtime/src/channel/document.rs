//! The tables of channels and processes as Markdown, for ARCHITECTURE.md.

use super::{CHANNELS, ChannelRow, Endpoint, Program, Scope};
use crate::processes::PROCESSES;
use msg::Role;
use std::collections::BTreeMap;
use std::fmt::Write;

/// The line of ARCHITECTURE.md after which the generated chapter begins.
pub const BEGIN: &str =
    "<!-- generated from runtime/src/channel/table.rs and runtime/src/processes.rs: begin -->";
/// The line of ARCHITECTURE.md before which it ends.
pub const END: &str = "<!-- generated: end -->";

/// Lists the ends of a channel, for people.
pub(super) fn list(ends: &[Endpoint]) -> String {
    ends.iter().map(Endpoint::to_string).collect::<Vec<_>>().join(", ")
}

/// Returns the chapter: a picture, the table of processes and the table of channels.
pub fn chapter() -> String {
    format!("{}\n{}\n{}", picture(), process_table(), channel_table())
}

/// Returns the processes and their channels as a Mermaid flowchart.
fn picture() -> String {
    let mut text = String::from("```mermaid\nflowchart LR\n");
    for program in [Role::Sim, Role::Slam].map(Program::from) {
        let _ = writeln!(text, "    {0}[\"{0}(k)\"]", program.name());
    }
    for (from, to, names) in arrows() {
        let _ = writeln!(text, "    {from} -->|\"{}\"| {to}", names.join(", "));
    }
    text + "```\n"
}

/// Returns the fleet's programs that exchange messages: the writer, the reader, and the channels between them.
pub fn arrows() -> Vec<(&'static str, &'static str, Vec<&'static str>)> {
    let mut arrows: BTreeMap<(Program, Program), Vec<&str>> = BTreeMap::new();
    for row in CHANNELS.into_iter().filter(|row| row.scope != Scope::Process) {
        for (from, to) in arrows_of(row) {
            arrows.entry((from, to)).or_default().push(row.name);
        }
    }
    arrows.into_iter().map(|((from, to), names)| (from.name(), to.name(), names)).collect()
}

/// Returns the arrows of a channel between programs of the fleet itself.
fn arrows_of(row: &ChannelRow) -> impl Iterator<Item = (Program, Program)> {
    let drawn = |end: &&Endpoint| !matches!(end, Endpoint::External(_) | Endpoint::OtherMachines(_));
    let ends = |ends: &'static [Endpoint]| ends.iter().filter(drawn).map(|end| end.program());
    let readers: Vec<_> = ends(row.readers).filter(|program| !program.is_tool()).collect();
    let writers: Vec<_> = ends(row.writers).filter(|program| !program.is_tool()).collect();
    writers.into_iter().flat_map(move |from| readers.clone().into_iter().map(move |to| (from, to)))
}

fn process_table() -> String {
    let mut text =
        String::from("| process | one for each | command | started again with |\n|---|---|---|---|\n");
    for row in &PROCESSES {
        let each = if row.per_robot { "robot" } else { "fleet" };
        let each = if row.simulated_world_only { "simulated robot" } else { each };
        let each = if row.recording_only { "recorded fleet" } else { each };
        let each = if row.moving_objects_only { "fleet whose room has moving objects" } else { each };
        let _ = writeln!(
            text,
            "| {} | {each} | `mr-slam worker {}` | {} |",
            row.role.name(),
            row.role.name(),
            row.restart_input
        );
    }
    text + "\nWhere robots and base are on several machines, each machine has the process `link` (`mr-slam link`) in addition, which\n\
            exchanges messages with the other machines.\n"
}

fn channel_table() -> String {
    let mut text = String::from(
        "| channel | message | writers | readers | depth | history | wakes | content |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for row in CHANNELS {
        let name = match row.scope {
            Scope::Fleet => row.name.to_string(),
            Scope::Robot => format!("robotK/{}", row.name),
            Scope::Process => format!("PROCESS/{}", row.name),
        };
        let writers = if row.scope == Scope::Process { "each process".into() } else { list(row.writers) };
        let message = row.message.trim_start_matches("msg::");
        let wakes = if row.wakes { "yes" } else { "no" };
        let _ = writeln!(
            text,
            "| `{name}` | {message} | {writers} | {} | {} | {} | {wakes} | {} |",
            list(row.readers),
            row.depth,
            row.history,
            row.content
        );
    }
    text + "\n\\* With `world = \"headset\"` or `\"ros\"` the bridge writes what the simulators write, but for the truth.\n\
            With `\"ros\"` it also passes commands on to ROS 2.\n\
            \n\\*\\* Where robots and base are on several machines: at the base the link writes what it gets from the robots' \
            links\nand `hold`, and reads `command`, `scan_demand` and `submap_request`. On a robot's machine it reads what it sends to the \
            base, and\nwrites `base_velocity` and `submap_request`.\n"
}
