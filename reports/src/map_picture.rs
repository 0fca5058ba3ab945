//! A map as a picture: its cells as PNG inside an SVG with scale, robots and the ways that they took.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use msg::GridView;
use msg::grid::trinary_table;
use std::fmt::Write as _;

/// Cells around the known area that are shown.
const BORDER_CELLS: usize = 8;
/// Lengths of the scale's bar, metres: the longest that is at most a quarter of the width is drawn.
const SCALES_M: [f64; 7] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0];
/// Radius of a robot, metres: a TurtleBot3 Burger's, drawn at least 4 pixels wide.
const ROBOT_RADIUS_M: f64 = 0.105;
const ROBOT_RADIUS_MIN_PX: f64 = 6.0;
/// Grey values of unknown, free and occupied cells.
const GREYS: [u8; 3] = [222, 255, 30];

/// The way of a robot through a map.
pub struct Trail {
    /// Name of the robot.
    pub name: String,
    /// Colour: red, green, blue.
    pub colour: [u8; 3],
    /// Poses in the map's frame: x m, y m, yaw rad. The last is where the robot is.
    pub poses: Vec<[f64; 3]>,
}

/// Part of a grid that is shown, in cells; the top and right ones are exclusive.
struct Window {
    left: usize,
    bottom: usize,
    right: usize,
    top: usize,
}

/// Returns the picture as SVG with a longer side of `side_px` pixels; a paragraph if nothing is known of the map.
pub fn map_picture(title: &str, map: GridView<'_>, trails: &[Trail], side_px: f64) -> String {
    let Some(window) = known_window(map) else {
        return format!("<p class=\"nodata\">{title}: no data</p>");
    };
    let Some(png) = encode(map, &window) else {
        return format!("<p class=\"nodata\">{title}: cannot be drawn</p>");
    };
    let (columns, rows) = (window.right - window.left, window.top - window.bottom);
    let px = side_px / columns.max(rows) as f64;
    let (width, height) = (columns as f64 * px, rows as f64 * px);
    let resolution = map.header.resolution_m;
    let to_px = |[x, y]: [f64; 2]| {
        let [cx, cy] = map.header.origin.inverse().apply([x, y]).map(|along| along / resolution);
        [(cx - window.left as f64) * px, height - (cy - window.bottom as f64) * px]
    };
    let mut svg = format!(
        "<svg class=\"map\" width=\"{width:.0}\" height=\"{:.0}\" viewBox=\"0 0 {width:.1} {:.1}\" \
         xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" aria-label=\"{title}\">\
         <image width=\"{width:.1}\" height=\"{height:.1}\" style=\"image-rendering:pixelated\" \
         href=\"data:image/png;base64,{}\"/>",
        height + 34.0,
        height + 34.0,
        STANDARD.encode(png)
    );
    for trail in trails {
        draw_trail(
            &mut svg,
            trail,
            (px / resolution * ROBOT_RADIUS_M).max(ROBOT_RADIUS_MIN_PX),
            to_px,
            map.header.origin.yaw_rad,
        );
    }
    draw_scale(&mut svg, width, height, px / resolution);
    svg + "</svg>"
}

fn draw_trail(
    svg: &mut String,
    trail: &Trail,
    radius: f64,
    to_px: impl Fn([f64; 2]) -> [f64; 2],
    map_yaw_rad: f64,
) {
    let [red, green, blue] = trail.colour;
    let colour = format!("rgb({red},{green},{blue})");
    let points: Vec<[f64; 2]> = trail.poses.iter().map(|[x, y, _]| to_px([*x, *y])).collect();
    // Writing to a string cannot fail.
    let text: Vec<String> = points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
    let _ = write!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\" stroke-opacity=\"0.75\" stroke-linejoin=\"round\"/>",
        text.join(" ")
    );
    let (Some([x, y]), Some([.., yaw])) = (points.last(), trail.poses.last()) else { return };
    // The picture's y axis points down.
    let (sin, cos) = (yaw - map_yaw_rad).sin_cos();
    let _ = write!(
        svg,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" fill=\"{colour}\" stroke=\"white\" stroke-width=\"1.5\"/>\
         <line x1=\"{x:.1}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"white\" stroke-width=\"2\"/>\
         <text x=\"{:.1}\" y=\"{:.1}\" font-size=\"13\" font-weight=\"600\" fill=\"{colour}\" stroke=\"white\" stroke-width=\"3\" paint-order=\"stroke\">{}</text>",
        x + radius * cos,
        y - radius * sin,
        x + radius + 3.0,
        y - radius,
        trail.name
    );
}

/// Draws the scale's bar below the picture.
fn draw_scale(svg: &mut String, width: f64, height: f64, px_per_m: f64) {
    let fits = |length: &&f64| **length * px_per_m <= width / 4.0;
    let length_m = SCALES_M.iter().rev().find(fits).copied().unwrap_or(SCALES_M[0]);
    let (x1, y) = (8.0 + length_m * px_per_m, height + 16.0);
    let _ = write!(
        svg,
        "<path d=\"M8 {0:.1}V{1:.1}H{x1:.1}V{0:.1}\" fill=\"none\" stroke=\"#333\" stroke-width=\"2\"/>\
         <text x=\"{2:.1}\" y=\"{3:.1}\" font-size=\"13\" fill=\"#333\">{length_m} m</text>",
        y - 5.0,
        y,
        x1 + 8.0,
        y + 3.0
    );
}

/// Returns the known cells with a border; `None` if there are none.
fn known_window(map: GridView<'_>) -> Option<Window> {
    let (width, height) = (map.header.width as usize, map.header.height as usize);
    let trinary = trinary_table();
    let is_known = |cell: &i8| trinary[usize::from(*cell as u8)] >= 0;
    let mut window: Option<Window> = None;
    for (y, row) in map.cells.chunks_exact(width.max(1)).enumerate() {
        let (Some(first), Some(last)) = (row.iter().position(is_known), row.iter().rposition(is_known))
        else {
            continue;
        };
        let seen = window.get_or_insert(Window { left: first, bottom: y, right: last + 1, top: y + 1 });
        (seen.left, seen.right, seen.top) = (seen.left.min(first), seen.right.max(last + 1), y + 1);
    }
    let Window { left, bottom, right, top } = window?;
    Some(Window {
        left: left.saturating_sub(BORDER_CELLS),
        bottom: bottom.saturating_sub(BORDER_CELLS),
        right: (right + BORDER_CELLS).min(width),
        top: (top + BORDER_CELLS).min(height),
    })
}

/// Encodes the window as PNG, its top row first.
fn encode(map: GridView<'_>, window: &Window) -> Option<Vec<u8>> {
    let trinary = trinary_table();
    let mut greys = Vec::with_capacity((window.right - window.left) * (window.top - window.bottom));
    for row in (window.bottom..window.top).rev() {
        let begin = row * map.header.width as usize;
        let cells = map.cells.get(begin + window.left..begin + window.right)?;
        greys.extend(cells.iter().map(|cell| match trinary[usize::from(*cell as u8)] {
            0 => GREYS[1],
            100 => GREYS[2],
            _ => GREYS[0],
        }));
    }
    let (width, height) = (window.right - window.left, window.top - window.bottom);
    formats::map_file::encode_grey_png(width as u32, height as u32, &greys).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::GridHeader;

    #[test]
    fn a_map_is_cut_to_what_is_known_and_one_without_cells_says_so() {
        let header = GridHeader { width: 60, height: 50, resolution_m: 0.05, ..GridHeader::default() };
        let mut cells = vec![-1_i8; 60 * 50];
        let view = GridView::new(&header, &cells).unwrap();
        assert!(map_picture("merged map", view, &[], 100.0).contains("no data"));
        (cells[20 * 60 + 30], cells[25 * 60 + 40]) = (-100, 100);
        let view = GridView::new(&header, &cells).unwrap();
        let window = known_window(view).unwrap();
        assert_eq!([window.left, window.right, window.bottom, window.top], [22, 49, 12, 34]);
        let trail =
            Trail { name: "robot1".into(), colour: [0, 0, 0], poses: vec![[1.5, 1.0, 0.0], [1.6, 1.0, 0.0]] };
        let svg = map_picture("merged map", view, &[trail], 100.0);
        assert!(
            svg.contains("data:image/png;base64,") && svg.contains("robot1") && svg.contains(" m</text>")
        );
    }
}
