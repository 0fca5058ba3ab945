//! The parts of a session, one function to write and one to read each; what is read is checked.

use super::bytes::{In, Out};
use super::log::LogPosition;
use super::{Identity, SessionError};
use crate::back_end::{BackEndState, RejectedClosure};
use crate::closure::{ClosureCandidate, ClosureDetectorState, ClosureSearchCounts};
use crate::cloud::{BEARINGS, Cloud, SurfacePoint};
use crate::front_end::{FrontEndCounts, FrontEndState, LastScan, TrajectorySample};
use crate::graph::{Edge, EdgeKind};
use crate::node::{FrameUncertainty, Node, Rays, Revision, SWEPT_PATH_POSITIONS_MAX, SweptPath};
use crate::relocalize::PoseEstimate;
use bytemuck::{Pod, Zeroable};
use msg::{BEAMS_MAX, Header, Odometry, Pose2, SlamMode, Stamp};
use nalgebra::Matrix3;
use std::sync::Arc;

/// More than any configuration allows (`graph.nodes_max`).
const NODES_MAX: usize = 1_000_000;
/// Edges a node has at most, on average.
const EDGES_PER_NODE_MAX: usize = 64;
/// Nodes that wait to be looked for, finds that wait, revisions that wait, bans.
const WAITING_MAX: usize = 4096;
/// Messages of odometry.
const ODOMETRY_MAX: usize = 65_536;
/// Scans whose pose is remembered.
const RIDES_MAX: usize = 10_000_000;
/// No building, and no odometry that means anything, is larger, metres.
const PLACE_M_MAX: f64 = 1e9;
/// No beam is longer, metres.
const BEAM_M_MAX: f32 = 1e4;
/// More is no information but an error.
const INFORMATION_MAX: f64 = 1e12;

type Result<T> = core::result::Result<T, SessionError>;

fn check(sound: bool, what: &'static str) -> Result<()> {
    if sound { Ok(()) } else { Err(SessionError::Value { what }) }
}

fn check_pose(pose: Pose2, what: &'static str) -> Result<Pose2> {
    let near = pose.x_m.abs() <= PLACE_M_MAX && pose.y_m.abs() <= PLACE_M_MAX;
    check(near && pose.yaw_rad.abs() <= 7.0, what)?;
    Ok(pose)
}

fn check_matrix(values: [f64; 9], most: f64, what: &'static str) -> Result<Matrix3<f64>> {
    let m = Matrix3::from_column_slice(&values);
    let sound = values.iter().all(|v| v.abs() <= most) && (0..3).all(|k| m[(k, k)] >= 0.0);
    check(sound, what)?;
    Ok(m)
}

fn matrix(m: &Matrix3<f64>) -> [f64; 9] {
    core::array::from_fn(|i| m[i])
}

fn check_points(points: &[[f32; 2]], what: &'static str) -> Result<()> {
    check(points.iter().flatten().all(|v| v.abs() <= BEAM_M_MAX), what)
}

pub fn put_identity(out: &mut Out, identity: &Identity) {
    out.put(&u64::from(identity.robot));
    out.put(&identity.run);
    out.put(&identity.base_from_scan);
    out.put(&identity.range_use_max_m);
}

pub fn take_identity(from: &mut In<'_>) -> Result<Identity> {
    const WHAT: &str = "identity";
    let robot: u64 = from.take(WHAT)?;
    let identity = Identity {
        robot: robot.try_into().map_err(|_| SessionError::Value { what: WHAT })?,
        run: from.take(WHAT)?,
        base_from_scan: from.take(WHAT)?,
        range_use_max_m: from.take(WHAT)?,
    };
    let finite = identity.base_from_scan.iter().all(|v| v.is_finite());
    check(finite && identity.range_use_max_m.is_finite(), WHAT)?;
    Ok(identity)
}

pub fn take_mode(from: &mut In<'_>) -> Result<SlamMode> {
    const WHAT: &str = "mode";
    let code: u64 = from.take(WHAT)?;
    u32::try_from(code).ok().and_then(SlamMode::from_code).ok_or(SessionError::Value { what: WHAT })
}

/// A node but for its points and beams.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct NodeRecord {
    header: Header,
    local_from_base: Pose2,
    previous_from_this: Pose2,
    /// 1: `previous_from_this` is known; 2: the scan fitted; 4: it is torn from the nodes before; above the lowest
    /// eight bits: the places of its way.
    flags: u32,
    points: u32,
    hits: u32,
    misses: u32,
    cloud_sensor: [f32; 2],
    cloud_middle: [f32; 2],
    rays_sensor: [f32; 2],
}

fn put_node(out: &mut Out, node: &Node) {
    let (points, cloud_sensor, cloud_middle, seen_cm) = node.cloud.parts();
    let rays = &*node.rays;
    out.put(&NodeRecord {
        header: node.header,
        local_from_base: node.local_from_base,
        previous_from_this: node.previous_from_this.unwrap_or_default(),
        flags: u32::from(node.previous_from_this.is_some())
            | u32::from(node.fits) << 1
            | u32::from(node.odometry_break) << 2
            | (node.swept_path.positions_m().len() as u32) << 8,
        points: points.len() as u32,
        hits: rays.hits.len() as u32,
        misses: rays.misses.len() as u32,
        cloud_sensor,
        cloud_middle,
        rays_sensor: rays.sensor,
    });
    out.bytes.extend_from_slice(bytemuck::cast_slice(points));
    out.bytes.extend_from_slice(bytemuck::cast_slice(&rays.hits));
    out.bytes.extend_from_slice(bytemuck::cast_slice(&rays.misses));
    out.put(seen_cm);
    out.bytes.extend_from_slice(bytemuck::cast_slice(node.swept_path.positions_m()));
}

fn take_node(from: &mut In<'_>, id: u32) -> Result<Node> {
    const WHAT: &str = "node";
    let record: NodeRecord = from.take(WHAT)?;
    let sizes = [record.points, record.hits, record.misses].map(|n| n as usize);
    let most = *sizes.iter().max().unwrap_or(&0);
    if most > BEAMS_MAX {
        return Err(SessionError::TooMany { what: "beams in a node", found: most as u64, most: BEAMS_MAX });
    }
    let points: Vec<SurfacePoint> = from.values(sizes[0], WHAT)?;
    let hits: Vec<[f32; 2]> = from.values(sizes[1], WHAT)?;
    let misses: Vec<[f32; 2]> = from.values(sizes[2], WHAT)?;
    let seen_cm: [u16; BEARINGS] = from.take(WHAT)?;
    let swept_path = take_way(from, record.flags >> 8, BEAM_M_MAX)?;
    for p in &points {
        check_points(&[p.at], "point of a node")?;
        check(p.normal.iter().all(|v| v.abs() <= 1.01), "surface's direction")?;
    }
    check_points(&hits, "beam of a node")?;
    check_points(&misses, "beam of a node")?;
    check_points(&[record.cloud_sensor, record.cloud_middle, record.rays_sensor], "sensor of a node")?;
    let local_from_base = check_pose(record.local_from_base, "node's pose")?;
    let previous = check_pose(record.previous_from_this, "node's odometry")?;
    let cloud = Cloud::from_parts(points, record.cloud_sensor, record.cloud_middle, Box::new(seen_cm));
    Ok(Node {
        id,
        header: record.header,
        local_from_base,
        previous_from_this: (record.flags & 1 != 0).then_some(previous),
        fits: record.flags & 2 != 0,
        odometry_break: record.flags & 4 != 0,
        disconnected: None,
        cloud: Arc::new(cloud),
        rays: Arc::new(Rays { sensor: record.rays_sensor, hits, misses }),
        swept_path,
    })
}

/// A node with the front end's id, and the estimate with which an empty map begins.
pub fn put_log_node(out: &mut Out, node: &Node, begins_at: Option<PoseEstimate>) {
    out.put(&u64::from(node.id));
    out.maybe(begins_at.map(|estimate| estimate.map_from_local));
    out.put(&begins_at.map_or([0.0; 2], |estimate| [estimate.sigma_m, estimate.sigma_rad]));
    put_node(out, node);
}

pub fn take_log_node(from: &mut In<'_>) -> Result<(Node, Option<PoseEstimate>)> {
    const WHAT: &str = "node of a record";
    let id = u32::try_from(from.take::<u64>(WHAT)?).map_err(|_| SessionError::Value { what: WHAT })?;
    let map_from_local: Option<Pose2> = from.maybe(WHAT)?;
    let [sigma_m, sigma_rad]: [f64; 2] = from.take(WHAT)?;
    check([sigma_m, sigma_rad].iter().all(|sigma| (0.0..=1e3).contains(sigma)), WHAT)?;
    let begins_at = map_from_local
        .map(|pose| check_pose(pose, WHAT))
        .transpose()?
        .map(|map_from_local| PoseEstimate { map_from_local, sigma_m, sigma_rad });
    Ok((take_node(from, id)?, begins_at))
}

/// The place in the log; sessions of version 4 and before have none.
pub fn take_log_position(from: &mut In<'_>) -> Result<LogPosition> {
    const WHAT: &str = "place in the log";
    if from.is_empty() {
        return Ok(LogPosition::default());
    }
    let [number, checksum]: [u64; 2] = from.take(WHAT)?;
    let checksum = u32::try_from(checksum).map_err(|_| SessionError::Value { what: WHAT })?;
    Ok(LogPosition { number, checksum })
}

/// So many places, none farther than so many metres.
fn take_way(from: &mut In<'_>, places: u32, most_m: f32) -> Result<SweptPath> {
    const WHAT: &str = "way";
    if places as usize > SWEPT_PATH_POSITIONS_MAX {
        let found = u64::from(places);
        return Err(SessionError::TooMany { what: "places in a way", found, most: SWEPT_PATH_POSITIONS_MAX });
    }
    let way: Vec<[f32; 2]> = from.values(places as usize, WHAT)?;
    check(way.iter().flatten().all(|v| v.abs() <= most_m), WHAT)?;
    Ok(SweptPath::of(&way))
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct EdgeRecord {
    a: u32,
    b: u32,
    kind: u32,
    in_force: u32,
    a_from_b: Pose2,
    information: [f64; 9],
    variance: [f64; 2],
    response: f32,
    reserved: u32,
}

const KINDS: [EdgeKind; 5] =
    [EdgeKind::Odometry, EdgeKind::Link, EdgeKind::Closure, EdgeKind::InitialPose, EdgeKind::OdometryBreak];

fn edge_record(edge: &Edge) -> EdgeRecord {
    EdgeRecord {
        a: edge.a,
        b: edge.b,
        kind: KINDS.iter().position(|kind| *kind == edge.kind).unwrap_or(0) as u32,
        in_force: u32::from(edge.in_force),
        a_from_b: edge.a_from_b,
        information: matrix(&edge.information),
        variance: edge.variance,
        response: edge.response,
        reserved: 0,
    }
}

fn edge(record: EdgeRecord, nodes: usize) -> Result<Edge> {
    let there = (record.a as usize) < nodes && (record.b as usize) < nodes && record.a != record.b;
    check(there, "link between nodes that are not there")?;
    let kind = KINDS.get(record.kind as usize).copied();
    check(record.variance.iter().all(|v| (0.0..=1e9).contains(v)), "link's uncertainty")?;
    check((0.0..=1.0).contains(&record.response), "closure's response")?;
    Ok(Edge {
        a: record.a,
        b: record.b,
        a_from_b: check_pose(record.a_from_b, "link's measurement")?,
        information: check_matrix(record.information, INFORMATION_MAX, "link's information")?,
        kind: kind.ok_or(SessionError::Value { what: "kind of link" })?,
        in_force: record.in_force != 0,
        variance: record.variance,
        response: record.response,
    })
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct FindRecord {
    node: u32,
    candidate: u32,
    candidate_from_node: Pose2,
    information: [f64; 9],
    response: f32,
    reserved: u32,
}

fn find_record(find: &ClosureCandidate) -> FindRecord {
    FindRecord {
        node: find.node,
        candidate: find.candidate,
        candidate_from_node: find.candidate_from_node,
        information: matrix(&find.information),
        response: find.response,
        reserved: 0,
    }
}

fn find(record: FindRecord, nodes: usize) -> Result<ClosureCandidate> {
    let there = (record.node as usize) < nodes && (record.candidate as usize) < nodes;
    check(there && record.node != record.candidate, "find of a node that is not there")?;
    check((0.0..=1.0).contains(&record.response), "find's response")?;
    Ok(ClosureCandidate {
        node: record.node,
        candidate: record.candidate,
        candidate_from_node: check_pose(record.candidate_from_node, "find's measurement")?,
        information: check_matrix(record.information, INFORMATION_MAX, "find's information")?,
        response: record.response,
    })
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct BanRecord {
    a: u32,
    b: u32,
    a_from_b: Pose2,
}

pub fn put_back(out: &mut Out, back: &BackEndState) {
    out.put(&(back.nodes.len() as u64));
    back.nodes.iter().for_each(|node| put_node(out, node));
    out.list(&back.front_ids);
    out.list(&back.poses);
    out.list(&back.drawn);
    out.list(&back.edges.iter().map(edge_record).collect::<Vec<_>>());
    out.put(&back.travelled_m);
    out.list(&back.not_found);
    out.list(&back.again);
    let ClosureSearchCounts { searches, no_response, ambiguous, contradicted, unconfirmed, accepted } =
        back.detector.counts;
    out.put(&[searches, no_response, ambiguous, contradicted, unconfirmed, accepted]);
    out.put(&[back.unsolved as u64, back.solutions, back.retracted, back.retired]);
    out.maybe(back.unverified_edge.map(u64::from));
    out.list(&back.detector.pending.iter().map(find_record).collect::<Vec<_>>());
    out.maybe(back.detector.last_search_m);
    let rejected_closures =
        back.rejected_closures.iter().map(|ban| BanRecord { a: ban.a, b: ban.b, a_from_b: ban.a_from_b });
    out.list(&rejected_closures.collect::<Vec<_>>());
}

pub fn take_back(from: &mut In<'_>) -> Result<BackEndState> {
    let count = from.count(NODES_MAX, "nodes")?;
    let mut nodes = Vec::new();
    for id in 0..count {
        nodes.push(take_node(from, id as u32)?);
    }
    let front_ids: Vec<u32> = from.list(count, "scan path's numbers")?;
    check(front_ids.len() == count, "number of the scan path's numbers")?;
    let poses: Vec<Pose2> = from.list(count, "poses")?;
    check(poses.len() == count, "number of poses")?;
    let drawn: Vec<Pose2> = from.list(count, "drawn poses")?;
    for pose in poses.iter().chain(&drawn) {
        check_pose(*pose, "pose of a node")?;
    }
    let records: Vec<EdgeRecord> = from.list(EDGES_PER_NODE_MAX * count, "links")?;
    let edges = records.into_iter().map(|record| edge(record, count)).collect::<Result<Vec<_>>>()?;
    let travelled_m: f64 = from.take("way")?;
    check((0.0..1e12).contains(&travelled_m), "way")?;
    let mut ids = |what| -> Result<Vec<u32>> {
        let ids: Vec<u32> = from.list(WAITING_MAX, what)?;
        check(ids.iter().all(|id| (*id as usize) < count), what)?;
        Ok(ids)
    };
    let (not_found, again) = (ids("nodes not found")?, ids("nodes to look for again")?);
    let [searches, no_response, ambiguous, contradicted, unconfirmed, accepted]: [u64; 6] =
        from.take("counts")?;
    let [unsolved, solutions, retracted, retired]: [u64; 4] = from.take("counts")?;
    let unverified_edge: Option<u64> = from.maybe("unverified_edge")?;
    check(unverified_edge.is_none_or(|id| id < count as u64), "unverified_edge")?;
    let pending: Vec<FindRecord> = from.list(WAITING_MAX, "finds")?;
    let pending = pending.into_iter().map(|record| find(record, count)).collect::<Result<Vec<_>>>()?;
    let last_search_m: Option<f64> = from.maybe("last search")?;
    check(last_search_m.is_none_or(|m| (0.0..1e12).contains(&m)), "last search")?;
    let rejected_closures: Vec<BanRecord> = from.list(WAITING_MAX, "undone closures")?;
    let ban = |ban: BanRecord| {
        check((ban.a as usize) < count && (ban.b as usize) < count, "undone closure")?;
        Ok(RejectedClosure { a: ban.a, b: ban.b, a_from_b: check_pose(ban.a_from_b, "undone closure")? })
    };
    let rejected_closures = rejected_closures.into_iter().map(ban).collect::<Result<Vec<_>>>()?;
    let counts =
        ClosureSearchCounts { searches, no_response, ambiguous, contradicted, unconfirmed, accepted };
    let detector = ClosureDetectorState { pending, counts, last_search_m };
    let unsolved = unsolved.min(count as u64) as usize;
    Ok(BackEndState {
        nodes,
        front_ids,
        poses,
        drawn,
        edges,
        travelled_m,
        not_found,
        again,
        unsolved,
        solutions,
        retracted,
        retired,
        unverified_edge: unverified_edge.map(|id| id as u32),
        detector,
        rejected_closures,
    })
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct RevisionRecord {
    cause: u32,
    effective_from: u32,
    map_from_local: Pose2,
    closures: u32,
    located: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct LastRecord {
    stamp: Stamp,
    local_from_base: Pose2,
    covariance: [f64; 9],
}

pub fn put_front(out: &mut Out, front: &FrontEndState) {
    out.put(&[front.next_node, front.recent, front.local_maps[0], front.local_maps[1]]);
    // Above the lowest eight bits of the last: the places of its way.
    let last_scan_lost = u32::from(front.last_scan_lost) | (front.swept_path.positions_m().len() as u32) << 8;
    out.put(&[front.lost_in_row, front.closures, u32::from(front.located), last_scan_lost]);
    out.put(&front.map_from_local);
    out.maybe(front.node_odom_from_base);
    out.put(&matrix(&front.node_covariance));
    out.maybe(front.last_break.map(u64::from));
    out.maybe(front.last.as_ref().map(|last| LastRecord {
        stamp: last.stamp,
        local_from_base: last.local_from_base,
        covariance: matrix(&last.covariance),
    }));
    out.maybe(front.last.as_ref().and_then(|last| last.odom_from_base));
    let motion = front.last.as_ref().and_then(|last| last.motion);
    out.maybe(motion.map(|(motion, _)| motion));
    out.put(&motion.map_or(0.0, |(_, seconds)| seconds));
    out.maybe(front.published_from_newest);
    let c = front.counts;
    out.put(&[c.accepted, c.stamp_repeated, c.stamp_went_back, c.beam_count, c.geometry]);
    out.put(&[c.lost, c.odometry_rejected, c.slips, c.trajectory_dropped, c.nodes_held_back, c.not_deskewed]);
    out.put(&[c.clock_set_back, c.odometry_breaks]);
    let waiting = front.waiting.iter().map(|r| RevisionRecord {
        cause: r.cause,
        effective_from: r.effective_from,
        map_from_local: r.map_from_local,
        closures: r.closures,
        located: u32::from(r.located),
    });
    out.list(&waiting.collect::<Vec<_>>());
    out.list(&front.odometry);
    out.put(&front.continuous_from_odom);
    out.put(&front.odometry_rejected);
    out.bytes.extend_from_slice(bytemuck::cast_slice(front.swept_path.positions_m()));
}

pub fn take_front(from: &mut In<'_>, nodes: usize) -> Result<FrontEndState> {
    const WHAT: &str = "the scan path";
    let [next_node, recent, older, younger]: [u32; 4] = from.take(WHAT)?;
    let fits = [recent, older, younger].iter().all(|n| *n as usize <= nodes.min(4096));
    check(fits, "number of nodes in the local map")?;
    let [lost_in_row, closures, located, last_scan_lost]: [u32; 4] = from.take(WHAT)?;
    let map_from_local = check_pose(from.take(WHAT)?, "scan path's place in the map")?;
    let pose = |pose: Option<Pose2>| pose.map(|pose| check_pose(pose, "scan path's odometry")).transpose();
    let node_odom_from_base = pose(from.maybe(WHAT)?)?;
    let node_covariance = check_matrix(from.take(WHAT)?, INFORMATION_MAX, "newest node's covariance")?;
    let last_break: Option<u64> = from.maybe(WHAT)?;
    let last: Option<LastRecord> = from.maybe(WHAT)?;
    let odom_from_base = pose(from.maybe(WHAT)?)?;
    let motion = pose(from.maybe(WHAT)?)?;
    let motion_s: f64 = from.take(WHAT)?;
    check((0.0..1e9).contains(&motion_s), "duration of the last motion")?;
    let published_from_newest = pose(from.maybe(WHAT)?)?;
    let last = last.map(|last| {
        Ok(LastScan {
            stamp: last.stamp,
            local_from_base: check_pose(last.local_from_base, "last pose")?,
            odom_from_base,
            motion: motion.map(|motion| (motion, motion_s)),
            covariance: check_matrix(last.covariance, INFORMATION_MAX, "last pose's covariance")?,
        })
    });
    let [accepted, stamp_repeated, stamp_went_back, beam_count, geometry]: [u64; 5] = from.take(WHAT)?;
    let [lost, odometry_rejected_before, slips, trajectory_dropped, nodes_held_back, not_deskewed]: [u64; 6] =
        from.take(WHAT)?;
    let [clock_set_back, odometry_breaks]: [u64; 2] = from.take(WHAT)?;
    let counts = FrontEndCounts {
        clock_set_back,
        odometry_breaks,
        accepted,
        stamp_repeated,
        stamp_went_back,
        beam_count,
        geometry,
        lost,
        odometry_rejected: odometry_rejected_before,
        slips,
        trajectory_dropped,
        nodes_held_back,
        not_deskewed,
    };
    let waiting: Vec<RevisionRecord> = from.list(WAITING_MAX, "revisions")?;
    let revision = |r: RevisionRecord| {
        Ok(Revision {
            cause: r.cause,
            effective_from: r.effective_from,
            map_from_local: check_pose(r.map_from_local, "revision")?,
            // The back end finds it anew when it answers the next node.
            uncertainty: FrameUncertainty::default(),
            closures: r.closures,
            located: r.located != 0,
        })
    };
    let odometry: Vec<Odometry> = from.list(ODOMETRY_MAX, "odometry")?;
    for o in &odometry {
        check_pose(o.odom_from_base, "odometry")?;
    }
    check(odometry.is_sorted_by(|a, b| a.header.stamp < b.header.stamp), "order of odometry")?;
    Ok(FrontEndState {
        next_node,
        recent,
        local_maps: [older, younger],
        lost_in_row,
        last_scan_lost: last_scan_lost & 1 != 0,
        closures,
        located: located != 0,
        map_from_local,
        published_from_newest,
        node_odom_from_base,
        node_covariance,
        last_break: last_break.map(|id| u32::try_from(id).unwrap_or(u32::MAX)),
        last: last.transpose()?,
        counts,
        waiting: waiting.into_iter().map(revision).collect::<Result<Vec<_>>>()?,
        odometry,
        continuous_from_odom: check_pose(from.take(WHAT)?, "odometry's frame")?,
        odometry_rejected: from.take(WHAT)?,
        swept_path: take_way(from, last_scan_lost >> 8, PLACE_M_MAX as f32)?,
    })
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct RideRecord {
    stamp: Stamp,
    node_from_base: Pose2,
    node: u32,
    reserved: u32,
}

pub fn put_rides(out: &mut Out, samples: &[TrajectorySample]) {
    let record = |r: &TrajectorySample| RideRecord {
        stamp: r.stamp,
        node_from_base: r.node_from_base,
        node: r.node,
        reserved: 0,
    };
    out.list(&samples.iter().map(record).collect::<Vec<_>>());
}

pub fn take_rides(from: &mut In<'_>, nodes: usize) -> Result<Vec<TrajectorySample>> {
    let records: Vec<RideRecord> = from.list(RIDES_MAX, "scans")?;
    let ride = |r: RideRecord| {
        check((r.node as usize) < nodes, "scan of a node that is not there")?;
        let node_from_base = check_pose(r.node_from_base, "scan's pose")?;
        Ok(TrajectorySample { stamp: r.stamp, node: r.node, node_from_base })
    };
    records.into_iter().map(ride).collect()
}
