//! The real binary and the whole fleet, from outside. One target, so that it links once.
//!
//! Every test has its own names in shared memory and its own port, so that tests run beside each
//! other and beside another run of the same tests.

mod channels;
mod command_line;
mod config;
mod default_config;
mod doors;
mod edges;
mod fleet;
mod harness;
mod headset;
mod layering;
mod lockstep;
mod malformed;
mod maps;
mod peers;
mod relation_metric;
mod restart;
mod services;
mod sessions;
