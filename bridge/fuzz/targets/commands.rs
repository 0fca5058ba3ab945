//! Fuzzes the JSON of a client's command: it is parsed or an error. An accepted name is a ROS name, and an accepted type
//! is known. A parsed body serializes and parses to itself.
#![no_main]

use bridge::command::{Call, Handshake, Notice, Registration, TopicList};
use bridge::interfaces::{Kind, resolve, resolve_name};
use libfuzzer_sys::fuzz_target;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;

fn read<T: Serialize + DeserializeOwned + PartialEq + Debug>(json: &[u8]) -> Option<T> {
    match serde_json::from_slice::<T>(json) {
        Ok(body) => {
            let again = serde_json::to_vec(&body).expect("plain structs can be written");
            assert_eq!(serde_json::from_slice::<T>(&again).ok().as_ref(), Some(&body));
            Some(body)
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            None
        }
    }
}

fuzz_target!(|json: &[u8]| {
    let own = ["my_robot_msgs".to_owned()];
    read::<Call>(json);
    read::<Handshake>(json);
    read::<Notice>(json);
    read::<TopicList>(json);
    let Some(registration) = read::<Registration>(json) else { return };
    match resolve_name(&registration.topic) {
        Ok(name) => {
            assert!(name.starts_with('/') && !name.ends_with('/') && !name.contains("//"), "{name}");
            assert_eq!(resolve_name(&name).as_ref(), Ok(&name), "a resolved name stays as it is");
        }
        Err(why) => assert!(!why.to_string().is_empty()),
    }
    for kind in [Kind::Message, Kind::Service] {
        match resolve(kind, &registration.message_name, &own) {
            Ok(class) => assert_eq!(resolve(kind, &class, &own).as_ref(), Ok(&class)),
            Err(why) => assert!(!why.to_string().is_empty()),
        }
    }
});
