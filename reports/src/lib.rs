//! What a fleet did, for people and programs: tables and JSON of its figures, and one HTML file with maps and plots.
//!
//! Figures and maps come in, texts go out: no clock, file, socket or thread.

mod bridge_state;
mod commands;
mod events;
mod exploration;
mod graph_picture;
mod html;
mod map_picture;
mod moving_objects;
mod navigation;
mod plots;
mod scan_rates;
mod series;
mod system;
pub mod terminal;
mod view;
mod workload;

pub use bridge_state::BridgeState;
pub use commands::{edge_command_json, navigation_command_json, operator_event_json, slam_request_json};
pub use events::{Event, Events};
pub use exploration::{ExplorationSummary, known_area};
pub use graph_picture::{GraphEdge, GraphNode, graph_picture, tree_picture};
pub use html::{Page, Row};
pub use map_picture::{Trail, map_picture};
pub use moving_objects::moving_objects_json;
pub use navigation::{ExplorationView, NavigationView, RobotNavigationView};
pub use plots::{Group, Line, line_plot, plot_over, quantile_plot};
pub use scan_rates::ScanRates;
pub use series::{DrivenTime, RobotSeries, Series, TeleoperationProfile, add_teleoperation};
pub use system::{frame_tree, process_graph};
pub use view::{
    AgainstRoomView, AlignedView, ClosureView, DistributionView, EdgeView, Emphasis, FleetView, MapView,
    ProcessView, RobotView, SlamView, Style, edge_table, edges_json,
};
pub use workload::{TlxEntry, add_workload};

/// Returns the colour of a robot, by its index: that of its way in map pictures.
pub fn colour(index: usize) -> formats::map_file::Rgb {
    formats::map_file::Picture::robot_colour(index)
}
