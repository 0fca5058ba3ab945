//! Checks that the links of all Markdown files lead somewhere.

use crate::sources::{markdown_files, read, root};
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

/// The lines of a Markdown file that are not code, with code within a line taken out.
fn prose(text: &str) -> String {
    let mut is_in_code = false;
    let mut prose = String::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            is_in_code = !is_in_code;
            continue;
        }
        if !is_in_code {
            // Every second part is between two backticks.
            prose.extend(line.split('`').step_by(2));
        }
        prose.push('\n');
    }
    prose
}

/// Where the links and images of a Markdown file lead: what stands in the brackets of `[text](target)`.
fn targets(text: &str) -> Vec<String> {
    let prose = prose(text);
    let ends = prose.split("](").skip(1);
    ends.filter_map(|rest| rest.split_once(')').map(|(target, _)| target.trim().to_owned())).collect()
}

/// The anchor that GitHub gives a heading: lower case, hyphens for spaces, no other punctuation.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// The anchors of all headings of a Markdown file. Headings of one text are numbered from the second on, as GitHub does.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut is_in_code = false;
    for line in text.lines() {
        is_in_code ^= line.trim_start().starts_with("```");
        let level = line.chars().take_while(|&c| c == '#').count();
        let Some(heading) =
            line.get(level..).filter(|rest| !is_in_code && level > 0 && rest.starts_with(' '))
        else {
            continue;
        };
        let first = anchor(heading);
        let mut name = first.clone();
        let mut repetition = 0;
        while !found.insert(name) {
            repetition += 1;
            name = format!("{first}-{repetition}");
        }
    }
    found
}

/// A path without `.` and `..`; `None` if it leaves the workspace.
fn normalized(path: &Path) -> Option<PathBuf> {
    let mut normal = PathBuf::new();
    for part in path.components() {
        match part {
            Component::Normal(name) => normal.push(name),
            Component::CurDir => {}
            Component::ParentDir if normal.pop() => {}
            _ => return None,
        }
    }
    Some(normal)
}

/// Why a link of the Markdown file `from` does not lead to anything; `None` if it does, or leads out of the project.
fn fault(from: &str, target: &str) -> Option<String> {
    if target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    let (file, heading) =
        target.split_once('#').map_or((target, None), |(file, heading)| (file, Some(heading)));
    let folder = Path::new(from).parent().unwrap_or(Path::new(""));
    let path = match file {
        "" => PathBuf::from(from),
        _ => match normalized(&folder.join(file)) {
            Some(path) => path,
            None => return Some(format!("{from}: {target}: leaves the project")),
        },
    };
    if !root().join(&path).exists() {
        return Some(format!("{from}: {target}: no {}", path.display()));
    }
    let heading = heading?;
    let known = anchors(&read(&path.to_string_lossy()));
    (!known.contains(heading)).then(|| format!("{from}: {target}: no such heading in {}", path.display()))
}

#[test]
fn links_of_documents_lead_to_files_and_headings() {
    let mut faults = Vec::new();
    let mut count = 0;
    for path in markdown_files() {
        for target in targets(&read(&path)) {
            count += 1;
            faults.extend(fault(&path, &target));
        }
    }
    assert!(count > 50, "only {count} links were found: is the search for them broken?");
    assert!(faults.is_empty(), "links that lead nowhere: {faults:#?}");
}

#[test]
fn a_link_to_a_missing_file_or_heading_is_found() {
    let text = "# One `two`: three\n[a](docs/none.md) `[b](c)`\n```\n[d](e)\n# no heading\n```\n![f](g.png) [h](#one-two-three)\n# One two three\n";
    assert_eq!(targets(text), ["docs/none.md", "g.png", "#one-two-three"]);
    assert_eq!(Vec::from_iter(anchors(text)), ["one-two-three", "one-two-three-1"]);
    assert!(fault("README.md", "docs/none.md").is_some());
    assert!(fault("docs/limits.md", "../README.md").is_none());
    assert!(fault("docs/limits.md", "../README.md#no-such-heading").is_some());
    assert!(fault("docs/limits.md", "../../elsewhere.md").is_some());
    assert!(fault("docs/limits.md", "https://example.org/#x").is_none());
}
