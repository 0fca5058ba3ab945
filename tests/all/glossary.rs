//! Keeps `docs/GLOSSARY.md` true: its names exist, and its retired words are gone from code and documents.

use crate::sources::{all_files, crates, markdown_files, product_files, read};
use std::collections::BTreeSet;

/// Declarations that make a name exist.
const DECLARATIONS: &[&str] = &["struct ", "enum ", "trait ", "type ", "fn ", "const ", "static ", "mod "];

/// Rows of the table below a heading: the cells of each.
fn table(heading: &str) -> Vec<Vec<String>> {
    let glossary = read("docs/GLOSSARY.md");
    let (_, section) = glossary.split_once(heading).unwrap_or_else(|| panic!("no heading {heading}"));
    let section = section.split("\n## ").next().unwrap_or("");
    let rows = section.lines().filter(|line| line.starts_with('|')).skip(2);
    rows.map(|row| row.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()).collect()
}

/// Names in backticks in a cell, without what follows a name's last `::` or precedes its brackets.
fn names(cell: &str) -> Vec<String> {
    let quoted = cell.split('`').skip(1).step_by(2);
    quoted.map(|name| name.rsplit("::").next().unwrap_or(name).trim_end_matches("()").to_owned()).collect()
}

/// Every name that is declared anywhere in the workspace.
fn declared(keywords: &[&str]) -> BTreeSet<String> {
    let files = all_files();
    let items = files.iter().flat_map(|source| source.items(keywords));
    items.map(|item| item.name.to_owned()).collect()
}

#[test]
fn every_name_in_the_glossary_exists() {
    let known = declared(DECLARATIONS);
    let code: String =
        crates().iter().flat_map(|(_, folder)| product_files(folder)).map(|s| s.text).collect();
    for row in table("## Terms") {
        for name in names(&row[1]) {
            // Fields, variants and frames are no declarations of their own; they are found as text.
            assert!(
                known.contains(&name) || code.contains(&name),
                "{}: `{name}` is nowhere in the code",
                row[0]
            );
        }
    }
}

#[test]
fn every_term_has_one_sentence_and_a_source() {
    let mut seen = BTreeSet::new();
    for row in table("## Terms") {
        assert_eq!(row.len(), 4, "term, name, meaning, source: {row:?}");
        assert!(seen.insert(row[0].to_lowercase()), "{} is explained twice", row[0]);
        assert!(row[2].ends_with('.') && row[2].split_whitespace().count() <= 30, "one sentence: {}", row[2]);
        assert!(!row[3].is_empty(), "{} has no source", row[0]);
    }
}

#[test]
fn retired_names_are_gone_and_have_a_successor() {
    let types = declared(&["struct ", "enum ", "trait ", "type "]);
    let functions = declared(&["fn "]);
    let all = declared(DECLARATIONS);
    let mut left = Vec::new();
    for row in table("## Retired names") {
        for old in row[0].split('`').skip(1).step_by(2) {
            let declared = if old.ends_with("()") { &functions } else { &types };
            let is_declared = declared.contains(old.trim_end_matches("()"));
            left.extend(is_declared.then(|| format!("{old} is retired: use {}", row[1])));
        }
        for new in names(&row[1]) {
            let exists = all.contains(&new);
            left.extend((!exists).then(|| format!("{} is retired, but there is no {new}", row[0])));
        }
    }
    assert!(left.is_empty(), "retired names that are declared, or have no successor: {left:#?}");
}

#[test]
fn retired_phrases_are_gone() {
    let phrases: Vec<(Phrase, String, String)> = table("## Retired phrases")
        .into_iter()
        .map(|row| (Phrase::parse(&row[0].to_lowercase()), row[0].clone(), row[1].clone()))
        .collect();
    let code = crates().into_iter().flat_map(|(_, folder)| product_files(&folder));
    let code = code.map(|source| (passages(&source.text), source.path));
    // The glossary lists the phrases themselves, and the changelog quotes what messages said before.
    let quoting = ["docs/GLOSSARY.md", "CHANGELOG.md"];
    let documents = markdown_files().into_iter().filter(|path| !quoting.contains(&path.as_str()));
    let documents = documents.map(|path| (paragraphs(&read(&path)), path));
    let mut found = Vec::new();
    for (passages, path) in code.chain(documents) {
        for (number, passage) in passages {
            let lower = passage.to_lowercase();
            let words = words(&lower);
            let hit = phrases.iter().find(|(phrase, ..)| phrase.is_in(&words));
            found.extend(hit.map(|(_, old, new)| format!("{path}:{number}: \"{old}\" -> {new}")));
        }
    }
    assert!(found.is_empty(), "retired phrases: {found:#?}");
}

/// Most words that `...` stands for.
const GAP_MAX: usize = 3;
/// Stands between the words of two clauses.
const CLAUSE_END: &str = ".";

/// The passages of a file, each with the number of its first line: lines of one comment are joined, each other line is one.
fn passages(text: &str) -> Vec<(usize, String)> {
    let mut passages: Vec<(usize, String)> = Vec::new();
    let mut is_in_comment = false;
    for (number, line) in text.lines().enumerate() {
        let comment = line.trim_start().strip_prefix("//").map(|text| text.trim_start_matches(['/', '!']));
        match (comment, passages.last_mut()) {
            (Some(comment), Some((_, passage))) if is_in_comment => *passage += comment,
            _ => passages.push((number + 1, comment.unwrap_or(line).to_owned())),
        }
        is_in_comment = comment.is_some();
    }
    passages
}

/// The paragraphs of a Markdown file, each with the number of its first line.
fn paragraphs(text: &str) -> Vec<(usize, String)> {
    let mut paragraphs: Vec<(usize, String)> = Vec::new();
    let mut is_open = false;
    for (number, line) in text.lines().enumerate() {
        // A row of a table and an entry of a list are paragraphs of their own.
        let starts = line.trim_start().starts_with(['|', '-', '#']) || !is_open;
        match paragraphs.last_mut() {
            Some((_, paragraph)) if !starts => *paragraph += &format!(" {line}"),
            _ => paragraphs.push((number + 1, line.to_owned())),
        }
        is_open = !line.trim().is_empty();
    }
    paragraphs
}

/// The words of a text in lower case, with [`CLAUSE_END`] where a clause ends.
fn words(text: &str) -> Vec<&str> {
    let mut words = Vec::new();
    for word in text.split_whitespace() {
        words.push(word.trim_matches(|c: char| !(c.is_alphanumeric() || c == '_')));
        words.extend(word.ends_with([',', '.', ';', ':']).then_some(CLAUSE_END));
    }
    words
}

/// A phrase within one clause. `takes/took` in it is one of these words, `...` is up to [`GAP_MAX`] words.
struct Phrase(Vec<PhrasePart>);

/// A part of a phrase.
enum PhrasePart {
    /// One of these words.
    Word(Vec<String>),
    /// Up to [`GAP_MAX`] words.
    Gap,
}

impl Phrase {
    fn parse(text: &str) -> Self {
        let part = |part| match part {
            "..." => PhrasePart::Gap,
            forms => PhrasePart::Word(forms.split('/').map(str::to_owned).collect()),
        };
        Self(text.split_whitespace().map(part).collect())
    }

    /// Whether the words contain the phrase.
    fn is_in(&self, words: &[&str]) -> bool {
        (0..words.len()).any(|first| begins_with(&words[first..], &self.0))
    }
}

fn begins_with(words: &[&str], phrase: &[PhrasePart]) -> bool {
    match phrase {
        [] => true,
        [PhrasePart::Gap, rest @ ..] => {
            let clause = words.iter().take(GAP_MAX).take_while(|word| **word != CLAUSE_END).count();
            (0..=clause).any(|gap| begins_with(&words[gap..], rest))
        }
        [PhrasePart::Word(forms), rest @ ..] => {
            let is_next = |word: &&str| forms.iter().any(|form| form == word);
            words.first().is_some_and(is_next) && begins_with(&words[1..], rest)
        }
    }
}

#[test]
fn phrases_are_found_across_lines_and_in_each_form() {
    let text = "fn a() {}\n    /// It Takes the\n    /// closure (back).\n    back();\n";
    let passages = passages(text);
    assert_eq!(passages.iter().map(|(number, _)| *number).collect::<Vec<_>>(), [1, 2, 4]);
    let contains = |text: &str, phrase| Phrase::parse(phrase).is_in(&words(&text.to_lowercase()));
    assert!(contains(&passages[1].1, "take/takes ... back"));
    assert!(!contains(&passages[1].1, "take/took ... back"));
    for other in [
        "it takes long, so the back end",
        "it takes them. Back",
        "takes one or two or three back",
        "retakes it back",
    ] {
        assert!(!contains(other, "takes ... back"), "{other}");
    }
}
