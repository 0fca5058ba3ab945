//! The one binary of MR-SLAM.
fn main() {}
