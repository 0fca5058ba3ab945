//! The bytes of sessions and records: one version has one format, and whatever the bytes, decoding is bounded and its
//! result is valid.

mod common;

use common::ring_log;
use proptest::prelude::*;
use slam::session::log::{LogContents, LogPosition, LogRecord, LogRecordBuilder};
use slam::session::{BYTES_MAX, VERSION};
use slam::{InitialPose, LocalFrameEstimate, Session, SessionError, SessionIdentity, SlamConfig};
use std::path::Path;
use std::sync::OnceLock;

/// Length of a session's head, bytes.
const HEAD: usize = 24;
/// Length of a record's head, bytes.
const RECORD_HEAD: usize = 20;

/// A session of few nodes, with the state of its front end, and a record of one node more.
fn example() -> &'static (Vec<u8>, Vec<u8>) {
    static EXAMPLE: OnceLock<(Vec<u8>, Vec<u8>)> = OnceLock::new();
    EXAMPLE.get_or_init(|| {
        let identity = SessionIdentity::new(1, 7, &SlamConfig::default());
        let (mut front, mut back) =
            slam::create_or_resume(SlamConfig::default(), None, Default::default(), InitialPose::Unknown);
        let mut newest = LogPosition::default();
        let estimate =
            LocalFrameEstimate { map_from_local: Default::default(), sigma_m: 0.1, sigma_rad: 0.1 };
        let mut session = None;
        for (odometry, scan, _) in &ring_log() {
            front.add_odometry(odometry);
            let Some(node) = front.process(scan).node else { continue };
            if back.nodes().len() == 4 {
                let mut builder = LogRecordBuilder::default();
                builder.add(&node, Some(estimate));
                let record = builder.encode(&identity, &mut newest, &front.state()).unwrap();
                return (session.unwrap_or_default(), record);
            }
            front.add_frame_update(back.add_node(node));
            session = Some(back.session(identity, Some(front.state()), front.samples()).encode().unwrap());
        }
        unreachable!("the robot made {} nodes", back.nodes().len())
    })
}

/// A session with this content and a head that fits.
fn with_head(content: &[u8]) -> Vec<u8> {
    let mut bytes = example().0[..HEAD].to_vec();
    bytes[12..16].copy_from_slice(&crc32fast::hash(content).to_le_bytes());
    bytes[16..24].copy_from_slice(&(content.len() as u64).to_le_bytes());
    bytes.extend_from_slice(content);
    bytes
}

/// The stored files were written by this version. If this fails, the format changed: raise `VERSION`, and write them
/// anew with MR_SLAM_WRITE_SESSIONS=1.
#[test]
fn a_version_has_one_format() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let [session, record] =
        ["session", "record"].map(|name| folder.join(format!("{name}-version-{VERSION}")));
    if std::env::var_os("MR_SLAM_WRITE_SESSIONS").is_some() {
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(&session, &example().0).unwrap();
        std::fs::write(&record, &example().1).unwrap();
    }
    let stored = std::fs::read(&session).unwrap();
    let decoded = Session::decode_any(&stored).unwrap();
    assert!(decoded.front.is_some() && !decoded.samples.is_empty() && !decoded.back.edges.is_empty());
    assert_eq!(decoded.back.nodes.len(), 4);
    assert!(decoded.encode().unwrap() == stored, "another format than version {VERSION}");

    let stored = std::fs::read(&record).unwrap();
    let contents = LogContents::decode(&stored);
    assert!(contents.incomplete_tail.is_none(), "{:?}", contents.incomplete_tail);
    let (decoded, _) = &contents.records[0];
    let mut builder = LogRecordBuilder::default();
    decoded.nodes.iter().for_each(|logged| builder.add(&logged.node, logged.begins_at));
    assert!(!builder.is_empty() && decoded.nodes[0].begins_at.is_some());
    let again = builder.encode(&decoded.identity, &mut LogPosition::default(), &decoded.front).unwrap();
    assert!(again == stored, "another format than version {VERSION}");
}

#[test]
fn another_version_is_refused_with_what_to_do() {
    let (session, record) = example();
    for version in [3, 4, 5, 6, 7, 8, 9, VERSION + 1] {
        let mut other = session.clone();
        other[8..12].copy_from_slice(&version.to_le_bytes());
        let why = Session::decode_any(&other).unwrap_err();
        assert_eq!(why, SessionError::Version { found: version });
        let said = why.to_string();
        assert!(said.contains("map again") && said.contains("mr-slam slam ROBOT map NAME"), "{said}");
        let mut other = record.clone();
        other[8..12].copy_from_slice(&version.to_le_bytes());
        assert_eq!(LogContents::decode(&other).incomplete_tail, Some((0, why)));
    }
}

/// Content whose first list claims `length` elements: identity and mode, then the length of the list of nodes.
fn claims_nodes(length: u64) -> Vec<u8> {
    let identity = SessionIdentity::new(1, 7, &SlamConfig::default());
    postcard::to_allocvec(&(identity, msg::SlamMode::Mapping, length)).unwrap()
}

#[test]
fn a_claimed_length_allocates_nothing() {
    for length in [1, 1 << 20, 1 << 40, u64::MAX] {
        let mut content = claims_nodes(length);
        let allocated = allocation_counter::measure(|| {
            let refused = Session::decode_content(&content);
            assert!(matches!(refused, Err(SessionError::Encoding(_))), "{refused:?}");
        });
        assert!(allocated.bytes_max <= 1 << 20, "{length}: {allocated:?}");
        // A node (number, header, pose, no odometry, two flags) whose points claim as many bytes.
        content.extend([0; 5]);
        content.extend([0; 24 + 3]);
        content.extend(postcard::to_allocvec(&length).unwrap());
        let allocated = allocation_counter::measure(|| {
            assert!(Session::decode_content(&content).is_err());
        });
        assert!(allocated.bytes_max <= 2 << 20, "{length}: {allocated:?}");
    }
}

#[test]
fn more_bytes_than_the_limit_are_refused_before_they_are_looked_at() {
    // Zeroed memory that is never touched costs nothing.
    let mut bytes = vec![0; BYTES_MAX + 1];
    bytes[..8].copy_from_slice(&slam::session::MAGIC);
    let refused = Session::decode_any(&bytes).unwrap_err();
    assert_eq!(refused, SessionError::TooLarge { found: BYTES_MAX as u64 + 1 });
}

/// Spoils a session, which is then neither read nor written: the reason has these words.
fn assert_refused(session: &Session, what: &str, spoil: &dyn Fn(&mut Session)) {
    let mut spoilt = session.clone();
    spoil(&mut spoilt);
    let bytes = with_head(&postcard::to_allocvec(&spoilt).unwrap());
    let why = Session::decode_any(&bytes).map(|_| ()).unwrap_err();
    assert!(why.to_string().contains(what), "{why}, expected {what}");
    assert_eq!(spoilt.encode(), Err(why), "it could not be read again");
}

#[test]
fn every_value_is_checked() {
    let (bytes, record) = example();
    let session = Session::decode_any(bytes).unwrap();
    let refused = |what: &str, spoil: &dyn Fn(&mut Session)| assert_refused(&session, what, spoil);
    refused("identity", &|s| s.identity.range_use_max_m = f64::NAN);
    refused("number of a node", &|s| s.back.nodes[1].id = 2);
    refused("node's pose", &|s| s.back.nodes[2].local_from_base.x_m = f64::INFINITY);
    refused("node's odometry", &|s| {
        s.back.nodes[2].previous_from_this = Some(msg::Pose2::new(0.0, 0.0, 10.0));
    });
    refused("beam of a node", &|s| {
        let rays = std::sync::Arc::make_mut(&mut s.back.nodes[0].rays);
        rays.hits[0][1] = f32::NAN;
    });
    refused("beams in a node", &|s| {
        std::sync::Arc::make_mut(&mut s.back.nodes[0].rays).misses.resize(5000, [0.0; 2]);
    });
    refused("number of poses", &|s| s.back.poses.truncate(3));
    refused("drawn poses", &|s| s.back.drawn.resize(5, msg::Pose2::IDENTITY));
    refused("pose of a node", &|s| s.back.poses[0].yaw_rad = f64::NAN);
    refused("edge between nodes", &|s| s.back.edges[0].b = 4);
    refused("edge's information", &|s| s.back.edges[0].information[4] = -1.0);
    for spoilt in [f64::NAN, 4.0] {
        refused("edge's degenerate direction", &|s| {
            let link = s.back.edges.iter_mut().find(|edge| edge.kind == slam::EdgeKind::ScanMatch).unwrap();
            link.degenerate_direction_rad = Some(spoilt);
        });
    }
    refused("edge's degenerate direction", &|s| {
        let odometry = s.back.edges.iter_mut().find(|edge| edge.kind == slam::EdgeKind::Odometry).unwrap();
        odometry.degenerate_direction_rad = Some(0.0);
    });
    refused("edge's variance", &|s| s.back.edges[0].variances.worst_axis_m2 = f64::NAN);
    refused("closure's response", &|s| s.back.edges[0].response = 1.5);
    refused("length of the path", &|s| s.back.travelled_m = -1.0);
    refused("nodes not found", &|s| s.back.not_found = vec![4]);
    refused("unverified node", &|s| s.back.unverified_node = Some(4));
    refused("place of the last search", &|s| s.back.detector.last_search_m = Some(f64::NAN));
    refused("counts", &|s| s.back.solutions = u64::MAX);
    refused("local map", &|s| s.front.as_mut().unwrap().reference_count = 5);
    refused("number of the next node", &|s| s.front.as_mut().unwrap().next_node = u32::MAX);
    refused("newest node's covariance", &|s| s.front.as_mut().unwrap().reference_covariance[0] = f64::NAN);
    refused("order of odometry", &|s| {
        let odometry = &mut s.front.as_mut().unwrap().odometry;
        odometry.push(odometry[0]);
    });
    refused("scan of a node", &|s| s.samples[0].node = 4);
    refused("scan's pose", &|s| s.samples[0].node_from_base.x_m = f64::NAN);
    refused("place in the log", &|s| s.log.number = u64::MAX);
    assert!(LogRecord::decode_content(&[&record[RECORD_HEAD..], &[0]].concat(), 0).is_err());
    assert_eq!(
        Session::decode_any(&with_head(&[&bytes[HEAD..], &[0]].concat())).unwrap_err(),
        SessionError::Trailing { found: 1 }
    );
}

/// Decodes a session that may be damaged; one that is accepted is valid and is written the same again.
fn decode_damaged(content: &[u8]) {
    if let Ok(session) = Session::decode_any(&with_head(content)) {
        assert_eq!(session.validate(), Ok(()));
        let again = Session::decode_any(&session.encode().unwrap()).unwrap();
        assert!(again.encode().unwrap() == session.encode().unwrap());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn damage_behind_a_fitting_checksum_never_gives_an_invalid_session(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        end in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let (session, record) = example();
        let (mut session, mut record) = (session[HEAD..].to_vec(), record[RECORD_HEAD..].to_vec());
        for (at, byte) in &changes {
            *at.get_mut(&mut session) = *byte;
            *at.get_mut(&mut record) = *byte;
        }
        if let Some(end) = end {
            session.truncate(end.index(session.len()));
        }
        decode_damaged(&session);
        if let Ok(record) = LogRecord::decode_content(&record, 0) {
            prop_assert_eq!(record.validate(), Ok(()));
        }
    }
}
