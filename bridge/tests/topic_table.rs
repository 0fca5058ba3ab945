//! The tables of topics in `docs/` name the topics that the fleet publishes, with their types.

use bridge::command::{TopicList, name};
use bridge::frame::{Parser, Side};
use bridge::{Bridge, BridgeConfig, Delivery, OUTGOING_TOPICS};
use msg::Monotonic;
use std::collections::BTreeMap;
use std::path::Path;

fn page(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|why| panic!("{}: {why}", path.display()))
}

/// The rows of a page's table behind a line, by topic: types and remark.
fn table(page: &str, line: &str) -> BTreeMap<String, (String, String)> {
    let rows = page.lines().skip_while(|text| *text != line).skip(1);
    let rows = rows.skip_while(|text| !text.starts_with('|')).take_while(|text| text.starts_with('|'));
    let mut topics = BTreeMap::new();
    for row in rows.skip(2) {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [names, types, remark] = cells[..] else { panic!("{row}: expected topic, type, remark") };
        for name in names.split('`').filter(|part| part.starts_with('/')) {
            topics.insert(name.to_owned(), (types.to_owned(), remark.to_owned()));
        }
    }
    topics
}

#[test]
fn the_documented_topics_on_tcp_are_those_of_the_table() {
    let documented = table(&page("headset.md"), "Out:");
    let published: Vec<_> = OUTGOING_TOPICS.iter().filter(|row| row.tcp.is_some()).collect();
    for row in &published {
        let entry = documented.get(row.name);
        let (types, remark) =
            entry.unwrap_or_else(|| panic!("{} is missing in the table `Out:` of docs/headset.md", row.name));
        assert_eq!(types, row.message_type, "{}", row.name);
        let is_latched = row.tcp == Some(Delivery::Latched);
        assert_eq!(remark.starts_with("latched"), is_latched, "{} latched: {is_latched}", row.name);
    }
    for name in documented.keys() {
        assert!(published.iter().any(|row| row.name == name), "{name} is documented, but not published");
    }
}

#[test]
fn the_topics_on_dds_alone_are_documented() {
    let page = page("ros2.md");
    for row in OUTGOING_TOPICS.iter().filter(|row| row.tcp.is_none()) {
        let line = format!("| `{}` | {} |", row.name, row.message_type);
        assert!(page.contains(&line), "docs/ros2.md lacks a row that begins with: {line}");
    }
}

/// All topics of a bridge with one robot, by name: their types.
fn topics_of_a_bridge() -> BTreeMap<String, String> {
    let bridge = Bridge::new(BridgeConfig::default(), 1, |_, _| {}).unwrap();
    let client = bridge.connect(([127, 0, 0, 1], 1).into()).unwrap();
    let (mut request, mut answer) = (Vec::new(), Vec::new());
    Side::Client.write_command(&mut request, name::TOPIC_LIST, &serde_json::json!({}));
    let mut parser = Parser::new(1 << 20);
    parser.push(&request);
    bridge.receive(client, parser.next_frame().unwrap().unwrap(), Monotonic(0));
    bridge.take_outgoing(client, &mut answer).unwrap();
    let mut parser = Parser::new(1 << 20);
    parser.push(&answer);
    while let Some(frame) = parser.next_frame().unwrap() {
        if frame.name == name::TOPIC_LIST.as_bytes() {
            let TopicList { topics, types } = serde_json::from_slice(frame.payload).unwrap();
            return topics.into_iter().zip(types).collect();
        }
    }
    panic!("no topic list");
}

#[test]
fn the_documented_inputs_on_tcp_are_those_of_the_bridge() {
    let documented = table(&page("headset.md"), "In:");
    let topics = topics_of_a_bridge();
    let in_docs = |name: &str| name.replace("/robot1/", "/robotN/").replace("cmd_vel_1", "cmd_vel_N");
    let published = |name: &str| OUTGOING_TOPICS.iter().any(|row| row.name == name);
    for (topic, message_type) in &topics {
        let name = in_docs(topic);
        match documented.get(&name) {
            Some((types, _)) => assert!(types.contains(message_type.as_str()), "{name}: {types}"),
            None => assert!(published(&name), "{name} is missing in the table `In:` of docs/headset.md"),
        }
    }
    for name in documented.keys() {
        assert!(topics.keys().any(|topic| in_docs(topic) == *name), "{name} is documented, but not there");
    }
}
