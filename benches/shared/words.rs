//! The words of a bench's command line.

#![allow(dead_code, reason = "not all benches that share this have numbers or flags")]

use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fmt::Display;
use std::str::FromStr;

/// Name of the file for the report.
const JSON: &str = "--json";

/// Options of a bench: values by their names, and flags.
pub struct Words {
    values: BTreeMap<String, String>,
    flags: BTreeSet<String>,
}

impl Words {
    /// Reads the words behind the program's name. `values` are the names that a value follows, `--json` beside them; `flags` stand
    /// alone.
    ///
    /// # Errors
    /// Says which word is not known, or has no value, and what is expected.
    pub fn parse(words: &[String], values: &[&str], flags: &[&str]) -> Result<Self, String> {
        let mut found = Self { values: BTreeMap::new(), flags: BTreeSet::new() };
        let mut rest = words.iter();
        while let Some(word) = rest.next() {
            let name = word.as_str();
            if name == JSON || values.contains(&name) {
                let value = rest.next().ok_or(format!("{name} needs a value"))?;
                found.values.insert(word.clone(), value.clone());
            } else if flags.contains(&name) {
                found.flags.insert(word.clone());
            } else if name != "--bench" {
                // `cargo bench` passes `--bench` to every bench.
                let names = values.iter().copied().chain([JSON]).map(|name| format!("{name} VALUE"));
                let names = names.chain(flags.iter().map(ToString::to_string)).collect::<Vec<_>>();
                return Err(format!("{name}: expected {}", names.join(", ")));
            }
        }
        Ok(found)
    }

    /// Returns the value of this name.
    pub fn value(&self, name: &str) -> Option<&str> {
        self.values.get(name).map(String::as_str)
    }

    /// Returns the number of this name, or the default.
    ///
    /// # Errors
    /// The value is no such number.
    pub fn number<T: FromStr<Err: Display>>(&self, name: &str, default: T) -> Result<T, String> {
        let Some(text) = self.value(name) else { return Ok(default) };
        text.parse().map_err(|why| format!("{name} {text}: {why}"))
    }

    /// Returns whether the flag is given.
    pub fn has(&self, flag: &str) -> bool {
        self.flags.contains(flag)
    }

    /// Writes the report to the file that `--json` names, if it does.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_json(&self, report: &impl Serialize) -> Result<(), Box<dyn Error>> {
        if let Some(path) = self.value(JSON) {
            let text = serde_json::to_string_pretty(report)? + "\n";
            std::fs::write(path, text).map_err(|why| format!("{JSON} {path}: {why}"))?;
        }
        Ok(())
    }
}
