//! The bench's table: each figure with its limit.

use serde::Serialize;

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    name: String,
    value: f64,
    /// A second figure: a median beside a minimum, a count beside a share.
    beside: f64,
    limit: Option<Limit>,
    met: bool,
    note: String,
}

#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
enum Limit {
    AtMost(f64),
    AtLeast(f64),
}

impl Row {
    /// A figure without a limit.
    pub fn new(name: impl Into<String>, value: f64, beside: f64) -> Self {
        Self { name: name.into(), value, beside, limit: None, met: true, note: String::new() }
    }

    /// Sets the largest value that passes.
    pub fn at_most(self, limit: f64) -> Self {
        Self { met: self.value <= limit, limit: Some(Limit::AtMost(limit)), ..self }
    }

    /// Sets the least value that passes.
    pub fn at_least(self, limit: f64) -> Self {
        Self { met: self.value >= limit, limit: Some(Limit::AtLeast(limit)), ..self }
    }

    /// Adds a remark.
    pub fn note(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }
}

/// Sections of rows, printed as they are added.
#[derive(Default)]
pub struct Table {
    sections: Vec<(String, Vec<Row>)>,
    not_checked: Vec<String>,
}

impl Table {
    /// Begins a section. `value` and `beside` are the headings of its columns: quantity and unit.
    pub fn begin(&mut self, name: &str, value: &str, beside: &str) {
        println!("\n{name:<58} {value:>12} {beside:>12}   limit");
        self.sections.push((name.into(), Vec::new()));
    }

    /// Adds a row to the newest section.
    pub fn add(&mut self, row: Row) {
        let limit = match row.limit {
            Some(Limit::AtMost(limit)) => format!("<= {limit}"),
            Some(Limit::AtLeast(limit)) => format!(">= {limit}"),
            None => String::new(),
        };
        let verdict = if row.met { "" } else { "  MISSED" };
        let number = |value: f64| if value.is_nan() { "-".into() } else { format!("{value:.3}") };
        let (value, beside) = (number(row.value), number(row.beside));
        println!("{:<58} {value:>12} {beside:>12}   {limit}{verdict} {}", row.name, row.note);
        if let Some((_, rows)) = self.sections.last_mut() {
            rows.push(row);
        }
    }

    /// Records data that is missing, so that the gate cannot pass in silence.
    pub fn not_checked(&mut self, what: String) {
        self.not_checked.push(what);
    }

    /// The last line of a run that lacked data; `None` if nothing was missing.
    pub fn absent(&self) -> Option<String> {
        (!self.not_checked.is_empty()).then(|| format!("not checked: {}", self.not_checked.join(", ")))
    }

    /// Whether every limit is met.
    pub fn met(&self) -> bool {
        self.sections.iter().flat_map(|(_, rows)| rows).all(|row| row.met)
    }

    /// The table as JSON.
    pub fn json(&self) -> serde_json::Value {
        let section =
            |(name, rows): &(String, Vec<Row>)| serde_json::json!({ "section": name, "rows": rows });
        serde_json::json!({ "met": self.met(), "sections": self.sections.iter().map(section).collect::<Vec<_>>() })
    }
}
