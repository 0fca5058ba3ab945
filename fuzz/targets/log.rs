//! CARMEN logs: whatever the bytes, lines are read or refused, and what is read is a scan.
#![no_main]

use libfuzzer_sys::fuzz_target;
use formats::carmen::{Reader, Record};
use msg::Scan;

fuzz_target!(|bytes: &[u8]| {
    let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    for record in Reader::new(bytes) {
        match record {
            Ok(Record::Laser(line)) => {
                line.write_to(&mut scan, 0, None);
                assert!(scan.hits().all(|(angle, range)| angle.is_finite() && range.is_finite()));
                line.write_to(&mut scan, 0, Some(1.0));
            }
            Ok(Record::Odometry(line)) => assert!(line.odom_from_base.is_finite()),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
});
