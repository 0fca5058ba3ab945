//! Fleet files: read and sound, or refused with the line; what was read is written and read again the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use mr_slam::config::FleetConfig;

fuzz_target!(|bytes: &[u8]| {
    let Ok(text) = core::str::from_utf8(bytes) else { return };
    match FleetConfig::from_text("fuzz.toml".as_ref(), text) {
        Ok(config) => {
            let again = FleetConfig::from_text("again.toml".as_ref(), &config.to_toml());
            assert!(again.is_ok_and(|again| again == config), "{}", config.to_toml());
        }
        Err(error) => assert!(error.to_string().contains("fuzz.toml"), "{error}"),
    }
});
