//! CARMEN logs: the text format of the public 2D LiDAR data sets.
