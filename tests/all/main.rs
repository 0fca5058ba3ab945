//! Tests of the real binary and of whole fleets. They are one target, so that it links once.
//!
//! Every test has its own names in shared memory and its own port. Tests therefore run in parallel, also
//! with another run of the same tests.

mod access;
mod channels;
mod command_line;
mod config;
mod default_config;
mod documents;
mod edges;
mod emergency_stop;
mod ended_fleet;
mod evidence;
mod experiment;
mod exploration;
mod faults;
mod fleet;
mod glossary;
mod harness;
mod headset;
mod headset_app;
mod interruptions;
mod json_output;
mod killed_slam;
mod layering;
mod lockstep;
mod malformed;
mod map_rooms;
mod maps;
mod moving_objects;
mod navigation;
mod page;
mod peers;
mod recording;
mod recording_files;
mod relation_metric;
mod restart;
mod ros_package;
mod served_replay;
mod services;
mod sessions;
mod sources;
mod tidy;
