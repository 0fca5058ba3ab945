//! What the bridge publishes on the fleet's topics, seen by clients of the test's own process.

mod latched;
mod local;
mod maps;
mod names;
mod stopped;
