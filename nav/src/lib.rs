//! Navigation of ground robots, which computes velocities from maps, poses and scans.
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
//! [`FleetCoordinator`] gives each robot of a fleet a goal of exploration instead: see [`coordination`].
//!
//! [`Planner`], [`PathFollower`] and [`CollisionLimit`] also serve goals that a person sets:
//!
//! ```
//! use msg::{Pose2, Stamp};
//! use nav::observation::BURGER_BASE_FROM_SCAN;
//! use nav::{CollisionLimit, MapView, NavConfig, PathFollower, Planner, PlanningInput, ScanView};
//!
//! let config = NavConfig::default();
//! let free_space = vec![0; 40 * 40];
//! let map = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &free_space).unwrap();
//! let map_from_base = Pose2::new(0.5, 1.0, 0.0);
//! let path = Planner::new(config.body)
//!     .plan_path(&PlanningInput::new(map, map_from_base), [1.5, 1.0])
//!     .unwrap();
//!
//! // One control step: follow the path, and slow down for an obstacle that the scan shows 0.3 m ahead.
//! let mut follower = PathFollower::new(config.follower);
//! let twist = follower.follow(&path, map_from_base, config.follower.cruise_m_s).unwrap();
//! let scan = ScanView {
//!     received: Stamp(0),
//!     base_from_scan: BURGER_BASE_FROM_SCAN,
//!     angle_min_rad: 0.0,
//!     angle_increment_rad: 0.01,
//!     range_min_m: 0.12,
//!     range_max_m: 3.5,
//!     ranges_m: &[0.3],
//! };
//! let limit = CollisionLimit::new(config.body, config.follower);
//! let safe = limit.limit_speed(twist, limit.free_distance_m(&scan));
//! assert!(twist.linear_m_s > 0.1 && safe.linear_m_s < 0.1);
//! ```
//!
//! Units and frames are part of names: `_m`, `_rad`, `_s`; `map_from_base` is the pose of the robot's
//! `base_footprint` in the frame of the map. Points are `[x, y]`.

pub mod backing_up;
pub mod clearance_map;
pub mod collision;
pub mod command;
pub mod config;
pub mod coordination;
pub mod exploration;
pub mod explorer;
pub mod follower;
pub mod frontier;
pub mod geometry;
pub mod memory;
pub mod navigation;
pub mod observation;
mod obstacles;
pub mod path;
pub mod planner;
pub mod random;
pub mod route_search;
#[cfg(any(test, feature = "test-world"))]
pub mod test_world;
pub mod tour;
pub mod wander;

pub use backing_up::{BACK_UP, BackingUp, back_up_distance_m};
pub use clearance_map::ClearanceMap;
pub use collision::CollisionLimit;
pub use command::{DriveCommand, Twist};
pub use config::{ExplorationConfig, FollowerConfig, NavConfig, NavConfigError, RobotBody};
pub use coordination::{CoordinationConfig, FleetCoordinator, FleetExploration};
pub use exploration::{ExplorationGoal, ExplorationPlanner, GoalKind, GoalRequest};
pub use explorer::{ExplorationStats, Explorer, OtherRobots};
pub use follower::PathFollower;
pub use frontier::{Frontier, FrontierSearch};
pub use memory::RobotMemory;
pub use navigation::{
    FleetNavigator, GoalFrame, GoalPose, LocalizationUncertainty, NavigatedRobot, NavigationFailure,
    NavigationGoal, NavigationInput, NavigationState, NavigatorConfig,
};
pub use observation::{FleetObservation, MapView, RobotObservation, ScanView};
pub use path::{Path, Waypoint};
pub use planner::{PlanError, Planner, PlanningInput};
pub use random::RandomNumbers;
pub use route_search::RouteSearch;
pub use tour::{ExplorationTour, RobotTourStats, TourConfig};
