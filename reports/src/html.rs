//! The HTML file: headings, tables and pictures, without anything from elsewhere.

use std::fmt::Write as _;

/// Style of the page. It follows the reader's font size and prints on paper.
const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;color:#1c1c1c;background:#fff;max-width:1560px;margin:0 auto;padding:24px}\
h1{font-size:26px;margin:0 0 4px}h2{font-size:19px;margin:32px 0 10px;border-bottom:1px solid #ddd;padding-bottom:4px}\
.sub{color:#555;margin:0 0 12px}table{border-collapse:collapse;margin:8px 0}\
th,td{text-align:left;padding:4px 18px 4px 0;border-bottom:1px solid #eee;vertical-align:top}\
th{font-weight:600;border-bottom:2px solid #bbb}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}\
.plots{display:flex;flex-wrap:wrap;gap:16px;align-items:flex-start}figure{margin:0}figcaption{font-weight:600;margin:0 0 4px}\
.map{border:1px solid #ddd;max-width:100%;height:auto}.nodata{color:#777;font-style:italic}\
.note{color:#555;max-width:80ch}";

/// A row of a table: cells as text; those after the first are aligned to the right if they are numbers.
pub type Row = Vec<String>;

/// A page that is being written.
pub struct Page(String);

impl Page {
    /// Begins a page with a title and a line below it.
    pub fn new(title: &str, subtitle: &str) -> Self {
        let (title, subtitle) = (escape(title), escape(subtitle));
        Self(format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\
             <meta name=\"viewport\" content=\"width=device-width\"><style>{STYLE}</style></head><body>\n\
             <h1>{title}</h1><p class=\"sub\">{subtitle}</p>\n"
        ))
    }

    /// Begins a part of a page, which [`Page::add_part`] adds to one.
    pub fn part() -> Self {
        Self(String::new())
    }

    /// Adds a part, which [`Page::into_part`] returned.
    pub fn add_part(&mut self, part: &str) {
        self.0 += part;
    }

    /// Returns what was added since [`Page::part`].
    pub fn into_part(self) -> String {
        self.0
    }

    /// Adds a heading.
    pub fn heading(&mut self, text: &str) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "<h2>{}</h2>", escape(text));
    }

    /// Adds a paragraph.
    pub fn paragraph(&mut self, text: &str) {
        let _ = writeln!(self.0, "<p class=\"note\">{}</p>", escape(text));
    }

    /// Adds a table.
    pub fn table(&mut self, heads: &[&str], rows: &[Row]) {
        let class = |column: usize| if column == 0 { "" } else { " class=\"n\"" };
        self.0 += "<table><tr>";
        for (column, head) in heads.iter().enumerate() {
            let _ = write!(self.0, "<th{}>{}</th>", class(column), escape(head));
        }
        self.0 += "</tr>\n";
        for row in rows {
            self.0 += "<tr>";
            for (column, cell) in row.iter().enumerate() {
                let _ = write!(self.0, "<td{}>{}</td>", class(column), escape(cell));
            }
            self.0 += "</tr>\n";
        }
        self.0 += "</table>\n";
    }

    /// Adds plots and maps, which are HTML already, side by side.
    pub fn pictures(&mut self, pictures: &[(String, String)]) {
        self.0 += "<div class=\"plots\">";
        for (caption, picture) in pictures {
            let caption = if caption.is_empty() {
                String::new()
            } else {
                format!("<figcaption>{}</figcaption>", escape(caption))
            };
            let _ = writeln!(self.0, "<figure>{caption}{picture}</figure>");
        }
        self.0 += "</div>\n";
    }

    /// Ends the page.
    pub fn finish(self) -> String {
        self.0 + "</body></html>\n"
    }
}

/// Replaces characters that mean something in HTML.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_from_outside_are_text_and_nothing_else() {
        let mut page = Page::new("<script>", "room \"a\" & b");
        page.table(&["robot", "m"], &[vec!["<img>".into(), "1".into()]]);
        let html = page.finish();
        assert!(!html.contains("<script>") && !html.contains("<img>"), "{html}");
        assert!(!html.contains("http:") && !html.contains("src="), "nothing is loaded from elsewhere");
    }
}
