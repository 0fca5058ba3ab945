//! Session files and session logs: as they are, and with a head that fits, so that the content is what is tried. What
//! is accepted must be fit to go on with, in every mode, and be written the same again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use msg::SlamMode;
use slam::session::log::{LogContents, LogRecord};
use slam::{BackEnd, FrontEnd, InitialPose, Session, Slam, SlamConfig};

fuzz_target!(|bytes: &[u8]| {
    let _ = Session::decode_any(bytes);
    let _ = LogContents::decode(bytes);
    if let Ok(record) = LogRecord::decode_content(bytes, 0) {
        let mut back = BackEnd::new(SlamConfig::default());
        let front = back.replay(vec![record]);
        let _ = front.map(|front| FrontEnd::resume(SlamConfig::default(), front, back.nodes()));
    }
    let Some(content) = bytes.get(24..) else { return };
    let Ok(session) = Session::decode_content(content) else { return };
    let bytes = session.encode().expect("what was decoded can be encoded");
    let again = Session::decode_any(&bytes);
    assert!(again.is_ok_and(|again| again.encode() == Ok(bytes)));
    for mode in SlamMode::ALL {
        for start in [InitialPose::Continue, InitialPose::Unknown] {
            let mut slam = Slam::create_or_resume(SlamConfig::default(), Some(session.clone()), mode, start);
            let _ = slam.map();
            let _ = slam.trajectory().count();
            let _ = slam.back().closures().count();
        }
    }
});
