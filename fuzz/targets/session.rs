//! Session files: as they are, and with a head that fits, so that the content is what is tried. What
//! is accepted must be fit to go on with, in every mode, and be written the same again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use msg::SlamMode;
use slam::{Session, Slam, SlamConfig, InitialPose};

fuzz_target!(|bytes: &[u8]| {
    let _ = Session::decode_any(bytes);
    let Some(content) = bytes.get(24..) else { return };
    let Ok(session) = Session::decode_content(content) else { return };
    let again = Session::decode_any(&session.encode());
    assert!(again.is_ok_and(|again| again.encode() == session.encode()));
    for mode in SlamMode::ALL {
        for start in [InitialPose::Continue, InitialPose::Unknown] {
            let mut slam = Slam::begin(SlamConfig::default(), Some(session.clone()), mode, start);
            let _ = slam.map();
            let _ = slam.trajectory().count();
            let _ = slam.back().closures().count();
        }
    }
});
