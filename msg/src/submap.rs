//! Submaps, the parts of a robot's map that move as rigid bodies, with their poses and relations.
//!
//! The pose graph of a fleet consists of the submaps of all robots.

use crate::{GridHeader, GridView, Header, Message, Pose2};
use bytemuck::{Pod, Zeroable};

/// Largest number of a robot's submaps: with 20 nodes each and a node every 0.3 m, 1.5 km of driving.
pub const SUBMAPS_MAX: usize = 256;
/// Largest number of relations between a robot's submaps.
pub const SUBMAP_EDGES_MAX: usize = 2048;
/// Largest number of cells along a submap's side: 25.6 m at 0.05 m. Cells beyond are cut off.
pub const SUBMAP_SIDE_MAX: u32 = 512;
/// Largest number of cells of a submap.
pub const SUBMAP_CELLS_MAX: usize = (SUBMAP_SIDE_MAX * SUBMAP_SIDE_MAX) as usize;

/// Part of a robot's map, in a frame of its own: that of its first node.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Submap {
    /// Header of the grid, whose `origin` is in the submap's frame. Read the cells by [`Submap::view`].
    pub grid: GridHeader,
    /// Number of the submap among the robot's submaps, from 0 without gaps.
    pub id: u32,
    /// Number of the first pose-graph node in the submap.
    pub first_node: u32,
    /// Number of nodes in the submap.
    pub nodes: u32,
    /// 1 if the submap gets no more nodes (it may still be redrawn), 0 if it grows.
    pub finished: u32,
    /// Number of times that this SLAM restarted its submaps. Ids of different generations are unrelated.
    pub generation: u32,
    /// Padding, always zero.
    pub reserved: u32,
    /// Storage of the row-major cells. Read it by [`Submap::view`].
    pub cells: [i8; SUBMAP_CELLS_MAX],
}

impl Submap {
    /// Returns the grid; `None` if its header is invalid.
    pub fn view(&self) -> Option<GridView<'_>> {
        let size = (self.grid.width as usize).checked_mul(self.grid.height as usize)?;
        GridView::new(&self.grid, self.cells.get(..size)?)
    }

    /// Copies a grid and cuts off the cells farther than half of [`SUBMAP_SIDE_MAX`] from its middle.
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

/// Relation between two submaps of one robot: the information of their relative pose.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SubmapEdge {
    /// Id of the submap in whose frame the information is expressed.
    pub a: u32,
    /// Id of the other submap, `a < b`. Its relative pose follows from [`SubmapPoses::poses`].
    pub b: u32,
    /// Inverse covariance over (x, y, yaw) in `a`, row-major upper triangle; m, rad.
    pub information: [f64; 6],
}

/// Poses of a robot's submaps in its map, as its pose graph estimates them now.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SubmapPoses {
    /// Header whose `stamp` is that of the newest node.
    pub header: Header,
    /// Number of `robot_map_from_submap` in use. Read them by [`SubmapPoses::poses`].
    pub len: u32,
    /// Number of `edges` in use. Read them by [`SubmapPoses::edges`].
    pub edges_len: u32,
    /// Generation of the submaps, as [`Submap::generation`].
    pub generation: u32,
    /// Number of the frame `robotK/map`: of the run on the robot's own machine, and of the map that was loaded in it; 0: the robot is of
    /// this machine's run, and no map of another frame was loaded. With another number the robot may be anywhere, and what was known of
    /// the frame's place is not valid any more.
    pub map_frame: u32,
    /// Storage of the transforms to `robotK/map` from each submap. Read it by [`SubmapPoses::poses`].
    pub robot_map_from_submap: [Pose2; SUBMAPS_MAX],
    /// Storage of the relations in the robot's own graph. Read it by [`SubmapPoses::edges`].
    pub edges: [SubmapEdge; SUBMAP_EDGES_MAX],
}

impl SubmapPoses {
    /// Returns the transform to `robotK/map` from each submap, by the submap's id.
    pub fn poses(&self) -> &[Pose2] {
        &self.robot_map_from_submap[..(self.len as usize).min(SUBMAPS_MAX)]
    }

    /// Returns the relations between submaps.
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

/// Request for all submaps of a robot, from a reader that misses some.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SubmapRequest {
    /// Header whose `stamp` is the time of the request.
    pub header: Header,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_grid_is_cut_around_its_middle() {
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
    fn lengths_beyond_the_arrays_are_clamped() {
        let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
        submap.grid.resolution_m = 0.05;
        (submap.grid.width, submap.grid.height) = (u32::MAX, u32::MAX);
        assert!(submap.view().is_none());
        let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
        (poses.len, poses.edges_len) = (u32::MAX, u32::MAX);
        assert_eq!((poses.poses().len(), poses.edges().len()), (SUBMAPS_MAX, SUBMAP_EDGES_MAX));
    }
}
