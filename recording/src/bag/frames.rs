//! Where a bag's transforms say that the robot and its scanner are.

use super::found::{Edge, Edges, FRAMES_MAX, Poses};
use super::{BagError, BagOptions, BagScan, frame};
use msg::Pose2;
use ros_messages::spatial_pose::{ScannerMount, SpatialPose};

/// Transforms that an error names.
const NAMED_MAX: usize = 16;

/// Returns whether transforms from this frame may be odometry: it is the named one, else one with the usual name.
pub fn is_odometry(parent: &str, odom_frame: Option<&str>) -> bool {
    match odom_frame {
        Some(wished) => parent == frame(wished),
        None => parent == "odom" || parent.ends_with("/odom"),
    }
}

/// Returns the transform from the odometry's frame that leads to the scanner, else the only one.
pub fn odometry_transform(transforms: &Edges, scan_frame: &str, options: &BagOptions) -> Option<Poses> {
    let is_odom = |name: &str| is_odometry(name, options.odom_frame.as_deref());
    let poses = |child: &str, edge: &Edge| Poses { base_frame: child.to_owned(), poses: edge.poses.clone() };
    let mut at = scan_frame;
    for _ in 0..FRAMES_MAX {
        let Some(((parent, child), edge)) = parent_of(transforms, at) else { break };
        if is_odom(parent) {
            return Some(poses(child, edge));
        }
        at = parent;
    }
    let mut edges = transforms.iter().filter(|((parent, _), _)| is_odom(parent));
    let ((_, child), edge) = edges.next()?;
    edges.next().is_none().then(|| poses(child, edge))
}

/// Names the transforms that change, sorted: one of them may be odometry under a name of its own.
pub fn changing(transforms: &Edges) -> Vec<String> {
    let changing = transforms.iter().filter(|(_, edge)| edge.changes);
    let mut names: Vec<String> =
        changing.map(|((parent, child), _)| format!("{parent} -> {child}")).collect();
    names.sort();
    names.truncate(NAMED_MAX);
    names
}

fn parent_of<'a>(transforms: &'a Edges, child: &str) -> Option<(&'a (String, String), &'a Edge)> {
    // A frame has one parent; of several the first by name, so that each replay has the same.
    transforms.iter().filter(|((_, name), _)| name == child).min_by_key(|(key, _)| *key)
}

/// A frame on the way from a first one to the root of its tree.
struct Ancestor<'a> {
    frame: &'a str,
    /// Pose of the first frame in this one.
    pose: SpatialPose,
    /// The first transform on the way here that changes: parent and child.
    moving: Option<&'a (String, String)>,
}

/// Returns the frame itself, its parent, and so on.
fn ancestors<'a>(transforms: &'a Edges, first: &'a str) -> Vec<Ancestor<'a>> {
    let mut ancestors = vec![Ancestor { frame: first, pose: SpatialPose::IDENTITY, moving: None }];
    while let Some(last) = ancestors.last().filter(|_| ancestors.len() <= FRAMES_MAX)
        && let Some((names, edge)) = parent_of(transforms, last.frame)
    {
        let moving = last.moving.or(edge.changes.then_some(names));
        ancestors.push(Ancestor { frame: &names.0, pose: edge.first.compose(&last.pose), moving });
    }
    ancestors
}

/// Returns the scanner's mount: what is given, else along the transforms between scanner and base, else what was recorded.
/// Without a base's frame the scanner is the base, but may hang upside down.
pub fn mount(
    transforms: &Edges,
    (scan_topic, scan_frame): (&str, &str),
    base_frame: Option<&str>,
    options: &BagOptions,
) -> Result<ScannerMount, BagError> {
    if let Some(base_from_scan) = options.base_from_scan {
        return Ok(ScannerMount::upright(base_from_scan));
    }
    let of_scanner = ancestors(transforms, scan_frame);
    let tilted = |base_frame: &str| {
        let (scan_frame, base_frame) = (scan_frame.to_owned(), base_frame.to_owned());
        |tilt_deg| BagError::Tilted { scan_frame, base_frame, tilt_deg }
    };
    let Some(base_frame) = base_frame else {
        // The first frame that moves ends the robot.
        let fixed = of_scanner.iter().take_while(|ancestor| ancestor.moving.is_none()).last();
        let (pose, frame) = fixed.map_or((SpatialPose::IDENTITY, scan_frame), |last| (last.pose, last.frame));
        let mount = pose.mount().map_err(tilted(frame))?;
        return Ok(ScannerMount { base_from_scan: Pose2::IDENTITY, ..mount });
    };
    let of_base = ancestors(transforms, base_frame);
    let common = of_scanner
        .iter()
        .find_map(|scanner| Some((scanner, of_base.iter().find(|base| base.frame == scanner.frame)?)));
    let Some((scanner, base)) = common else {
        return options.recorded_base_from_scan.map(ScannerMount::upright).ok_or_else(|| {
            BagError::NoScanner {
                scan_topic: scan_topic.to_owned(),
                scan_frame: scan_frame.to_owned(),
                base_frame: base_frame.to_owned(),
            }
        });
    };
    if let Some((parent, child)) = scanner.moving.or(base.moving) {
        return Err(BagError::Moving { parent: parent.clone(), child: child.clone() });
    }
    base.pose.inverse().compose(&scanner.pose).mount().map_err(tilted(base_frame))
}

/// Returns the scan of a scanner that hangs upside down, as seen from above: its beams turn the other way, in the same order.
pub fn mirrored(scan: BagScan) -> BagScan {
    BagScan { angle_min_rad: -scan.angle_min_rad, angle_increment_rad: -scan.angle_increment_rad, ..scan }
}
