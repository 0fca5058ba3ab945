//! The frames that sources describe by their transforms, as tf2 keeps them: each frame's parent and newest pose in it.

use super::SourceId;
use msg::RobotId;
use ros_messages::read::Transform;
use ros_messages::spatial_pose::SpatialPose;
use std::collections::BTreeMap;

/// Most frames of one tree: 64 robots with a dozen frames each. Further ones are not known.
const FRAMES_MAX: usize = 1024;
/// Most trees: the shared one and each robot's own, of several sources. What further ones send is not known.
const TREES_MAX: usize = 256;
/// The longest frame name that is kept, bytes.
const NAME_BYTES_MAX: usize = 256;

/// A frame's place in its tree.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEdge {
    /// The parent frame, without a leading slash.
    pub parent: String,
    /// Pose of the frame in its parent.
    pub parent_from_child: SpatialPose,
}

/// The transforms of one source on one topic: that of all robots, or a robot's own.
#[derive(Debug)]
struct FrameTree {
    source: SourceId,
    /// The robot whose own topic it is.
    of: Option<RobotId>,
    edges: BTreeMap<String, FrameEdge>,
}

/// The trees of all sources. Known frames are updated without allocating.
#[derive(Debug, Default)]
pub struct FrameTrees {
    trees: Vec<FrameTree>,
}

impl FrameTrees {
    /// Records a transform of a source. `of`: it came on this robot's own topic. One that is no pose is left out.
    pub fn record(&mut self, source: SourceId, of: Option<RobotId>, transform: &Transform<'_>) {
        let (parent, child) = (without_slash(transform.frame_id), without_slash(transform.child_frame_id));
        let is_usable = [parent, child].iter().all(|name| (1..=NAME_BYTES_MAX).contains(&name.len()));
        let pose = SpatialPose::checked(transform.translation, transform.rotation);
        let (Some(parent_from_child), true) = (pose, is_usable && parent != child) else { return };
        let Some(edges) = self.edges_of(source, of) else { return };
        if let Some(edge) = edges.get_mut(child) {
            edge.parent_from_child = parent_from_child;
            if edge.parent != parent {
                edge.parent.replace_range(.., parent);
            }
        } else if edges.len() < FRAMES_MAX {
            edges.insert(child.to_owned(), FrameEdge { parent: parent.to_owned(), parent_from_child });
        }
    }

    fn edges_of(
        &mut self,
        source: SourceId,
        of: Option<RobotId>,
    ) -> Option<&mut BTreeMap<String, FrameEdge>> {
        let known = self.trees.iter().position(|tree| (tree.source, tree.of) == (source, of));
        let index = known.unwrap_or(self.trees.len());
        if index == self.trees.len() {
            if index == TREES_MAX {
                return None;
            }
            self.trees.push(FrameTree { source, of, edges: BTreeMap::new() });
        }
        Some(&mut self.trees[index].edges)
    }

    /// Returns the place of a robot's frame by a source: on the robot's own topic, else on that of all robots.
    ///
    /// The second value tells whether it is the topic of all robots.
    pub fn edge(&self, source: SourceId, robot: RobotId, frame: &str) -> Option<(&FrameEdge, bool)> {
        let find = |of: Option<RobotId>| {
            let tree = self.trees.iter().find(|tree| (tree.source, tree.of) == (source, of))?;
            tree.edges.get(frame)
        };
        let own = find(Some(robot)).map(|edge| (edge, false));
        own.or_else(|| find(None).map(|edge| (edge, true)))
    }

    /// Forgets what a source has sent.
    pub fn forget(&mut self, source: SourceId) {
        self.trees.retain(|tree| tree.source != source);
    }
}

/// Returns a frame's name without the leading slash of ROS 1.
pub fn without_slash(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Stamp;

    fn transform<'a>(parent: &'a str, child: &'a str, x_m: f64) -> Transform<'a> {
        Transform {
            stamp: Stamp(0),
            frame_id: parent,
            child_frame_id: child,
            translation: [x_m, 0.0, 0.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
        }
    }

    #[test]
    fn a_robots_own_transforms_come_before_shared_ones_and_all_are_bounded() {
        let (mut trees, [one, two]) = (FrameTrees::default(), [1, 2].map(|n| RobotId::new(n).unwrap()));
        trees.record(7, None, &transform("/base_link", "/laser", 0.1));
        trees.record(7, Some(two), &transform("base_link", "laser", 0.2));
        let x_of = |trees: &FrameTrees, source, robot| {
            trees
                .edge(source, robot, "laser")
                .map(|(edge, shared)| (edge.parent_from_child.planar().x_m, shared))
        };
        assert_eq!(x_of(&trees, 7, one), Some((0.1, true)));
        assert_eq!(x_of(&trees, 7, two), Some((0.2, false)));
        assert_eq!(x_of(&trees, 8, one), None, "another source says nothing about it");
        for n in 0..2 * FRAMES_MAX {
            trees.record(7, None, &transform("base_link", &format!("frame{n}"), 0.0));
        }
        for source in 0..2 * TREES_MAX as u64 {
            trees.record(source, None, &transform("base_link", "laser", f64::NAN));
            trees.record(source, None, &transform("base_link", "laser", 0.5));
        }
        assert_eq!(trees.trees.len(), TREES_MAX);
        assert_eq!(trees.trees[0].edges.len(), FRAMES_MAX);
        assert_eq!(x_of(&trees, 7, one), Some((0.5, true)), "known frames are updated");
        trees.forget(7);
        assert_eq!(x_of(&trees, 7, one), None);
    }
}
