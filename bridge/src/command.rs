//! The JSON bodies of ros_tcp's `__` commands, both ways. Unknown fields are ignored, as Unity's reader does.

use crate::cdr::Dialect;
use serde::{Deserialize, Serialize};

/// The endpoint's version Unity's connector checks for (`v0.7.`).
pub const VERSION: &str = "v0.7.0";
/// The handshake's payload, byte for byte as the reference endpoint writes it: `metadata` is JSON in a string.
pub const HANDSHAKE: &[u8] = br#"{"version": "v0.7.0", "metadata": "{\"protocol\": \"ROS2\"}"}"#;
/// The same toward clients built for ROS 1.
pub const HANDSHAKE_ROS1: &[u8] = br#"{"version": "v0.7.0", "metadata": "{\"protocol\": \"ROS1\"}"}"#;

/// The handshake for clients of one ROS.
pub fn handshake(dialect: Dialect) -> &'static [u8] {
    match dialect {
        Dialect::Ros2 => HANDSHAKE,
        Dialect::Ros1 => HANDSHAKE_ROS1,
    }
}

/// Names of the commands.
pub mod name {
    /// Server to client, its first frame.
    pub const HANDSHAKE: &str = "__handshake";
    /// Client: [`super::Registration`], send me this topic.
    pub const SUBSCRIBE: &str = "__subscribe";
    /// Client: [`super::Registration`], I shall publish this topic.
    pub const PUBLISH: &str = "__publish";
    /// Client: [`super::Registration`], I shall call this service.
    pub const ROS_SERVICE: &str = "__ros_service";
    /// Client: [`super::Registration`], I answer this service.
    pub const UNITY_SERVICE: &str = "__unity_service";
    /// Either: [`super::Call`], the next frame is a service's request.
    pub const REQUEST: &str = "__request";
    /// Either: [`super::Call`], the next frame is a service's response.
    pub const RESPONSE: &str = "__response";
    /// Client: send me the list. Server: [`super::TopicList`].
    pub const TOPIC_LIST: &str = "__topic_list";
    /// Client: [`super::Registration`], undo [`SUBSCRIBE`].
    pub const REMOVE_SUBSCRIBER: &str = "__remove_subscriber";
    /// Client: [`super::Registration`], undo [`PUBLISH`].
    pub const REMOVE_PUBLISHER: &str = "__remove_publisher";
    /// Client: [`super::Registration`], undo [`ROS_SERVICE`].
    pub const REMOVE_ROS_SERVICE: &str = "__remove_ros_service";
    /// Client: [`super::Registration`], undo [`UNITY_SERVICE`].
    pub const REMOVE_UNITY_SERVICE: &str = "__remove_unity_service";
    /// Server: [`super::Notice`], for the client's log.
    pub const LOG: &str = "__log";
    /// Server: [`super::Notice`], something to look at.
    pub const WARN: &str = "__warn";
    /// Server: [`super::Notice`], something was refused.
    pub const ERROR: &str = "__error";
}

/// Of a topic or service, by its client.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Registration {
    /// `/robot1/scan`; a service's name, too, is called topic.
    pub topic: String,
    /// `sensor_msgs/LaserScan`; for a service `nav_msgs/GetPlan`. Empty in removals.
    pub message_name: String,
    /// How many newest messages are kept for a slow reader. 0: as many as usual.
    pub queue_size: i64,
    /// Whether the newest message is kept for late subscribers.
    pub latch: bool,
}

/// The handshake as a client reads it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Handshake {
    /// [`VERSION`].
    pub version: String,
    /// JSON in a string: `{"protocol": "ROS2"}`.
    pub metadata: String,
}

/// Which call the next frame belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Call {
    /// Unique among the sender's calls on this connection.
    pub srv_id: i64,
}

/// Text for a person.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Notice {
    /// One sentence.
    pub text: String,
}

/// All topics; the arrays have the same length.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct TopicList {
    /// Names.
    pub topics: Vec<String>,
    /// `package/Type` of each.
    pub types: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interfaces::{self, Kind};
    use proptest::prelude::*;

    /// What the bridge does with a command's JSON before it believes any of it.
    fn take(json: &[u8]) {
        let _ = serde_json::from_slice::<Call>(json);
        let Ok(about) = serde_json::from_slice::<Registration>(json) else { return };
        if let Ok(name) = interfaces::resolve_name(&about.topic) {
            assert!(name.starts_with('/') && name.len() <= about.topic.len() + 1);
        }
        for kind in [Kind::Message, Kind::Service] {
            let _ = interfaces::resolve(kind, &about.message_name, &[]);
        }
    }

    fn sound() -> impl Strategy<Value = Vec<u8>> {
        let text = "(/?[a-z_0-9/]{0,24}|\\PC{0,12})";
        (text, text, any::<i64>(), any::<bool>()).prop_map(|(topic, message_name, queue_size, latch)| {
            let about = Registration { topic, message_name, queue_size, latch };
            serde_json::to_vec(&about).unwrap_or_default()
        })
    }

    proptest! {
        // `PROPTEST_CASES=5000000 cargo test -p bridge --release command` is 10^7 executions.
        #[test]
        fn noise_is_no_command(json in proptest::collection::vec(any::<u8>(), 0..96)) {
            take(&json);
        }

        #[test]
        fn a_damaged_command_is_survived(
            mut json in sound(),
            damage in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3_u8), 0..4),
        ) {
            for (place, byte, kind) in damage {
                let place = place.index(json.len().max(1));
                match kind {
                    0 if place < json.len() => json[place] = byte,
                    1 => json.truncate(place),
                    _ => json.insert(place.min(json.len()), byte),
                }
            }
            take(&json);
        }

        #[test]
        fn depth_and_numbers_are_survived(depth in 0..4000_usize, number in "-?[0-9]{1,400}(\\.[0-9]{1,9})?(e-?[0-9]{1,5})?") {
            take(format!("{{\"topic\":{}", "[".repeat(depth)).as_bytes());
            take(format!("{{\"queue_size\":{number},\"srv_id\":{number}}}").as_bytes());
        }
    }
}
