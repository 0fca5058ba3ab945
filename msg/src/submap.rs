//! Pieces of one robot's map that are rigid enough to be moved as a whole, and what is known of
//! how they lie to each other: what a joint pose graph of several robots is made of.

use crate::{GridHeader, GridView, Header, Message, Pose2};
use bytemuck::{Pod, Zeroable};

/// The most submaps a robot has: at 20 nodes each and a node each 0.3 m, 1.5 km of driving.
pub const SUBMAPS_MAX: usize = 256;
/// The most relations between a robot's submaps.
pub const SUBMAP_EDGES_MAX: usize = 2048;
/// Cells along a submap's side at most: 25.6 m at 0.05 m. What lies beyond is cut off.
pub const SUBMAP_SIDE_MAX: u32 = 512;
/// The most cells of a submap.
pub const SUBMAP_CELLS_MAX: usize = (SUBMAP_SIDE_MAX * SUBMAP_SIDE_MAX) as usize;

/// A piece of a robot's map, drawn in its own frame: that of its first node.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Submap {
    /// `origin` is in the submap's frame. Read cells by [`Submap::view`].
    pub grid: GridHeader,
    /// Counts the robot's submaps from 0 without gaps.
    pub id: u32,
    /// The first of the pose graph's nodes drawn in.
    pub first_node: u32,
    /// How many nodes are drawn in.
    pub nodes: u32,
    /// 1: no more nodes will be added (it may yet be redrawn), 0: it grows.
    pub finished: u32,
    /// Counts how often this SLAM began its submaps anew: of two with different counts, the ids mean nothing to each
    /// other.
    pub generation: u32,
    /// Zero.
    pub reserved: u32,
    /// Row-major evidence; read it by [`Submap::view`].
    pub cells: [i8; SUBMAP_CELLS_MAX],
}

impl Submap {
    /// The grid; `None` if its header makes no sense.
    pub fn view(&self) -> Option<GridView<'_>> {
        let size = (self.grid.width as usize).checked_mul(self.grid.height as usize)?;
        GridView::new(&self.grid, self.cells.get(..size)?)
    }

    /// Takes a grid over; what is farther than half of [`SUBMAP_SIDE_MAX`] from its middle is cut off.
    pub fn set_grid(&mut self, grid: GridView<'_>) {
        let kept = |size: u32| {
            let kept = size.min(SUBMAP_SIDE_MAX);
            ((size - kept) / 2, kept)
        };
        let ((left, width), (below, height)) = (kept(grid.header.width), kept(grid.header.height));
        let corner = |cells: u32| f64::from(cells) * grid.header.resolution_m;
        let origin = grid.header.origin * Pose2::new(corner(left), corner(below), 0.0);
        self.grid = GridHeader { origin, width, height, ..*grid.header };
        let rows = grid.cells.chunks_exact((grid.header.width as usize).max(1));
        for (row, to) in rows.skip(below as usize).zip(self.cells.chunks_exact_mut((width as usize).max(1))) {
            to.copy_from_slice(&row[left as usize..(left + width) as usize]);
        }
    }
}

impl Message for Submap {
    const NAME: &'static str = "msg::Submap";
    fn header(&self) -> &Header {
        &self.grid.header
    }
    fn header_mut(&mut self) -> &mut Header {
        &mut self.grid.header
    }
}

/// How well two submaps of one robot are known to each other.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SubmapEdge {
    /// The submap it is seen from.
    pub a: u32,
    /// The submap that is seen, `a < b`. Where it lies is said by the poses.
    pub b: u32,
    /// Inverse covariance over (x, y, yaw) in `a`, row-major upper triangle; m, rad.
    pub information: [f64; 6],
}

/// Where a robot's submaps lie in its map, as its pose graph has it now.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SubmapPoses {
    /// `stamp` is the newest node's.
    pub header: Header,
    /// How many of `robot_map_from_submap` are set. Read them by [`SubmapPoses::poses`].
    pub len: u32,
    /// How many of `edges` are set. Read them by [`SubmapPoses::edges`].
    pub edges_len: u32,
    /// As [`Submap::generation`].
    pub generation: u32,
    /// Zero.
    pub reserved: u32,
    /// `robotK/map` from each submap.
    pub robot_map_from_submap: [Pose2; SUBMAPS_MAX],
    /// Relations that the robot's own graph supports.
    pub edges: [SubmapEdge; SUBMAP_EDGES_MAX],
}

impl SubmapPoses {
    /// `robotK/map` from each submap, by its id.
    pub fn poses(&self) -> &[Pose2] {
        &self.robot_map_from_submap[..(self.len as usize).min(SUBMAPS_MAX)]
    }

    /// Relations between submaps.
    pub fn edges(&self) -> &[SubmapEdge] {
        &self.edges[..(self.edges_len as usize).min(SUBMAP_EDGES_MAX)]
    }
}

impl Message for SubmapPoses {
    const NAME: &'static str = "msg::SubmapPoses";
    fn header(&self) -> &Header {
        &self.header
    }
    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }
}

/// Who lacks a robot's submaps asks for all of them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SubmapRequest {
    /// When it was asked.
    pub header: Header,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_grid_is_cut_about_its_middle() {
        let header = GridHeader {
            resolution_m: 0.05,
            width: 600,
            height: 3,
            origin: Pose2::new(1.0, 2.0, 0.0),
            ..Default::default()
        };
        let cells: Vec<i8> = (0..1800).map(|i| (i % 100) as i8).collect();
        let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
        submap.set_grid(GridView { header: &header, cells: &cells });
        let view = submap.view().unwrap();
        assert_eq!((view.header.width, view.header.height), (512, 3));
        assert_eq!(view.cell(0, 0), 44);
        assert_eq!(view.cell(511, 2), cells[1200 + 555]);
        let [x, y] = view.centre_m(0, 0);
        assert!((x - (1.0 + 44.5 * 0.05)).abs() < 1e-9 && (y - 2.025).abs() < 1e-9);
    }

    #[test]
    fn lengths_are_never_trusted() {
        let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
        submap.grid.resolution_m = 0.05;
        (submap.grid.width, submap.grid.height) = (u32::MAX, u32::MAX);
        assert!(submap.view().is_none());
        let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
        (poses.len, poses.edges_len) = (u32::MAX, u32::MAX);
        assert_eq!((poses.poses().len(), poses.edges().len()), (SUBMAPS_MAX, SUBMAP_EDGES_MAX));
    }
}
