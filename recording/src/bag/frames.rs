//! Where a bag's transforms say that the robot and its scanner are.

use super::found::{Edge, Edges, FRAMES_MAX, Poses};
use super::{BagError, BagOptions, BagScan, frame};
use msg::Pose2;
use ros_messages::spatial_pose::{ScannerMount, SpatialPose};

/// Transforms that an error names.
const NAMED_MAX: usize = 16;

/// Returns the transform from the odometry's frame that leads to the scanner, else the only one.
pub fn odometry_transform(transforms: &Edges, scan_frame: &str, options: &BagOptions) -> Option<Poses> {
    let is_odom = |name: &str| match &options.odom_frame {
        Some(wished) => name == frame(wished),
        None => name == "odom" || name.ends_with("/odom"),
    };
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
    let (mut at, mut pose, mut moving) = (scan_frame, SpatialPose::IDENTITY, None);
    for _ in 0..FRAMES_MAX {
        if Some(at) == base_frame {
            break;
        }
        let Some(((parent, child), edge)) = parent_of(transforms, at) else { break };
        if edge.changes {
            moving.get_or_insert((parent, child));
        }
        // Without a base the first frame that moves ends the robot.
        if edge.changes && base_frame.is_none() {
            break;
        }
        (pose, at) = (edge.first.compose(&pose), parent);
    }
    if let Some(base_frame) = base_frame.filter(|base_frame| at != *base_frame) {
        return options.recorded_base_from_scan.map(ScannerMount::upright).ok_or_else(|| {
            BagError::NoScanner {
                scan_topic: scan_topic.to_owned(),
                scan_frame: scan_frame.to_owned(),
                base_frame: base_frame.to_owned(),
            }
        });
    }
    if let Some((parent, child)) = moving.filter(|_| base_frame.is_some()) {
        return Err(BagError::Moving { parent: parent.clone(), child: child.clone() });
    }
    let mount = pose.mount().map_err(|tilt_deg| BagError::Tilted {
        scan_frame: scan_frame.to_owned(),
        base_frame: at.to_owned(),
        tilt_deg,
    })?;
    Ok(if base_frame.is_some() { mount } else { ScannerMount { base_from_scan: Pose2::IDENTITY, ..mount } })
}

/// Returns the scan of a scanner that hangs upside down, as seen from above: its beams turn the other way, in the same order.
pub fn mirrored(scan: BagScan) -> BagScan {
    BagScan { angle_min_rad: -scan.angle_min_rad, angle_increment_rad: -scan.angle_increment_rad, ..scan }
}
