//! What rosbag2 reads of a recording beside its messages.

use msg::Stamp;
use recording::rosbag2::{self, BagFile, BagTopic};
use recording::{Durability, RecordingReader, RecordingWriter, TopicCount};
use std::collections::BTreeMap;

/// Values of the keys in a description, without their indentation.
fn values<'a>(yaml: &'a str, key: &str) -> Vec<&'a str> {
    let lines = yaml.lines().map(|line| line.trim().trim_start_matches("- "));
    lines.filter_map(|line| line.strip_prefix(key)?.strip_prefix(": ")).collect()
}

#[test]
fn each_file_says_that_policies_of_its_topics_are_numbers() {
    let mut writer = RecordingWriter::new(&BTreeMap::new()).unwrap();
    let topic = writer.add_topic("/map", "std_msgs/String", Durability::Latched).unwrap();
    writer.write(topic, Stamp(5), &[0, 1, 0, 0, 1, 0, 0, 0, 0]).unwrap();
    let bytes = writer.finish().unwrap();
    let mut reader = RecordingReader::new(&bytes[..]);
    assert_eq!(reader.next_message().unwrap().unwrap().at, Stamp(5));
    let metadata = reader
        .metadata(rosbag2::METADATA)
        .expect("before the first message, as a file that is cut off has it");
    let yaml = &metadata[rosbag2::SERIALIZED_METADATA];
    // rosbag2 takes policies for names from version 9 on; from 7 on it expects what no recording has.
    let version: u32 = values(yaml, "version")[0].parse().unwrap();
    assert!((5..7).contains(&version), "{yaml}");
    for key in [
        "storage_identifier",
        "topics_with_message_count",
        "relative_file_paths",
        "files",
        "compression_mode",
    ] {
        assert_eq!(values(yaml, key).len(), 1, "{key}: {yaml}");
    }
    for policy in ["history: 1", "reliability: 1", "durability: 1", "liveliness: 1"] {
        let qos = rosbag2::offered_qos_profiles(Durability::Latched);
        assert!(qos.lines().any(|line| line.trim().trim_start_matches("- ") == policy), "{qos}");
    }
}

#[test]
fn the_description_of_a_bag_has_the_sums_of_its_files_and_names_in_quotes() {
    let mut files = [
        BagFile { name: "a \"b\"\\.mcap".into(), ..BagFile::default() },
        BagFile { name: "a_1.mcap".into(), ..BagFile::default() },
        BagFile { name: "empty.mcap".into(), ..BagFile::default() },
    ];
    [30, 20, 40].into_iter().for_each(|at| files[0].add(Stamp(at)));
    [70, 50].into_iter().for_each(|at| files[1].add(Stamp(at)));
    let topic = |name: &str, durability, messages| BagTopic {
        message_type: "std_msgs/String".into(),
        durability,
        count: TopicCount { topic: name.into(), messages, bytes: 0 },
    };
    let topics = [topic("/a", Durability::Volatile, 3), topic("/b", Durability::Latched, 2)];
    let yaml = rosbag2::description(&files, &topics);
    assert_eq!(values(&yaml, "message_count"), ["5", "3", "2", "3", "2", "0"]);
    assert_eq!(values(&yaml, "nanoseconds"), ["50", "20", "20", "0"]);
    assert_eq!(values(&yaml, "nanoseconds_since_epoch"), ["20", "20", "50", "0"]);
    assert_eq!(values(&yaml, "path"), [r#""a \"b\"\\.mcap""#, r#""a_1.mcap""#, r#""empty.mcap""#]);
    assert_eq!(values(&yaml, "type"), [r#""std_msgs/msg/String""#; 2]);
    let qos = values(&yaml, "offered_qos_profiles");
    assert!(qos[0] == "\"\"" && qos[1].contains(r"durability: 1\n") && !qos[1].contains('\n'), "{qos:?}");
}
