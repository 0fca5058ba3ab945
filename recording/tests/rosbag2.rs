//! What rosbag2 reads of a recording beside its messages.

use msg::Stamp;
use proptest::prelude::*;
use recording::rosbag2::{self, Bag, BagFile, BagTopic};
use recording::{Durability, PartCounts, RecordingReader, RecordingWriter, TopicCount};
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
    files[0] = BagFile { times: Some((Stamp(20), Stamp(40))), messages: 3, ..files[0].clone() };
    files[1] = BagFile { times: Some((Stamp(50), Stamp(70))), messages: 2, ..files[1].clone() };
    let topic = |name: &str, durability, messages| BagTopic {
        message_type: "std_msgs/String".into(),
        durability,
        count: TopicCount { topic: name.into(), messages, bytes: 0 },
    };
    let topics = [topic("/a", Durability::Volatile, 3), topic("/b", Durability::Latched, 2)];
    let yaml = Bag { files: files.to_vec(), topics: topics.to_vec() }.description();
    assert_eq!(values(&yaml, "message_count"), ["5", "3", "2", "3", "2", "0"]);
    assert_eq!(values(&yaml, "nanoseconds"), ["50", "20", "20", "0"]);
    assert_eq!(values(&yaml, "nanoseconds_since_epoch"), ["20", "20", "50", "0"]);
    assert_eq!(values(&yaml, "path"), [r#""a \"b\"\\.mcap""#, r#""a_1.mcap""#, r#""empty.mcap""#]);
    assert_eq!(values(&yaml, "type"), [r#""std_msgs/msg/String""#; 2]);
    let qos = values(&yaml, "offered_qos_profiles");
    assert!(qos[0] == "\"\"" && qos[1].contains(r"durability: 1\n") && !qos[1].contains('\n'), "{qos:?}");
}

/// A message of text with so many bytes.
fn text(bytes: usize) -> Vec<u8> {
    let mut payload = vec![0, 1, 0, 0];
    payload.extend((bytes as u32 + 1).to_le_bytes());
    // No text that compresses well: chunks are as long as their messages.
    payload.extend((0..bytes).map(|index| 33 + (index * index % 89) as u8));
    payload.push(0);
    payload
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_messages_of_the_parts_that_were_taken_are_those_that_can_be_read(
        sizes in proptest::collection::vec(0_usize..600_000, 1..20),
        flush_every in 1_usize..8,
        parts_that_fit in 0_usize..20,
    ) {
        let mut writer = RecordingWriter::new(&BTreeMap::new()).unwrap();
        let topics = ["/a", "/b"].map(|name| writer.add_topic(name, "std_msgs/String", Durability::Volatile).unwrap());
        let (mut file, mut counts, mut taken) = (Vec::new(), PartCounts::default(), 0);
        let mut append = |writer: &mut RecordingWriter| {
            let part = writer.take_part();
            if part.bytes.is_empty() {
                assert_eq!(part.counts, PartCounts::default());
            } else if taken < parts_that_fit {
                file.extend(part.bytes);
                counts.append(&part.counts);
                taken += 1;
            } else {
                taken = usize::MAX;
            }
        };
        for (index, bytes) in sizes.iter().enumerate() {
            writer.write(topics[index % 2], Stamp(index as i64 * 10), &text(*bytes)).unwrap();
            if index % flush_every == 0 {
                writer.flush().unwrap();
            }
            append(&mut writer);
        }
        let topic = |name: &str| BagTopic {
            message_type: "std_msgs/String".into(),
            durability: Durability::Volatile,
            count: TopicCount { topic: name.into(), ..TopicCount::default() },
        };
        let mut bag = Bag { files: Vec::new(), topics: vec![topic("/a"), topic("/b")] };
        // Before the first part the file is empty, which is no MCAP.
        if !file.is_empty() {
            bag.read("file", &file[..]).unwrap();
            prop_assert_eq!((bag.files[0].messages, bag.files[0].times), (counts.messages, counts.times));
        }
        for (topic, index) in bag.topics.iter().zip(topics) {
            prop_assert_eq!(topic.count.messages, counts.of_topic(index).0);
        }
    }
}
