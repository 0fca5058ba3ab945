//! Reports for people: one HTML file that needs nothing else, with maps, plots and tables.

mod html;
mod map_picture;
mod plots;
mod series;

pub use html::{Page, Row};
pub use map_picture::{Trail, map_picture};
pub use plots::{Group, Line, line_plot, quantile_plot};
pub use series::{RobotSeries, Series};

/// Returns the colour of a robot, by its index: that of its way in map pictures.
pub fn colour(index: usize) -> formats::map_file::Rgb {
    formats::map_file::Picture::robot_colour(index)
}
