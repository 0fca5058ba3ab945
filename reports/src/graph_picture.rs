//! Graphs as SVG: boxes in columns with arrows between them, such as a tree of frames or processes and their channels.

use std::fmt::Write as _;

/// Width of a box, and distances between columns and rows, pixels.
const BOX_PX: [f64; 2] = [168.0, 24.0];
const COLUMN_PX: f64 = 224.0;
const ROW_PX: f64 = 34.0;
/// Border around the graph, pixels.
const BORDER_PX: f64 = 8.0;

/// A box of a graph.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphNode {
    /// Text in the box.
    pub name: String,
    /// Column, from the left.
    pub column: usize,
    /// Row, from the top; between two rows is possible.
    pub row: f64,
}

/// An arrow between boxes.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphEdge {
    /// Index of the box that it begins at.
    pub from: usize,
    /// Index of the box that it leads to.
    pub to: usize,
    /// What it stands for, shown under the pointer.
    pub label: String,
}

/// Returns the graph as SVG. Edges whose boxes are missing are left out. Says so if there is no box.
pub fn graph_picture(title: &str, nodes: &[GraphNode], edges: &[GraphEdge]) -> String {
    let title = escape(title);
    let columns = nodes.iter().map(|node| node.column).max();
    let Some(columns) = columns else { return format!("<p class=\"nodata\">{title}: no data</p>") };
    let rows = nodes.iter().map(|node| node.row).fold(0.0, f64::max);
    let width = columns as f64 * COLUMN_PX + BOX_PX[0] + 2.0 * BORDER_PX;
    let height = rows * ROW_PX + BOX_PX[1] + 2.0 * BORDER_PX;
    let corner =
        |node: &GraphNode| (BORDER_PX + node.column as f64 * COLUMN_PX, BORDER_PX + node.row * ROW_PX);
    let mut svg = format!(
        "<svg width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\" \
         xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" aria-label=\"{title}\" font-family=\"sans-serif\" font-size=\"12\">"
    );
    for GraphEdge { from, to, label } in edges {
        let (Some(a), Some(b)) = (nodes.get(*from), nodes.get(*to)) else { continue };
        let ((ax, ay), (bx, by)) = (corner(a), corner(b));
        let (ay, by) = (ay + BOX_PX[1] / 2.0, by + BOX_PX[1] / 2.0);
        // From the side that faces the other box; within a column, around its right side.
        let (ax, bx, bend) = match a.column.cmp(&b.column) {
            std::cmp::Ordering::Less => (ax + BOX_PX[0], bx, COLUMN_PX - BOX_PX[0]),
            std::cmp::Ordering::Greater => (ax, bx + BOX_PX[0], BOX_PX[0] - COLUMN_PX),
            std::cmp::Ordering::Equal => (ax + BOX_PX[0], bx + BOX_PX[0], COLUMN_PX - BOX_PX[0]),
        };
        let towards = if a.column == b.column { bx + bend } else { bx - bend };
        let side = if bx > towards { -5.0 } else { 5.0 };
        // Writing to a string cannot fail.
        let _ = write!(
            svg,
            "<g fill=\"none\" stroke=\"#789\"><title>{}</title>\
             <path d=\"M{ax:.1},{ay:.1} C{:.1},{ay:.1} {towards:.1},{by:.1} {bx:.1},{by:.1}\"/>\
             <path d=\"M{:.1},{:.1} L{bx:.1},{by:.1} L{:.1},{:.1}\"/></g>",
            escape(label),
            ax + bend,
            bx + side,
            by - 4.0,
            bx + side,
            by + 4.0
        );
    }
    for node in nodes {
        let (x, y) = corner(node);
        let _ = write!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{}\" height=\"{}\" rx=\"5\" fill=\"#f4f6f8\" stroke=\"#567\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            BOX_PX[0],
            BOX_PX[1],
            x + BOX_PX[0] / 2.0,
            y + 16.0,
            escape(&node.name)
        );
    }
    svg + "</svg>"
}

/// Replaces characters that mean something in SVG.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Places the boxes of a tree: leaves below each other, a parent in the middle of its children. `parents` has the index
/// of each box's parent, which stands before it; `None` for a root.
pub fn tree_picture(title: &str, names: &[String], parents: &[Option<usize>], labels: &[String]) -> String {
    let count = names.len().min(parents.len());
    let mut nodes: Vec<GraphNode> = Vec::with_capacity(count);
    for (index, name) in names.iter().take(count).enumerate() {
        let parent = parents[index].filter(|parent| *parent < index).and_then(|parent| nodes.get(parent));
        let column = parent.map_or(0, |parent| parent.column + 1);
        nodes.push(GraphNode { name: name.clone(), column, row: f64::NAN });
    }
    // Depth first from the last to the first would turn the order around: rows of leaves are given in order of the boxes.
    let has_child = |index: usize| parents.iter().take(count).any(|parent| *parent == Some(index));
    let mut row = 0.0;
    for (index, node) in nodes.iter_mut().enumerate() {
        if !has_child(index) {
            (node.row, row) = (row, row + 1.0);
        }
    }
    for index in (0..count).rev().filter(|index| has_child(*index)) {
        let children =
            (0..count).filter(|child| parents[*child] == Some(index)).map(|child| nodes[child].row);
        let (least, most) = children
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), row| (least.min(row), most.max(row)));
        nodes[index].row = (least + most) / 2.0;
    }
    let edge = |to: usize| {
        let from = parents[to].filter(|from| *from < to)?;
        Some(GraphEdge { from, to, label: labels.get(to).cloned().unwrap_or_default() })
    };
    graph_picture(title, &nodes, &(0..count).filter_map(edge).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parent_is_in_the_middle_of_its_children_and_names_are_text() {
        let names = ["map", "<a>", "b", "c"].map(str::to_owned);
        let svg = tree_picture("frames", &names, &[None, Some(0), Some(0), Some(1)], &[]);
        assert!(svg.contains("&lt;a&gt;") && !svg.contains("<a>"), "{svg}");
        assert_eq!(svg.matches("<rect").count(), 4);
        assert_eq!(svg.matches("<title>").count(), 3);
        // The leaves b and c are in rows 0 and 1; `map` is between b and the parent of c.
        assert!(svg.contains(&format!("y=\"{:.1}\" width", BORDER_PX + ROW_PX / 2.0)), "{svg}");
        assert!(graph_picture("none", &[], &[]).contains("no data"));
    }
}
