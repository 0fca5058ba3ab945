//! One robot in a room: commands in, scans, odometry and truth out
