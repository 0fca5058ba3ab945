//! Messages survive the wire, and no bytes make a reader panic.

use link::content::{compress, decode, encode};
use link::part::hash;
use link::scan::SCAN_BEAMS_MAX;
use link::wire::{
    BaseState, CHUNK_BYTES_MAX, COMPLETE, Chunk, HeldPage, MESSAGE_MAX, RECEIPTS_MAX, Receipt, RobotState,
    VERSION,
};
use link::{DecimatedScan, Envelope, Message, PartContent, PartKey, PartReceiver, ScanRate, WireError};
use msg::{
    Battery, Header, Monotonic, Pose2, PoseEstimate, RobotFrameTransform, Stamp, Submap, SubmapEdge,
    SubmapPoses, TRANSFORMS_MAX, Transforms, VelocityCommand,
};
use proptest::prelude::*;

fn battery() -> Battery {
    Battery {
        voltage_v: 11.8,
        current_a: -0.9,
        percentage: 0.42,
        power_supply_status: 2,
        is_present: 1,
        ..Battery::default()
    }
}

fn envelope(message: Message) -> Envelope {
    Envelope { session: 3, to: 8, sent: Monotonic(5), answers: Monotonic(4), message }
}

fn scan(beams: usize) -> DecimatedScan {
    DecimatedScan {
        stamp: Stamp(-7),
        angle_min_rad: -3.0,
        angle_increment_rad: 0.035,
        time_increment_s: 0.001,
        scan_time_s: 0.1,
        range_min_m: 0.12,
        range_max_m: 3.5,
        // 3.5 m and its half are whole numbers of steps.
        ranges_m: [3.5, f32::INFINITY, f32::NEG_INFINITY, 1.75].into_iter().cycle().take(beams).collect(),
    }
}

fn messages() -> Vec<Message> {
    let header = Header { stamp: Stamp(-9), ..Header::default() };
    let transforms = [RobotFrameTransform {
        parent_frame: 1,
        child_frame: 2,
        translation_m: [0.5; 3],
        rotation_xyzw: [0.25; 4],
    }; TRANSFORMS_MAX];
    let receipt = Receipt { key: PartKey::Tile(-1, 2), hash: 77, received: COMPLETE };
    let chunk = |len: usize| Chunk {
        key: PartKey::Submap(4),
        hash: 8,
        total: len as u32 + 10,
        offset: 10,
        bytes: vec![7; len],
    };
    vec![
        Message::RobotState(RobotState {
            list_of: 9,
            run: 7,
            waiting: 3,
            is_stopped: true,
            is_known: true,
            is_late: true,
            interruptions: 5,
            ..RobotState::default()
        }),
        Message::BaseState(BaseState { run: 0x1234_5678, is_stopped: true, is_known: false, scans: None }),
        Message::BaseState(BaseState { scans: Some(ScanRate::new(5.0, 180)), ..BaseState::default() }),
        Message::Scan(Box::new(scan(SCAN_BEAMS_MAX))),
        Message::Scan(Box::new(scan(0))),
        Message::Velocity(VelocityCommand { linear_m_s: 0.2, angular_rad_s: -1.0, ..Default::default() }),
        Message::PoseEstimate(PoseEstimate {
            header,
            scan_seq: 5,
            map_from_odom: Pose2::new(1.0, 2.0, 0.5),
            map_from_base: Pose2::new(-1.0, 2.0, 0.25),
            covariance: [0.5; 6],
            state: 1,
            nodes: 7,
            closures: 2,
            ..Default::default()
        }),
        Message::Transforms(Box::new(Transforms {
            header,
            len: TRANSFORMS_MAX as u32,
            reserved: 0,
            transforms,
        })),
        Message::Battery(battery()),
        Message::Chunk(chunk(CHUNK_BYTES_MAX)),
        Message::Held(HeldPage { page: 1, pages: 2, list: 6, parts: vec![receipt; RECEIPTS_MAX] }),
        Message::Acknowledgement(vec![receipt; RECEIPTS_MAX]),
    ]
}

#[test]
fn every_message_survives_the_wire_within_its_bound() {
    for message in messages() {
        let envelope = envelope(message);
        let bytes = envelope.to_bytes();
        assert!(bytes.len() <= MESSAGE_MAX, "{:?} has {} bytes", envelope.message.kind(), bytes.len());
        assert_eq!(Envelope::from_bytes(&bytes), Ok(envelope));
    }
}

#[test]
fn another_version_is_refused_by_name() {
    let mut bytes = envelope(Message::BaseState(BaseState::default())).to_bytes();
    bytes[0] = VERSION + 1;
    let why = Envelope::from_bytes(&bytes).unwrap_err();
    assert_eq!(why, WireError::Version(VERSION + 1));
    assert!(why.to_string().contains("update"), "{why}");
}

#[test]
fn a_scan_out_of_range_is_refused() {
    let is_read = |scan: DecimatedScan| {
        Envelope::from_bytes(&envelope(Message::Scan(Box::new(scan))).to_bytes()).is_ok()
    };
    assert!(is_read(scan(180)));
    assert!(!is_read(DecimatedScan { angle_increment_rad: f32::NAN, ..scan(180) }));
    assert!(!is_read(DecimatedScan { range_min_m: 3.6, ..scan(180) }));
    assert!(!is_read(DecimatedScan { range_max_m: f32::INFINITY, ..scan(180) }));
    let nothing = Some(ScanRate { period_ms: 0, beams: 90 });
    let state = Message::BaseState(BaseState { scans: nothing, ..BaseState::default() });
    assert!(Envelope::from_bytes(&envelope(state).to_bytes()).is_err(), "a rate without a period");
}

#[test]
fn a_velocity_that_is_no_number_is_refused() {
    let command = VelocityCommand { linear_m_s: f64::NAN, ..Default::default() };
    assert!(Envelope::from_bytes(&envelope(Message::Velocity(command)).to_bytes()).is_err());
}

#[test]
fn submaps_and_their_poses_survive_compression() {
    let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
    (submap.id, submap.grid.resolution_m) = (3, 0.05);
    (submap.grid.width, submap.grid.height) = (400, 300);
    submap.cells[..120_000].iter_mut().enumerate().for_each(|(i, cell)| *cell = (i % 90) as i8);
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    (poses.len, poses.edges_len) = (2, 1);
    poses.robot_map_from_submap[1] = Pose2::new(1.0, 2.0, 0.5);
    poses.edges[0] = SubmapEdge { a: 0, b: 1, information: [2.0; 6] };
    let parts = [
        (PartKey::Submap(3), PartContent::Submap(submap.clone())),
        (PartKey::SubmapPoses, PartContent::SubmapPoses(poses.clone())),
    ];
    for (key, content) in parts {
        let plain = encode(&content);
        match decode(key, hash(&plain), &compress(&plain)).unwrap() {
            PartContent::Submap(found) => assert!(*found == *submap),
            PartContent::SubmapPoses(found) => assert!(*found == *poses),
            _ => panic!("another kind of part"),
        }
        assert!(decode(PartKey::MapHeader, hash(&plain), &compress(&plain)).is_err());
    }
}

proptest! {
    #[test]
    fn no_bytes_make_a_reader_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = Envelope::from_bytes(&bytes);
    }

    #[test]
    fn no_damage_to_a_message_makes_a_reader_panic(
        which in 0..messages().len(), at in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<prop::sample::Index>()
    ) {
        let mut bytes = envelope(messages()[which].clone()).to_bytes();
        let index = at.index(bytes.len());
        bytes[index] = byte;
        if let Ok(found) = Envelope::from_bytes(&bytes) {
            let again = found.to_bytes();
            prop_assert!(again.len() <= MESSAGE_MAX);
            if let Message::Chunk(chunk) = found.message {
                PartReceiver::default().receive(&chunk);
            }
        }
        bytes.truncate(cut.index(bytes.len()));
        let _ = Envelope::from_bytes(&bytes);
    }

    #[test]
    fn no_content_makes_a_reader_panic(kind in 0..4usize, plain in proptest::collection::vec(any::<u8>(), 0..5000)) {
        let key = [PartKey::MapHeader, PartKey::SubmapPoses, PartKey::Tile(0, 0), PartKey::Submap(0)][kind];
        let _ = decode(key, hash(&plain), &compress(&plain));
        let _ = decode(key, hash(&plain), &plain);
    }

    #[test]
    fn a_receiver_holds_a_bounded_amount(chunks in proptest::collection::vec((any::<u64>(), 1..300_000u32, 0..600i32), 0..300)) {
        let mut receiver = PartReceiver::default();
        for (hash, total, x) in chunks {
            let chunk = Chunk { key: PartKey::Tile(x, 0), hash, total, offset: 0, bytes: vec![0] };
            receiver.receive(&chunk);
            prop_assert!(receiver.take_acknowledgements().len() <= RECEIPTS_MAX);
        }
        prop_assert!(receiver.list().len() <= 2);
    }
}
