//! The tables of topics in `docs/` name the topics that the fleet publishes, with their types.

use bridge::{Delivery, OUTGOING_TOPICS};
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
