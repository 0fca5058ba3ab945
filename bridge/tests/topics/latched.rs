//! Clients' latched messages, and the limit of their bytes.

use crate::local::LocalClient;
use bridge::ros::Text;
use bridge::{Bridge, BridgeConfig};
use msg::Monotonic;

#[test]
fn a_message_beyond_the_limit_leaves_the_latched_one_and_its_publisher_is_told_once() {
    let config = BridgeConfig { latched_bytes_max: 200, ..BridgeConfig::default() };
    let bridge = Bridge::new(config, 1, |_, _| {}).unwrap();
    let one = LocalClient::connect(&bridge);
    one.publish_latched::<Text>("/note");
    let warnings = || one.take_frames().into_iter().filter(|(name, _)| name == "__warn").collect::<Vec<_>>();
    let send = |text: String, at: u64| one.send("/note", &Text(text), Monotonic(at));
    send("x".repeat(100), 1);
    // The message that is replaced makes room.
    send("y".repeat(150), 2);
    assert!(warnings().is_empty());
    send("z".repeat(300), 3);
    send("z".repeat(300), 4);
    let reported = warnings();
    assert_eq!(reported.len(), 1);
    let text = String::from_utf8_lossy(&reported[0].1).into_owned();
    assert!(text.contains("/note") && text.contains("200 bytes (latched_bytes_max"), "{text}");
    let two = LocalClient::connect(&bridge);
    two.subscribe::<Text>("/note");
    assert_eq!(two.take::<Text>("/note"), [Text("y".repeat(150))]);
}
