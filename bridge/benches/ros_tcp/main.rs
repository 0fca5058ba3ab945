//! Costs of the ros_tcp server over loopback: latency and jitter of the fleet's messages, rates, maps, velocities written
//! as Unity's connector writes them, and abrupt reconnects.
//!
//! `cargo bench -p bridge` runs all of it; `-- mix commands rates maps storm` selects parts. Server and clients are
//! threads of one process, so that their wake-ups are in the figures. "bare" is the same bytes over a plain socket
//! between the same two threads: the machine's own share.

mod client;
mod commands;
mod maps;
mod measure;
mod mix;
mod rates;
mod server;
mod storm;

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let is_wanted = |name: &str| wanted.is_empty() || wanted.iter().any(|word| name.contains(word.as_str()));
    if is_wanted("mix") {
        mix::mix(10);
    }
    if is_wanted("commands") {
        commands::bare_wake_up();
        commands::command_in(false);
        commands::command_in(true);
    }
    if is_wanted("rates") {
        [10_000, 50_000, 100_000].into_iter().for_each(rates::rate_out);
        rates::relay(1_000_000);
    }
    if is_wanted("maps") {
        maps::large_map();
    }
    if is_wanted("storm") {
        storm::storm(10_000);
    }
}
