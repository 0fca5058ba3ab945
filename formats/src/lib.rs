//! File formats that the robots' data is read from and written to.
//!
//! | module | format |
//! |---|---|
//! | [`carmen`] | CARMEN logs: odometry and laser scans as lines of text |
//! | [`map_file`] | occupancy grids as ROS's map_server reads them: YAML with a PGM or PNG image |
//! | [`gzip`] | gzip streams, unpacked up to a limit |
//! | [`folder`] | folders for results |
//! | [`atomic`] | files that appear whole or not at all |
//! | [`overwriting`] | results that would replace what they are made of |
//!
//! Whatever the bytes, a reader ends with a sound value or an error, in bounded memory. The crate opens and writes
//! files, but knows no clock, socket, thread or environment variable. The session format of SLAM is
//! `slam::Session`: it is made of that crate's private types.

pub mod atomic;
pub mod bag_folder;
pub mod carmen;
pub mod folder;
pub mod gzip;
pub mod limited;
pub mod map_file;
pub mod overwriting;
pub mod recording_folder;
pub mod regular;
pub mod tum;
