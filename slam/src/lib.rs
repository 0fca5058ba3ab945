//! Scans in, one robot's poses and map out
