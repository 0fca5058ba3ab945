//! The maps of all robots in, one map and where each robot's map lies out
