//! Navigation of ground robots: maps, poses and scans in, velocities out.
//!
//! Pure: no clock, socket, file, thread or environment. Time comes in as a stamp with every observation, and the same
//! observations and seed give the same velocities.
//!
//! ```text
//!   FleetObservation ──▶ ExplorationTour ─────────────── one Explorer per robot ──────────────────▶ DriveCommand
//!   (map, poses, scans)                                                                              (velocity)
//!
//!   Explorer:  RobotMemory ─▶ ClearanceMap ─▶ RouteSearch ─▶ FrontierSearch ─▶ ExplorationPlanner
//!              (recent scans)  (obstacles)     (cheapest       (what is          (goal and path)
//!                                               routes)         unknown)               │
//!                                                        CollisionLimit ◀─ PathFollower ◀┘
//! ```
//!
//! [`Planner`] and [`PathFollower`] also serve goals that a person sets: plan a path to a point, follow it, and limit
//! the speed with [`CollisionLimit`].
//!
//! Units and frames are part of names: `_m`, `_rad`, `_s`; `map_from_base` is the pose of the robot's
//! `base_footprint` in the frame of the map. Points are `[x, y]`.

pub mod clearance_map;
pub mod collision;
pub mod command;
pub mod config;
pub mod exploration;
pub mod explorer;
pub mod follower;
pub mod frontier;
pub mod geometry;
pub mod memory;
pub mod observation;
pub mod path;
pub mod planner;
pub mod random;
pub mod route_search;
#[cfg(any(test, feature = "test-world"))]
pub mod test_world;
pub mod tour;
pub mod wander;

pub use clearance_map::ClearanceMap;
pub use collision::CollisionLimit;
pub use command::{DriveCommand, Twist};
pub use config::{ExplorationConfig, FollowerConfig, NavConfig, NavConfigError, RobotBody};
pub use exploration::{ExplorationGoal, ExplorationPlanner, GoalKind, GoalRequest};
pub use explorer::{ExplorationStats, Explorer, OtherRobots};
pub use follower::PathFollower;
pub use frontier::{Frontier, FrontierSearch};
pub use memory::RobotMemory;
pub use observation::{FleetObservation, MapView, RobotObservation, ScanView};
pub use path::{Path, Waypoint};
pub use planner::{PlanError, Planner, PlanningInput};
pub use random::RandomNumbers;
pub use route_search::RouteSearch;
pub use tour::{ExplorationTour, RobotTourStats, TourConfig};
