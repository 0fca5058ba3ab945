//! What the bridge publishes on the fleet's topics, seen by clients of the test's own process.

mod local;
mod maps;
mod names;
mod stopped;
