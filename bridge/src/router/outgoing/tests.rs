//! The queue against a socket that accepts a given number of bytes.

use super::*;
use proptest::prelude::*;
use std::rc::Rc;

fn bytes(of: u8, length: usize) -> SharedFrame {
    Rc::new(vec![of; length])
}

fn topic(id: usize, depth: usize) -> FrameKind {
    FrameKind::Topic {
        id,
        depth,
        counted: true,
        urgency: Urgency::Ordinary,
        expires: false,
        map: MapRole::None,
    }
}

/// Writes everything, at most `room` bytes in a call.
fn drain(queue: &mut OutgoingQueue, room: usize) -> Vec<u8> {
    let mut out = Vec::new();
    let mut socket = |slices: &[IoSlice<'_>]| {
        let all: Vec<u8> = slices.iter().flat_map(|slice| slice.iter().copied()).collect();
        let take = all.len().min(room);
        out.extend_from_slice(&all[..take]);
        Ok(take)
    };
    while queue.flush(&mut socket, &mut BufferPool::default()).unwrap() != FlushOutcome::Complete {}
    out
}

#[test]
fn a_newer_map_replaces_the_older_one() {
    let (mut queue, mut pool) = (OutgoingQueue::new(1000), BufferPool::default());
    queue.push(topic(0, 1), bytes(1, 2), &mut pool).unwrap();
    queue.push(topic(1, 9), bytes(2, 2), &mut pool).unwrap();
    queue.push(topic(0, 1), bytes(3, 3), &mut pool).unwrap();
    assert_eq!(queue.dropped(), 1);
    assert_eq!(drain(&mut queue, 100), [3, 3, 3, 2, 2]);
}

#[test]
fn a_full_topic_drops_its_oldest_message_and_no_other_topics() {
    let (mut queue, mut pool) = (OutgoingQueue::new(1000), BufferPool::default());
    queue.push(topic(7, 2), bytes(9, 1), &mut pool).unwrap();
    (1..=4).for_each(|i| queue.push(topic(3, 2), bytes(i, 1), &mut pool).unwrap());
    assert_eq!(queue.dropped(), 2);
    assert_eq!(drain(&mut queue, 1), [9, 3, 4]);
}

#[test]
fn a_small_frame_counts_as_the_memory_of_its_buffer() {
    let (mut pool, limit) = (BufferPool::default(), 64 << 10);
    let mut queue = OutgoingQueue::new(limit);
    for _ in 0..2000 {
        let mut frame = pool.acquire(52);
        Rc::make_mut(&mut frame).extend([7; 52]);
        let room = frame.capacity();
        queue.push(topic(0, 4096), frame, &mut pool).unwrap();
        assert!(queue.frames.len() * room <= limit);
    }
    assert!(queue.dropped() > 1700 && queue.frames.len() > 200);
}

#[test]
fn a_frame_that_is_partly_written_is_written_whole() {
    let (mut queue, mut pool) = (OutgoingQueue::new(1000), BufferPool::default());
    queue.push(topic(0, 1), bytes(1, 10), &mut pool).unwrap();
    let mut room = [4, 0].into_iter();
    let mut blocked = |_: &[IoSlice<'_>]| match room.next() {
        Some(4) => Ok(4),
        _ => Err(io::ErrorKind::WouldBlock.into()),
    };
    assert_eq!(queue.flush(&mut blocked, &mut pool).unwrap(), FlushOutcome::Blocked);
    queue.push(topic(0, 1), bytes(2, 3), &mut pool).unwrap();
    queue.remove_topic(5, &mut pool);
    assert_eq!(drain(&mut queue, 3), [1, 1, 1, 1, 1, 1, 2, 2, 2]);
    assert_eq!(queue.dropped(), 0);
}

#[test]
fn replies_are_never_dropped_and_overflow_at_their_limit() {
    let (mut queue, mut pool) = (OutgoingQueue::new(10), BufferPool::default());
    for _ in 0..4 {
        queue.push(FrameKind::Reply, bytes(1, REPLY_BYTES_MAX / 4), &mut pool).unwrap();
    }
    assert_eq!(queue.push(FrameKind::Reply, bytes(1, 1), &mut pool), Err(Overflow));
    (0..NOTICES_MAX + 5).for_each(|_| queue.push(FrameKind::Notice, bytes(2, 100), &mut pool).unwrap());
    assert_eq!(queue.dropped(), 5);
}

#[test]
fn a_turn_ends_after_its_bytes() {
    let (mut queue, mut pool) = (OutgoingQueue::new(64 << 20), BufferPool::default());
    queue.push(topic(0, 1), bytes(1, 5 << 20), &mut pool).unwrap();
    let mut calls = 0;
    let mut socket = |slices: &[IoSlice<'_>]| {
        calls += 1;
        Ok(slices.iter().map(|slice| slice.len()).sum())
    };
    assert_eq!(queue.flush(&mut socket, &mut pool).unwrap(), FlushOutcome::TurnEnded);
    assert_eq!(calls, 1);
}

proptest! {
    #[test]
    fn the_queue_stays_bounded_and_writes_whole_frames(
        pushes in prop::collection::vec((0_usize..5, 1_usize..4, 1_usize..60, any::<bool>()), 1..200),
        room in 1_usize..50,
    ) {
        let (mut queue, mut pool) = (OutgoingQueue::new(300), BufferPool::default());
        let (mut pushed, mut out) = (0, Vec::new());
        for (id, depth, length, flush) in pushes {
            queue.push(topic(id, depth), bytes(length as u8, length), &mut pool).unwrap();
            pushed += 1;
            prop_assert!(queue.bytes() <= 300 + 60, "{}", queue.bytes());
            if flush {
                let mut budget = room;
                let mut socket = |slices: &[IoSlice<'_>]| {
                    let all: Vec<u8> = slices.iter().flat_map(|slice| slice.iter().copied()).collect();
                    let take = all.len().min(budget);
                    budget -= take;
                    out.extend_from_slice(&all[..take]);
                    if take == 0 { Err(io::ErrorKind::WouldBlock.into()) } else { Ok(take) }
                };
                queue.flush(&mut socket, &mut pool).unwrap();
            }
        }
        out.extend(drain(&mut queue, room));
        // Each frame is `length` bytes of value `length`: each must arrive whole.
        let mut frames = 0;
        let mut rest = out.as_slice();
        while let [length, ..] = rest {
            let frame = rest.get(..usize::from(*length));
            prop_assert!(frame.is_some_and(|frame| frame.iter().all(|byte| byte == length)));
            rest = &rest[usize::from(*length)..];
            frames += 1;
        }
        prop_assert_eq!(frames + queue.dropped(), pushed);
    }
}
