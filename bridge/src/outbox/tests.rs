//! Against a socket that takes what it is told to.

use super::*;
use proptest::prelude::*;
use std::rc::Rc;

fn bytes(of: u8, length: usize) -> Bytes {
    Rc::new(vec![of; length])
}

fn topic(id: usize, depth: usize) -> Lane {
    Lane::Topic { id, depth, counted: true }
}

/// Writes everything, `room` bytes a call at most.
fn drain(outbox: &mut Outbox, room: usize) -> Vec<u8> {
    let mut out = Vec::new();
    let mut socket = |slices: &[IoSlice<'_>]| {
        let all: Vec<u8> = slices.iter().flat_map(|slice| slice.iter().copied()).collect();
        let take = all.len().min(room);
        out.extend_from_slice(&all[..take]);
        Ok(take)
    };
    while outbox.flush(&mut socket, &mut Pool::default()).unwrap() != Flushed::All {}
    out
}

#[test]
fn a_newer_map_takes_the_older_ones_place() {
    let (mut outbox, mut pool) = (Outbox::new(1000), Pool::default());
    outbox.push(topic(0, 1), bytes(1, 2), &mut pool).unwrap();
    outbox.push(topic(1, 9), bytes(2, 2), &mut pool).unwrap();
    outbox.push(topic(0, 1), bytes(3, 3), &mut pool).unwrap();
    assert_eq!(outbox.dropped(), 1);
    assert_eq!(drain(&mut outbox, 100), [3, 3, 3, 2, 2]);
}

#[test]
fn a_full_topic_loses_its_oldest_and_no_other_topic_does() {
    let (mut outbox, mut pool) = (Outbox::new(1000), Pool::default());
    outbox.push(topic(7, 2), bytes(9, 1), &mut pool).unwrap();
    (1..=4).for_each(|i| outbox.push(topic(3, 2), bytes(i, 1), &mut pool).unwrap());
    assert_eq!(outbox.dropped(), 2);
    assert_eq!(drain(&mut outbox, 1), [9, 3, 4]);
}

#[test]
fn small_frames_count_with_the_memory_they_take() {
    let (mut pool, limit) = (Pool::default(), 64 << 10);
    let mut outbox = Outbox::new(limit);
    for _ in 0..2000 {
        let mut frame = pool.take(52);
        Rc::make_mut(&mut frame).extend([7; 52]);
        let room = frame.capacity();
        outbox.push(topic(0, 4096), frame, &mut pool).unwrap();
        assert!(outbox.queue.len() * room <= limit);
    }
    assert!(outbox.dropped() > 1700 && outbox.queue.len() > 200);
}

#[test]
fn what_is_begun_goes_out_whole() {
    let (mut outbox, mut pool) = (Outbox::new(1000), Pool::default());
    outbox.push(topic(0, 1), bytes(1, 10), &mut pool).unwrap();
    let mut room = [4, 0].into_iter();
    let mut blocked = |_: &[IoSlice<'_>]| match room.next() {
        Some(4) => Ok(4),
        _ => Err(io::ErrorKind::WouldBlock.into()),
    };
    assert_eq!(outbox.flush(&mut blocked, &mut pool).unwrap(), Flushed::Blocked);
    outbox.push(topic(0, 1), bytes(2, 3), &mut pool).unwrap();
    outbox.forget(5, &mut pool);
    assert_eq!(drain(&mut outbox, 3), [1, 1, 1, 1, 1, 1, 2, 2, 2]);
    assert_eq!(outbox.dropped(), 0);
}

#[test]
fn answers_are_never_dropped_but_not_kept_without_end() {
    let (mut outbox, mut pool) = (Outbox::new(10), Pool::default());
    for _ in 0..4 {
        outbox.push(Lane::Answer, bytes(1, ANSWERS_BYTES_MAX / 4), &mut pool).unwrap();
    }
    assert_eq!(outbox.push(Lane::Answer, bytes(1, 1), &mut pool), Err(Overflow));
    (0..NOTICES_MAX + 5).for_each(|_| outbox.push(Lane::Notice, bytes(2, 100), &mut pool).unwrap());
    assert_eq!(outbox.dropped(), 5);
}

#[test]
fn a_turn_ends_so_that_others_get_theirs() {
    let (mut outbox, mut pool) = (Outbox::new(64 << 20), Pool::default());
    outbox.push(topic(0, 1), bytes(1, 5 << 20), &mut pool).unwrap();
    let mut calls = 0;
    let mut socket = |slices: &[IoSlice<'_>]| {
        calls += 1;
        Ok(slices.iter().map(|slice| slice.len()).sum())
    };
    assert_eq!(outbox.flush(&mut socket, &mut pool).unwrap(), Flushed::TurnOver);
    assert_eq!(calls, 1);
}

proptest! {
    #[test]
    fn never_beyond_its_bounds_and_whole_frames_only(
        pushes in prop::collection::vec((0_usize..5, 1_usize..4, 1_usize..60, any::<bool>()), 1..200),
        room in 1_usize..50,
    ) {
        let (mut outbox, mut pool) = (Outbox::new(300), Pool::default());
        let (mut pushed, mut out) = (0, Vec::new());
        for (id, depth, length, flush) in pushes {
            outbox.push(topic(id, depth), bytes(length as u8, length), &mut pool).unwrap();
            pushed += 1;
            prop_assert!(outbox.bytes() <= 300 + 60, "{}", outbox.bytes());
            if flush {
                let mut budget = room;
                let mut socket = |slices: &[IoSlice<'_>]| {
                    let all: Vec<u8> = slices.iter().flat_map(|slice| slice.iter().copied()).collect();
                    let take = all.len().min(budget);
                    budget -= take;
                    out.extend_from_slice(&all[..take]);
                    if take == 0 { Err(io::ErrorKind::WouldBlock.into()) } else { Ok(take) }
                };
                outbox.flush(&mut socket, &mut pool).unwrap();
            }
        }
        out.extend(drain(&mut outbox, room));
        // Each frame is `length` bytes of value `length`: they must come out whole.
        let mut frames = 0;
        let mut rest = out.as_slice();
        while let [length, ..] = rest {
            let frame = rest.get(..usize::from(*length));
            prop_assert!(frame.is_some_and(|frame| frame.iter().all(|byte| byte == length)));
            rest = &rest[usize::from(*length)..];
            frames += 1;
        }
        prop_assert_eq!(frames + outbox.dropped(), pushed);
    }
}
