//! JSON bodies of the ros_tcp protocol's `__` commands, in both directions.
//!
//! Unknown fields are ignored, as Unity's JSON reader does.

use ros_messages::cdr::Dialect;
use serde::{Deserialize, Serialize};

/// Version of the endpoint: Unity's connector expects `v0.7.` at its beginning.
pub const VERSION: &str = "v0.7.0";
/// The handshake's payload, byte for byte as the reference endpoint's. `metadata` is JSON in a string.
pub const HANDSHAKE: &[u8] = br#"{"version": "v0.7.0", "metadata": "{\"protocol\": \"ROS2\"}"}"#;
/// The handshake's payload for clients built for ROS 1.
pub const HANDSHAKE_ROS1: &[u8] = br#"{"version": "v0.7.0", "metadata": "{\"protocol\": \"ROS1\"}"}"#;

/// Returns the handshake's payload for clients of a ROS version.
pub fn handshake(dialect: Dialect) -> &'static [u8] {
    match dialect {
        Dialect::Ros2 => HANDSHAKE,
        Dialect::Ros1 => HANDSHAKE_ROS1,
    }
}

/// Names of the commands.
pub mod name {
    /// From the server, as its first frame: [`super::Handshake`].
    pub const HANDSHAKE: &str = "__handshake";
    /// From a client: [`super::Registration`] of a topic that it wants to receive.
    pub const SUBSCRIBE: &str = "__subscribe";
    /// From a client: [`super::Registration`] of a topic that it will publish.
    pub const PUBLISH: &str = "__publish";
    /// From a client: [`super::Registration`] of a service that it will call.
    pub const ROS_SERVICE: &str = "__ros_service";
    /// From a client: [`super::Registration`] of a service that it provides.
    pub const UNITY_SERVICE: &str = "__unity_service";
    /// From either side: [`super::Call`]; the next frame is the service's request.
    pub const REQUEST: &str = "__request";
    /// From either side: [`super::Call`]; the next frame is the service's response.
    pub const RESPONSE: &str = "__response";
    /// From a client: asks for the list. From the server: [`super::TopicList`].
    pub const TOPIC_LIST: &str = "__topic_list";
    /// From a client: [`super::Registration`]; ends [`SUBSCRIBE`].
    pub const REMOVE_SUBSCRIBER: &str = "__remove_subscriber";
    /// From a client: [`super::Registration`]; ends [`PUBLISH`].
    pub const REMOVE_PUBLISHER: &str = "__remove_publisher";
    /// From a client: [`super::Registration`]; ends [`ROS_SERVICE`].
    pub const REMOVE_ROS_SERVICE: &str = "__remove_ros_service";
    /// From a client: [`super::Registration`]; ends [`UNITY_SERVICE`].
    pub const REMOVE_UNITY_SERVICE: &str = "__remove_unity_service";
    /// From the server, to clients whose protocol tells failures apart from responses: [`super::CallFailure`].
    pub const CALL_FAILURE: &str = "__call_failure";
    /// From the server: [`super::Notice`] for the client's log.
    pub const LOG: &str = "__log";
    /// From the server: [`super::Notice`] of something that needs attention.
    pub const WARN: &str = "__warn";
    /// From the server: [`super::Notice`] of something that was refused.
    pub const ERROR: &str = "__error";
}

/// A client's registration of a topic or service.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Registration {
    /// Name of the topic or service, such as `/robot1/scan`.
    pub topic: String,
    /// Type, such as `sensor_msgs/LaserScan` or, for a service, `nav_msgs/GetPlan`. Empty in removals.
    pub message_name: String,
    /// Newest messages that wait for a slow subscriber; 0 stands for the default of 10.
    pub queue_size: i64,
    /// Whether the newest message is kept for late subscribers.
    pub latch: bool,
}

/// The handshake, as a client reads it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Handshake {
    /// Version of the endpoint: [`VERSION`].
    pub version: String,
    /// JSON in a string: `{"protocol": "ROS2"}`.
    pub metadata: String,
}

/// Announces that the next frame belongs to a service call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Call {
    /// Number of the call, unique among the sender's calls on this connection.
    pub srv_id: i64,
}

/// A service call that failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CallFailure {
    /// The caller's number of the call.
    pub srv_id: i64,
    /// A sentence for a person.
    pub text: String,
}

/// Text for a person.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Notice {
    /// A sentence for a person.
    pub text: String,
}

/// All topics and their types, in arrays of the same length.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct TopicList {
    /// Names with leading slash.
    pub topics: Vec<String>,
    /// `package/Type` of each topic.
    pub types: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use ros_messages::interfaces::{self, Kind};

    /// Parses a command's JSON as the bridge does.
    fn parse(json: &[u8]) {
        let _ = serde_json::from_slice::<Call>(json);
        let Ok(registration) = serde_json::from_slice::<Registration>(json) else { return };
        if let Ok(name) = interfaces::resolve_name(&registration.topic) {
            assert!(name.starts_with('/') && name.len() <= registration.topic.len() + 1);
        }
        for kind in [Kind::Message, Kind::Service] {
            let _ = interfaces::resolve(kind, &registration.message_name, &[]);
        }
    }

    fn valid() -> impl Strategy<Value = Vec<u8>> {
        let text = "(/?[a-z_0-9/]{0,24}|\\PC{0,12})";
        (text, text, any::<i64>(), any::<bool>()).prop_map(|(topic, message_name, queue_size, latch)| {
            let registration = Registration { topic, message_name, queue_size, latch };
            serde_json::to_vec(&registration).unwrap_or_default()
        })
    }

    proptest! {
        // `PROPTEST_CASES=5000000 cargo test -p bridge --release command` is 10^7 executions.
        #[test]
        fn random_bytes_are_an_error(json in proptest::collection::vec(any::<u8>(), 0..96)) {
            parse(&json);
        }

        #[test]
        fn a_damaged_command_is_parsed_or_an_error(
            mut json in valid(),
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
            parse(&json);
        }

        #[test]
        fn deep_nesting_and_huge_numbers_are_parsed_or_an_error(depth in 0..4000_usize, number in "-?[0-9]{1,400}(\\.[0-9]{1,9})?(e-?[0-9]{1,5})?") {
            parse(format!("{{\"topic\":{}", "[".repeat(depth)).as_bytes());
            parse(format!("{{\"queue_size\":{number},\"srv_id\":{number}}}").as_bytes());
        }
    }
}
