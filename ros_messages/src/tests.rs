//! Messages encode and decode to themselves, to known bytes, and random bytes never panic.

use super::*;
use crate::cdr::{Reader, Writer};
use bytemuck::Zeroable;
use msg::{
    GridHeader, GridView, Header, MapTransforms, Pose2, RobotFrame, RobotFrameTransform, RobotId, Stamp,
    Transforms,
};
use proptest::prelude::*;
use std::fmt::Debug;

/// Encodes behind `before` other bytes, as a frame does, and decodes; ROS 1 must say the same.
fn round<M: Message + PartialEq + Debug>(message: &M, before: usize) -> M {
    let mut out = vec![9; before];
    encode(message, &mut out);
    let decoded = decode(&out[before..]).unwrap();
    out.truncate(before);
    encode_as(Dialect::Ros1, message, &mut out);
    assert_eq!(decode_as::<M>(Dialect::Ros1, &out[before..]).unwrap(), decoded);
    decoded
}

/// Every shortening of a payload is refused or still whole (padding cut), never a panic.
fn survives_cuts<M: Message + Debug>(message: &M) {
    let mut out = Vec::new();
    encode(message, &mut out);
    (0..out.len()).for_each(|end| drop(decode::<M>(&out[..end])));
}

fn stamp() -> impl Strategy<Value = Stamp> {
    (i64::from(i32::MIN) * 1_000_000_000..i64::from(i32::MAX) * 1_000_000_000).prop_map(Stamp)
}

fn text() -> impl Strategy<Value = String> {
    "[^\0]{0,12}"
}

fn floats() -> impl Strategy<Value = Vec<f32>> {
    prop::collection::vec(-1e6_f32..1e6, 0..50)
}

fn twist() -> impl Strategy<Value = Twist> {
    (any::<[i32; 3]>(), any::<[i32; 3]>())
        .prop_map(|(l, a)| Twist { linear: l.map(|v| f64::from(v) * 1e-6), angular: a.map(f64::from) })
}

fn space() -> impl Strategy<Value = ([f64; 3], [f64; 4])> {
    (prop::array::uniform3(-1e3..1e3), prop::array::uniform4(-1.0..1.0))
}

fn transform() -> impl Strategy<Value = TransformStamped> {
    (stamp(), text(), text(), space()).prop_map(
        |(stamp, frame_id, child_frame_id, (translation, rotation))| TransformStamped {
            stamp,
            frame_id,
            child_frame_id,
            translation,
            rotation,
        },
    )
}

proptest! {
    #[test]
    fn small_messages_decode_to_themselves(twist in twist(), at in stamp(), name in text(), number in any::<i32>(), flag in any::<bool>(),
                      data in floats(), before in 0_usize..9) {
        prop_assert_eq!(round(&twist, before), twist);
        let stamped = TwistStamped { stamp: at, frame_id: name.clone(), twist };
        prop_assert_eq!(&round(&stamped, before), &stamped);
        survives_cuts(&stamped);
        prop_assert_eq!(round(&Int32(number), before), Int32(number));
        prop_assert_eq!(round(&Bool(flag), before), Bool(flag));
        prop_assert_eq!(round(&Clock { clock: at }, before), Clock { clock: at });
        prop_assert_eq!(round(&Text(name.clone()), before), Text(name));
        let array = Float32MultiArray { data };
        prop_assert_eq!(&round(&array, before), &array);
        survives_cuts(&array);
    }

    #[test]
    fn scans_decode_to_themselves(stamp in stamp(), frame_id in text(), v in any::<[i16; 7]>(), ranges in floats(), intensities in floats(),
             before in 0_usize..9) {
        let [angle_min, angle_max, angle_increment, time_increment, scan_time, range_min, range_max] = v.map(f32::from);
        let scan = LaserScan { stamp, frame_id, angle_min, angle_max, angle_increment, time_increment, scan_time,
                               range_min, range_max, ranges, intensities };
        prop_assert_eq!(&round(&scan, before), &scan);
        survives_cuts(&scan);
    }

    #[test]
    fn hand_controllers_decode_to_themselves(stamp in stamp(), frame_id in text(), axes in floats(), buttons in prop::collection::vec(any::<i32>(), 0..20),
              (upper, lower) in any::<(bool, bool)>(), before in 0_usize..9) {
        let joy = Joy { stamp, frame_id, axes, buttons };
        prop_assert_eq!(&round(&joy, before), &joy);
        survives_cuts(&joy);
        let hand = HandInputs { button_upper: upper, button_lower: lower, press_middle: 0.5, ..Default::default() };
        prop_assert_eq!(round(&hand, before), hand);
    }

    #[test]
    fn battery_states_decode_to_themselves(stamp in stamp(), frame_id in text(), v in any::<[i16; 7]>(), codes in any::<[u8; 3]>(),
              is_present in 0_u8..2, cell_voltage in floats(), cell_temperature in floats(), location in text(), before in 0_usize..9) {
        let [voltage_v, temperature_c, current_a, charge_ah, capacity_ah, design_capacity_ah, percentage] = v.map(f32::from);
        let [power_supply_status, health, technology] = codes;
        let battery = msg::Battery {
            header: msg::Header { stamp, ..Default::default() }, voltage_v, temperature_c, current_a, charge_ah, capacity_ah,
            design_capacity_ah, percentage, power_supply_status, health, technology, is_present,
        };
        let serial_number = location.clone();
        let message = BatteryState { frame_id, battery, cell_voltage, cell_temperature, location, serial_number };
        prop_assert_eq!(&round(&message, before), &message);
        survives_cuts(&message);
        // What the fleet has of it is the same, and what it writes of it is a whole message.
        for dialect in [Dialect::Ros1, Dialect::Ros2] {
            let mut out = Vec::new();
            encode_as(dialect, &message, &mut out);
            let read = |bytes: &[u8]| Reader::with(dialect, bytes).and_then(|mut from| battery::read_battery(&mut from));
            prop_assert_eq!(read(&out).unwrap(), battery);
            (0..out.len()).for_each(|end| drop(read(&out[..end])));
            let mut out = Vec::new();
            battery::write_battery(&mut Writer::with(dialect, &mut out), &battery);
            let want = BatteryState { battery, ..BatteryState::default() };
            prop_assert_eq!(decode_as::<BatteryState>(dialect, &out).unwrap(), want);
        }
    }

    #[test]
    fn transforms_decode_to_themselves(transforms in prop::collection::vec(transform(), 0..5), before in 0_usize..9) {
        let message = TfMessage { transforms };
        prop_assert_eq!(&round(&message, before), &message);
        survives_cuts(&message);
    }

    #[test]
    fn odometry_decodes_to_itself(stamp in stamp(), frame_id in text(), child_frame_id in text(), space in space(), twist in twist()) {
        let (position, orientation) = space;
        let (pose_covariance, twist_covariance) = ([0.1; 36], [0.2; 36]);
        let message = Odometry {
            stamp, frame_id, child_frame_id, position, orientation, pose_covariance, twist, twist_covariance,
        };
        prop_assert_eq!(&round(&message, 3), &message);
        survives_cuts(&message);
    }

    #[test]
    fn grids_decode_to_themselves(stamp in stamp(), frame_id in text(), width in 0_u32..20, height in 0_u32..20, space in space(), seed in any::<i8>()) {
        let (position, orientation) = space;
        let data = (0..width * height).map(|i| seed.wrapping_add(i as i8)).collect();
        let message = OccupancyGrid { stamp, frame_id, resolution: 0.05, width, height, position, orientation, data };
        prop_assert_eq!(&round(&message, 5), &message);
        survives_cuts(&message);
    }

    #[test]
    fn random_bytes_decode_or_are_an_error(mut bytes in prop::collection::vec(any::<u8>(), 0..400), small in any::<bool>()) {
        if small {
            // Short lengths get further into a message than random ones.
            bytes.iter_mut().skip(4).for_each(|byte| *byte = if *byte < 200 { 0 } else { *byte % 8 });
        }
        bytes.splice(..bytes.len().min(4), crate::cdr::ENCAPSULATION);
        let _ = (decode::<Twist>(&bytes), decode::<TwistStamped>(&bytes), decode::<Text>(&bytes));
        let _ = (decode::<LaserScan>(&bytes), decode::<TfMessage>(&bytes), decode::<OccupancyGrid>(&bytes));
        let _ = (decode::<Odometry>(&bytes), decode::<Float32MultiArray>(&bytes), decode::<Clock>(&bytes));
        let _ = (decode::<Int32>(&bytes), decode::<Bool>(&bytes), decode::<Empty>(&bytes));
        let _ = (decode::<Joy>(&bytes), decode::<HandInputs>(&bytes), decode::<BatteryState>(&bytes));
        let _ = (decode_as::<LaserScan>(Dialect::Ros1, &bytes), decode_as::<TfMessage>(Dialect::Ros1, &bytes));
    }

    #[test]
    fn cells_become_table_values(cells in prop::collection::vec(any::<i8>(), 0..300), filled in 0_usize..300) {
        let mut cells = cells;
        let end = filled.min(cells.len());
        cells[..end].fill(msg::grid::UNKNOWN);
        let table = msg::grid::trinary_table();
        let header = GridHeader { width: cells.len() as u32, height: 1, resolution_m: 0.05, ..Default::default() };
        let mut out = Vec::new();
        write::occupancy_grid(&mut Writer::new(&mut out), "map", &table, GridView::new(&header, &cells).unwrap());
        let grid: OccupancyGrid = decode(&out).unwrap();
        let want: Vec<i8> = cells.iter().map(|cell| table[*cell as u8 as usize]).collect();
        prop_assert_eq!(grid.data, want);
    }
}

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

fn header(stamp: i64) -> Header {
    Header { stamp: Stamp(stamp), ..Default::default() }
}

/// A reading that is not a number is none, and no error: drivers send NaN for what they do not measure.
#[test]
fn a_battery_state_keeps_what_is_not_measured() {
    let mut out = Vec::new();
    let battery = msg::Battery { percentage: f32::NAN, voltage_v: 11.8, ..Default::default() };
    encode(&BatteryState { battery, ..Default::default() }, &mut out);
    let read: BatteryState = decode(&out).unwrap();
    assert!(read.battery.percentage.is_nan() && read.battery.voltage_v == 11.8);
    // The count of cells is checked before anything is reserved.
    let cells = out.len() - 20;
    out[cells..cells + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(decode::<BatteryState>(&out).unwrap_err().to_string().contains("cell_voltage needs"));
}

/// Lengths as rclpy and Fast DDS have them for the same content.
#[test]
fn messages_have_the_lengths_of_fast_cdr() {
    let length = |fill: &dyn Fn(&mut Writer<'_>)| {
        let mut out = Vec::new();
        fill(&mut Writer::new(&mut out));
        out.len()
    };
    assert_eq!(length(&|to| Twist::default().write(to)), 52);
    assert_eq!(length(&|to| Clock::default().write(to)), 12);
    assert_eq!(length(&|to| Bool(true).write(to)), 5);
    assert_eq!(length(&|to| Empty.write(to)), 5);
    let mut scan = msg::Scan::zeroed();
    scan.len = 180;
    assert_eq!(length(&|to| write::laser_scan(to, "robot1/laser", &scan)), 788);
    assert_eq!(length(&|to| write::slam_stats(to, &Default::default())), 16 + 4 * 7);
}

#[test]
fn a_transform_has_the_known_bytes() {
    let transform = TransformStamped {
        stamp: Stamp(1_000_000_002),
        frame_id: "map".into(),
        child_frame_id: "ab".into(),
        translation: [1.0, 0.0, 0.0],
        rotation: [0.0, 0.0, 0.0, 1.0],
    };
    let mut out = Vec::new();
    encode(&transform, &mut out);
    let mut want = vec![0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0];
    want.extend_from_slice(b"\x04\0\0\0map\0\x03\0\0\0ab\0\0");
    // Doubles begin at the next multiple of 8 behind the encapsulation header: 24 is one.
    assert_eq!(want.len(), 28);
    for value in [1.0_f64, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0] {
        want.extend_from_slice(&value.to_le_bytes());
    }
    assert_eq!(out, want);
}

#[test]
fn a_scan_is_encoded_field_by_field() {
    let mut scan = msg::Scan::zeroed();
    scan.header = header(-1);
    scan.len = 3;
    (scan.angle_min_rad, scan.angle_increment_rad) = (-0.5, 0.25);
    (scan.range_min_m, scan.range_max_m) = (0.12, 3.5);
    scan.ranges_m[..3].copy_from_slice(&[1.0, f32::INFINITY, 2.0]);
    let mut out = Vec::new();
    write::laser_scan(&mut Writer::new(&mut out), "base_scan_1", &scan);
    let ros: LaserScan = decode(&out).unwrap();
    assert_eq!((ros.stamp, ros.frame_id.as_str()), (Stamp(-1), "base_scan_1"));
    assert_eq!((ros.angle_min, ros.angle_max, ros.angle_increment), (-0.5, 0.0, 0.25));
    assert_eq!(ros.ranges, [1.0, f32::INFINITY, 2.0]);
    assert!(ros.intensities.is_empty());
}

#[test]
fn all_transforms_have_their_frame_names() {
    let names = FrameNames::new(NameStyle::Flat, &3.into());
    let mut transforms = Transforms { header: header(7), len: 3, ..Default::default() };
    let transform = |parent: u32, child: u32| RobotFrameTransform {
        parent_frame: parent,
        child_frame: child,
        ..Default::default()
    };
    transforms.transforms[0] = transform(RobotFrame::Odom as u32, RobotFrame::BaseFootprint as u32);
    transforms.transforms[1] = transform(99, RobotFrame::BaseLink as u32);
    transforms.transforms[2] = transform(RobotFrame::BaseLink as u32, RobotFrame::BaseScan as u32);
    let mut out = Vec::new();
    write::transforms(&mut Writer::new(&mut out), &names, robot(2), &transforms);
    let tree: TfMessage = decode(&out).unwrap();
    let edges: Vec<_> =
        tree.transforms.iter().map(|t| (t.frame_id.as_str(), t.child_frame_id.as_str())).collect();
    assert_eq!(edges, [("odom_2", "base_footprint_2"), ("base_link_2", "base_scan_2")]);

    let map_from_odom = Pose2::new(1.0, 2.0, 0.6);
    out.clear();
    let slash = FrameNames::new(NameStyle::Slash, &3.into());
    write::map_from_odom(
        &mut Writer::new(&mut out),
        &slash,
        robot(3),
        header(9).stamp,
        (None, map_from_odom),
    );
    let tree: TfMessage = decode(&out).unwrap();
    assert_eq!(tree.transforms[0].frame_id, "robot3/map");
    assert_eq!(tree.transforms[0].child_frame_id, "robot3/odom");
    assert_eq!(tree.transforms[0].translation, [1.0, 2.0, 0.0]);
    assert!((2.0 * tree.transforms[0].rotation[2].asin() - 0.6).abs() < 1e-12);

    let mut map_transforms = MapTransforms::default();
    map_transforms.robots[1] =
        msg::MapTransform { map_from_robot_map: Pose2::new(3.0, 0.0, 0.0), known: 1, map_frame: 0 };
    out.clear();
    write::map_transforms(&mut Writer::new(&mut out), &names, Stamp(5), &map_transforms);
    let tree: TfMessage = decode(&out).unwrap();
    assert_eq!(tree.transforms.len(), 1);
    assert_eq!(
        (tree.transforms[0].frame_id.as_str(), tree.transforms[0].child_frame_id.as_str()),
        ("map", "map_2")
    );
}

#[test]
fn odometry_is_encoded_field_by_field() {
    let about = msg::Odometry {
        header: header(11),
        odom_from_base: Pose2::new(1.0, -2.0, 0.0),
        linear_m_s: 0.1,
        angular_rad_s: -0.5,
    };
    let mut out = Vec::new();
    let (of_pose, of_velocity) = ([0.25; 36], [0.5; 36]);
    let to = &mut Writer::new(&mut out);
    write::odometry(to, "odom_1", "base_footprint_1", &about, &of_pose, &of_velocity);
    let ros: Odometry = decode(&out).unwrap();
    assert_eq!(ros.position, [1.0, -2.0, 0.0]);
    assert_eq!(ros.orientation, [0.0, 0.0, 0.0, 1.0]);
    assert_eq!((ros.twist.linear[0], ros.twist.angular[2]), (0.1, -0.5));
    assert_eq!((ros.pose_covariance, ros.twist_covariance), (of_pose, of_velocity));
}

#[test]
fn the_error_names_the_invalid_field() {
    let mut out = Vec::new();
    encode(&Twist { linear: [0.1, 0.0, 0.0], angular: [0.0, 0.0, f64::NAN] }, &mut out);
    let error = decode::<Twist>(&out).unwrap_err().to_string();
    assert!(error.contains("angular.z is NaN"), "{error}");
    let error = decode::<Twist>(&out[..30]).unwrap_err().to_string();
    assert_eq!(error, "angular.x needs 8 bytes at offset 24, 2 are left");
    let error = decode::<Twist>(&[0, 0, 0, 0, 1]).unwrap_err().to_string();
    assert!(error.contains("00 01 00 00") && error.contains("[00, 00, 00, 00]"), "{error}");
    let error = decode::<Text>(&[0, 1, 0, 0, 255, 255, 255, 255, 65]).unwrap_err().to_string();
    assert!(error.contains("data needs 4294967295 bytes"), "{error}");
    let error =
        decode::<LaserScan>(&[&[0, 1, 0, 0], &[0; 12][..], &[0; 28], &[255; 4]].concat()).unwrap_err();
    assert!(error.to_string().contains("ranges needs 17179869180 bytes"), "{error}");
}
