//! A command's JSON, from a client: read or refused with a reason, whatever it is; a name that is taken is a ROS name,
//! a type that is taken is one that is known. What was read is written and read again the same.
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
    let Some(about) = read::<Registration>(json) else { return };
    match resolve_name(&about.topic) {
        Ok(name) => {
            assert!(name.starts_with('/') && !name.ends_with('/') && !name.contains("//"), "{name}");
            assert_eq!(resolve_name(&name).as_ref(), Ok(&name), "a resolved name stays as it is");
        }
        Err(why) => assert!(!why.is_empty()),
    }
    for kind in [Kind::Message, Kind::Service] {
        match resolve(kind, &about.message_name, &own) {
            Ok(class) => assert_eq!(resolve(kind, &class, &own).as_ref(), Ok(&class)),
            Err(why) => assert!(!why.is_empty()),
        }
    }
});
