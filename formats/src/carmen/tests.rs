//! Lines that are read, and lines that must be refused.

use super::*;

fn read(log: &str) -> (Vec<Record>, Vec<LineError>, u64) {
    let mut reader = Reader::new(log.as_bytes());
    let (mut records, mut errors) = (Vec::new(), Vec::new());
    for line in reader.by_ref() {
        match line {
            Ok(record) => records.push(record),
            Err(error) => errors.push(error),
        }
    }
    (records, errors, reader.skipped())
}

fn laser(log: &str) -> LaserLine {
    match read(log).0.pop() {
        Some(Record::Laser(line)) => line,
        other => panic!("{other:?}"),
    }
}

const ROBOTLASER: &str = "ROBOTLASER1 0 -0.5 1.0 0.25 81.9 0.01 0 5 1 2.5 3 81.91 0.5 0 \
    1.1 2.0 0.1 1.0 2.0 0.1 0 0 0 0 0 976052890.244111 robot 976052890.244111\n";

#[test]
fn reads_each_kind() {
    let line = laser(ROBOTLASER);
    assert_eq!(line.stamp, Stamp(976_052_890_244_111_000));
    assert_eq!(line.ranges_m, [1.0, 2.5, 3.0, 81.91, 0.5]);
    assert_eq!((line.angle_min_rad, line.angle_increment_rad), (-0.5, 0.25));
    assert!((line.base_from_scan.x_m - 0.1 * 0.1_f64.cos()).abs() < 1e-9);

    let line = laser("FLASER 3 1 2 3 9 9 9 0.5 -1 2 12.5 host 13.0");
    assert_eq!(line.odom_from_base, Pose2::new(0.5, -1.0, 2.0));
    assert_eq!(line.stamp, Stamp(12_500_000_000));
    assert!((line.angle_min_rad + 2.0 * line.angle_increment_rad - FRAC_PI_2).abs() < 1e-12);

    let (records, errors, skipped) = read("# a comment\n\nPARAM x y\nODOM 1 2 3 0.4 0.5 0 -2.884230 h 0\n");
    assert!(errors.is_empty());
    assert_eq!(skipped, 3);
    let stamp = Stamp(-2_884_230_000);
    let pose = Pose2::new(1.0, 2.0, 3.0);
    let line = OdometryLine { stamp, odom_from_base: pose, linear_m_s: 0.4, angular_rad_s: 0.5 };
    assert_eq!(records, [Record::Odometry(line)]);
}

#[test]
fn crops_to_the_central_beams() {
    let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    laser(ROBOTLASER).write_to(&mut scan, 7, Some(0.5));
    assert_eq!(scan.ranges_m(), [2.5, 3.0, 81.91]);
    assert_eq!((scan.angle_min_rad, scan.header.seq), (-0.25, 7));
    assert_eq!(scan.hits().count(), 2);
}

#[test]
fn a_malformed_line_is_named_and_the_next_one_read() {
    let cases = [
        ("ODOM 1 2", "pose", "the end of the line"),
        ("ODOM 1 2 x 0 0 0 1 h 1", "pose", "x"),
        ("ODOM 1 2 inf 0 0 0 1 h 1", "pose", "inf"),
        ("ODOM 1 2 3 0 0 0 noon h 1", "time", "noon"),
        ("FLASER 4097 1", "number of beams", "4097"),
        ("FLASER 0", "number of beams", "0"),
        ("FLASER -3", "number of beams", "-3"),
        ("FLASER 3 1 2", "range", "the end of the line"),
        ("FLASER 2 1 two 0 0 0 0 0 0 1 h 1", "range 2", "two"),
        ("ROBOTLASER1 0 -1.5 3 0.1 0 0 0 1 1 0 0 0 0 0 0 0 0 0 0 0 0 1 h 1", "maximum range", "0"),
    ];
    for (line, field, found) in cases {
        let (records, errors, _) = read(&format!("# first\n{line}\n{ROBOTLASER}"));
        assert_eq!(errors.len(), 1, "{line}");
        assert_eq!((errors[0].line, errors[0].field.as_str(), errors[0].found.as_str()), (2, field, found));
        assert_eq!(records.len(), 1, "{line}");
    }
}

#[test]
fn ranges_that_are_no_numbers_stay_in_their_place() {
    let line = laser("FLASER 3 nan 1e99 2 0 0 0 0 0 0 1 h 1");
    assert!(line.ranges_m[0].is_nan());
    assert_eq!(line.ranges_m[1..], [f32::INFINITY, 2.0]);
}

proptest::proptest! {
    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
        Reader::new(&bytes).count();
    }

    #[test]
    fn no_cut_or_flip_makes_it_panic(cut in 0_usize..250, at in 0_usize..250, value in proptest::num::u8::ANY) {
        let mut bytes = ROBOTLASER.repeat(2).into_bytes();
        bytes[at] = value;
        bytes.truncate(cut.max(at));
        Reader::new(&bytes).count();
    }
}
