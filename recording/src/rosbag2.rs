//! What rosbag2 reads beside the messages: the quality of service of topics, and the description of a bag in YAML.
//!
//! The description has version 5, in which policies are numbers. Readers of ROS 2 Humble know it, and those of Jazzy convert it. Without a
//! version Jazzy takes the numbers for names, and its player does not offer any latched topic.

use crate::counts::{Durability, PartCounts, TopicCount, union};
use crate::{ReadError, RecordingReader};
use msg::Stamp;
use std::fmt::Write as _;
use std::io::Read;

/// Name of rosbag2's metadata record in a file.
pub const METADATA: &str = "rosbag2";
/// Name of the only entry of this record.
pub const SERIALIZED_METADATA: &str = "serialized_metadata";
/// Name of the file that describes the bag of a folder.
pub const METADATA_FILE: &str = "metadata.yaml";

/// Quality of service of a latched topic: reliable, transient local, the last message.
const LATCHED_QOS: &str = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false";

/// Returns the quality of service of a topic, as channels and descriptions have it; empty: rosbag2's default.
pub fn offered_qos_profiles(durability: Durability) -> &'static str {
    match durability {
        Durability::Latched => LATCHED_QOS,
        Durability::Volatile => "",
    }
}

/// Returns a type `package/Type` as ROS 2 writes it, `package/msg/Type`.
pub fn interface_name(message_type: &str) -> String {
    message_type.replacen('/', "/msg/", 1)
}

/// One file of a bag.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BagFile {
    /// Name of the file in the bag's folder.
    pub name: String,
    /// Times of the first and the last message; `None` without any.
    pub times: Option<(Stamp, Stamp)>,
    /// Number of messages of the file.
    pub messages: u64,
}

impl BagFile {
    /// Adds messages that were appended to the file.
    pub fn add(&mut self, counts: &PartCounts) {
        self.times = union(self.times, counts.times);
        self.messages += counts.messages;
    }
}

/// One topic of a bag, with its number of messages in all files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagTopic {
    /// Type of the messages, as `package/Type`.
    pub message_type: String,
    /// Whether late subscribers get the newest message.
    pub durability: Durability,
    /// Name and number of messages.
    pub count: TopicCount,
}

/// Files and topics of a recording as rosbag2 counts them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bag {
    /// Files, in the order of their messages.
    pub files: Vec<BagFile>,
    /// Topics with the number of their messages in all files.
    pub topics: Vec<BagTopic>,
}

impl Bag {
    /// Reads a file of a recorder that was killed, as one more after those of this bag. Its messages of other topics count for the file
    /// alone.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read<R: Read>(&mut self, name: &str, file: R) -> Result<(), ReadError> {
        let mut found = BagFile { name: name.to_owned(), ..BagFile::default() };
        let mut reader = RecordingReader::new(file);
        while let Some(message) = reader.next_message()? {
            found.times = union(found.times, Some((message.at, message.at)));
            found.messages += 1;
            if let Some(topic) = self.topics.iter_mut().find(|topic| topic.count.topic == *message.topic) {
                topic.count.messages += 1;
            }
        }
        self.files.push(found);
        Ok(())
    }

    /// Returns the description of the bag: `metadata.yaml` of its folder, and without files the entry of each file's metadata record.
    pub fn description(&self) -> String {
        describe(&self.files, &self.topics)
    }
}

fn describe(files: &[BagFile], topics: &[BagTopic]) -> String {
    let times = files.iter().fold(None, |times, file| union(times, file.times));
    let messages: u64 = files.iter().map(|file| file.messages).sum();
    let mut yaml = String::from("rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n");
    add_times(&mut yaml, "  ", times, messages);
    add_list(&mut yaml, "  topics_with_message_count:", topics, |yaml, topic| {
        // Writing to a string does not fail.
        let _ = write!(
            yaml,
            "    - topic_metadata:\n        name: {}\n        type: {}\n        serialization_format: cdr\n        \
             offered_qos_profiles: {}\n      message_count: {}\n",
            quoted(&topic.count.topic),
            quoted(&interface_name(&topic.message_type)),
            quoted(offered_qos_profiles(topic.durability)),
            topic.count.messages,
        );
    });
    yaml.push_str("  compression_format: \"\"\n  compression_mode: \"\"\n");
    add_list(&mut yaml, "  relative_file_paths:", files, |yaml, file| {
        let _ = writeln!(yaml, "    - {}", quoted(&file.name));
    });
    add_list(&mut yaml, "  files:", files, |yaml, file| {
        let _ = writeln!(yaml, "    - path: {}", quoted(&file.name));
        add_times(yaml, "      ", file.times, file.messages);
    });
    yaml
}

fn add_times(yaml: &mut String, indent: &str, times: Option<(Stamp, Stamp)>, messages: u64) {
    let (first, last) = times.unwrap_or_default();
    let (begins_ns, duration_ns) = (first.0.max(0), last.0.max(0).saturating_sub(first.0.max(0)));
    let _ = write!(
        yaml,
        "{indent}duration:\n{indent}  nanoseconds: {duration_ns}\n{indent}starting_time:\n{indent}  \
         nanoseconds_since_epoch: {begins_ns}\n{indent}message_count: {messages}\n"
    );
}

fn add_list<T>(yaml: &mut String, name: &str, items: &[T], add: impl Fn(&mut String, &T)) {
    yaml.push_str(name);
    yaml.push_str(if items.is_empty() { " []\n" } else { "\n" });
    items.iter().for_each(|item| add(yaml, item));
}

/// Returns a text in double quotes, in which YAML knows escapes.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for character in text.chars() {
        match character {
            '"' | '\\' => quoted.extend(['\\', character]),
            '\n' => quoted.push_str("\\n"),
            other if other.is_control() => {
                let _ = write!(quoted, "\\u{:04x}", u32::from(other));
            }
            other => quoted.push(other),
        }
    }
    quoted.push('"');
    quoted
}
