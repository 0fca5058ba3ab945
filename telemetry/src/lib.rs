//! Health, statistics and metrics of the fleet
