//! Session logs: with the session they give the pose graph of the process that wrote them, and an incomplete tail is cut off.

mod common;

use common::{Log, bits, ring_log};
use msg::{Odometry, Pose2, Scan, SlamMode};
use slam::session::log::{LogContents, LogPosition, LogRecordBuilder, continuation};
use slam::{BackEnd, FrontEnd, InitialPose, Session, SessionError, SessionIdentity, SlamConfig};

/// Feeds a log, with each node recorded before the back end gets it; a record after each `per_record` scans.
fn feed_logged(
    (front, back): (&mut FrontEnd, &mut BackEnd),
    log: &[(Odometry, Box<Scan>, Pose2)],
    newest: &mut LogPosition,
    per_record: usize,
) -> Vec<u8> {
    let (mut builder, mut bytes) = (LogRecordBuilder::default(), Vec::new());
    for (k, (odometry, scan, _)) in log.iter().enumerate() {
        front.add_odometry(odometry);
        if let Some(node) = front.process(scan).node {
            builder.add(&node, None);
            front.add_frame_update(back.add_node(node));
        }
        let is_last = k + 1 == log.len();
        if (is_last || k % per_record == per_record - 1) && !builder.is_empty() {
            bytes.extend(builder.encode(&identity(), newest, &front.state()).unwrap());
        }
    }
    bytes
}

/// Bits of all poses of the graph, and of the pose that the front end has.
fn state_bits(front: &FrontEnd, back: &BackEnd) -> Vec<[u64; 3]> {
    bits(back.graph().poses().iter().copied().chain([front.local_from_base()]))
}

fn identity() -> SessionIdentity {
    SessionIdentity::new(1, 7, &SlamConfig::default())
}

fn begun(session: Option<Session>) -> (FrontEnd, BackEnd) {
    let start = if session.is_some() { InitialPose::Continue } else { InitialPose::Unknown };
    slam::create_or_resume(SlamConfig::default(), session, SlamMode::Mapping, start)
}

#[test]
fn a_session_and_its_log_give_the_bits_of_the_process_that_wrote_them() {
    let log = ring_log();
    let (before, rest) = log.split_at(log.len() / 3);
    let (logged, after) = rest.split_at(rest.len() / 2);
    for has_session in [true, false] {
        let (mut front, mut back) = begun(None);
        let mut newest = LogPosition::default();
        let mut bytes = feed_logged((&mut front, &mut back), before, &mut newest, 2);
        let mut saved = None;
        if has_session {
            let session = Session { log: newest, ..back.session(identity(), Some(front.state()), &[]) };
            saved = Some(Session::decode(&session.encode().unwrap(), &identity()).unwrap());
        }
        bytes.extend(feed_logged((&mut front, &mut back), logged, &mut newest, 2));
        let contents = LogContents::decode(&bytes);
        assert!(contents.incomplete_tail.is_none());
        let position = saved.as_ref().map(|session| session.log).unwrap_or_default();
        let records: Vec<_> = contents.records.into_iter().map(|(record, _)| record).collect();
        let chain = continuation(position, records);
        assert_eq!(chain.last().unwrap().position, newest);
        let last = chain.last().unwrap().front.last.unwrap().stamp;

        let (_, mut replayed) = begun(saved);
        let state = replayed.replay(chain);
        assert!(state.is_some());
        let session = replayed.session(identity(), state, &[]);
        assert!(session.front.is_some());
        let (mut front_again, mut back_again) = begun(Some(session));
        let poses = |back: &BackEnd| bits(back.graph().poses().iter().copied());
        assert!(poses(&back_again) == poses(&back));
        // The scans after the record, then the rest: as if the process had never ended.
        let missed = logged.iter().filter(|(_, scan, _)| scan.header.stamp > last).cloned();
        let again: Log = missed.chain(after.iter().cloned()).collect();
        feed_logged((&mut front_again, &mut back_again), &again, &mut newest.clone(), 5);
        feed_logged((&mut front, &mut back), after, &mut newest, 5);
        assert!(state_bits(&front_again, &back_again) == state_bits(&front, &back));
    }
}

#[test]
fn a_torn_log_keeps_its_whole_records() {
    let log = ring_log();
    let (mut front, mut back) = begun(None);
    let bytes = feed_logged((&mut front, &mut back), &log[..60], &mut LogPosition::default(), 5);
    let whole = LogContents::decode(&bytes);
    let (count, ends) = (whole.records.len(), whole.records.iter().map(|(_, end)| *end).collect::<Vec<_>>());
    assert!(count >= 3);
    for cut in [1, 15, 16, 400, bytes.len() / 2, bytes.len() - 1] {
        let contents = LogContents::decode(&bytes[..cut]);
        let expected = ends.iter().filter(|end| **end <= cut as u64).count();
        assert_eq!(contents.records.len(), expected, "cut at {cut}");
        assert!(contents.incomplete_tail.is_some());
    }
    // A record whose bytes changed ends the log, and one that is missing ends the chain.
    let mut changed = bytes.clone();
    changed[ends[0] as usize + 100] ^= 1;
    assert_eq!(LogContents::decode(&changed).records.len(), 1);
    let mut records: Vec<_> = whole.records.into_iter().map(|(record, _)| record).collect();
    records.remove(1);
    assert_eq!(continuation(LogPosition::default(), records).len(), 1);
}

#[test]
fn a_record_that_could_not_be_read_back_is_refused_and_the_log_goes_on() {
    let log = ring_log();
    let (mut front, mut back) = begun(None);
    let mut newest = LogPosition::default();
    let mut bytes = feed_logged((&mut front, &mut back), &log[..20], &mut newest, 5);
    let (written, whole) = (newest, LogContents::decode(&bytes).records);
    // No robot stands there.
    let mut node = whole[0].0.nodes[0].node.clone();
    node.local_from_base.x_m = f64::NAN;
    let mut builder = LogRecordBuilder::default();
    builder.add(&node, None);
    let why = builder.encode(&identity(), &mut newest, &front.state()).unwrap_err();
    assert!(!matches!(why, SessionError::Encoding(_)), "{why:?}");
    assert!(builder.is_empty() && newest == written);
    // The records after it follow from those before it.
    bytes.extend(feed_logged((&mut front, &mut back), &log[20..60], &mut newest, 5));
    let contents = LogContents::decode(&bytes);
    assert!(contents.incomplete_tail.is_none() && contents.records.len() > whole.len());
}
