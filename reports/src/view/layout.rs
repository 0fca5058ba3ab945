//! Layout of text for a terminal: tables that drop columns, lines that wrap, and colours.

use std::fmt::Write;

/// Width of text that is not for a terminal, columns: a table with all its columns.
const PLAIN_WIDTH: usize = 112;
/// Smallest width that text is laid out for, columns.
const WIDTH_MIN: usize = 20;
/// Indent of the further lines of a row that does not fit as a table.
const NARROW_INDENT: usize = 2;
/// Gap between parts of a line that may be wrapped between them.
const GAP: &str = "   ";

/// How much a piece of text wants to be seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Emphasis {
    /// Ordinary text, in no colour.
    #[default]
    None,
    /// Somebody waits for an answer: yellow.
    Attention,
    /// Something is wrong: bold red.
    Alarm,
}

/// Width and colours of the place where text is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Style {
    /// Width of the widest line, columns.
    pub width: usize,
    /// Whether colours may be used.
    pub is_coloured: bool,
}

impl Style {
    /// Style of a file or pipe: wide, without colours.
    pub const PLAIN: Self = Self { width: PLAIN_WIDTH, is_coloured: false };

    /// Returns text in the colour of its emphasis.
    pub fn paint(&self, text: &str, emphasis: Emphasis) -> String {
        let code = match emphasis {
            Emphasis::Attention if self.is_coloured => "33",
            Emphasis::Alarm if self.is_coloured => "1;31",
            _ => return text.to_owned(),
        };
        format!("\x1b[{code}m{text}\x1b[0m")
    }

    /// Wraps each line of a text; see [`Style::wrap`].
    pub fn wrap_lines(&self, text: &str, indent: usize) -> String {
        text.lines().map(|line| self.wrap(line, indent)).collect()
    }

    /// Formats rows of a name and two values below headings. Where the table does not fit, each row is a line that wraps, with the
    /// heading of the second value before it.
    pub fn value_table(&self, headings: [&str; 3], rows: &[[String; 3]]) -> String {
        let length = |text: &str| text.chars().count();
        let longest = |at: usize| {
            let names = rows.iter().map(|row| length(&row[at]));
            names.chain([length(headings[at])]).max().unwrap_or(0)
        };
        let [name_width, value_width, last_width] = [0, 1, 2].map(longest);
        let is_narrow = name_width + value_width + last_width + 2 > self.width;
        let line = |[name, value, last]: [&str; 3]| {
            format!("{name:<name_width$} {value:<value_width$} {last}").trim_end().to_owned() + "\n"
        };
        if !is_narrow {
            let rows = rows.iter().map(|row| line([0, 1, 2].map(|at| row[at].as_str())));
            return line(headings) + &rows.collect::<String>();
        }
        let mut text =
            if headings[0].is_empty() { String::new() } else { self.wrap(headings[0], NARROW_INDENT) };
        for [name, value, last] in rows {
            let last = if last.is_empty() { String::new() } else { format!("{GAP}{}: {last}", headings[2]) };
            text += &self.wrap(&format!("{name}: {value}{last}"), NARROW_INDENT);
        }
        text
    }

    /// Wraps a line at its gaps of three spaces, and at words where a part is too long. Further lines are indented.
    pub fn wrap(&self, line: &str, indent: usize) -> String {
        let width = self.width.max(WIDTH_MIN);
        let start = line.len() - line.trim_start().len();
        let (mut text, mut column, mut begin) = (" ".repeat(start), start, start);
        let mut put = |word: &str, gap: &str| {
            let length = word.chars().count();
            let is_begun = column > begin;
            if is_begun && column + gap.len() + length > width {
                text += &format!("\n{}", " ".repeat(indent));
                (column, begin) = (indent, indent);
            } else if is_begun {
                text += gap;
                column += gap.len();
            }
            text += word;
            column += length;
        };
        for part in line.trim().split(GAP).filter(|part| !part.trim().is_empty()) {
            let part = part.trim();
            if part.chars().count() + indent <= width {
                put(part, GAP);
            } else {
                let words = part.split_whitespace().enumerate();
                words.for_each(|(index, word)| put(word, if index == 0 { GAP } else { " " }));
            }
        }
        text.push('\n');
        text
    }
}

/// Column of a table.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Quantity and unit, one above the other.
    pub heading: [&'static str; 2],
    /// Width, columns; longer content moves the rest of its line.
    pub width: usize,
    /// Whether the content stands at the left.
    pub is_left: bool,
    /// Order in which columns are dropped where the terminal is narrow: the largest first, those of 0 never.
    pub drop_order: u8,
}

/// Content of a table at one row and column.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    text: String,
    emphasis: Emphasis,
}

impl Cell {
    /// Creates a cell that stands out if there is an alarm.
    pub fn alarm_if(alarm: bool, text: impl Into<String>) -> Self {
        Self { text: text.into(), emphasis: if alarm { Emphasis::Alarm } else { Emphasis::None } }
    }
}

impl<T: Into<String>> From<T> for Cell {
    fn from(text: T) -> Self {
        Self { text: text.into(), emphasis: Emphasis::None }
    }
}

/// Formats a table with as many columns as fit.
pub fn table(columns: &[Column], rows: &[Vec<Cell>], style: &Style) -> String {
    let mut shown: Vec<usize> = (0..columns.len()).collect();
    let width = |shown: &[usize]| shown.iter().map(|at| columns[*at].width + 1).sum::<usize>();
    // The last column needs no gap after it.
    while width(&shown) > style.width + 1
        && let Some(at) = shown
            .iter()
            .copied()
            .filter(|at| columns[*at].drop_order > 0)
            .max_by_key(|at| columns[*at].drop_order)
    {
        shown.retain(|kept| *kept != at);
    }
    let mut text = String::new();
    let mut put_row = |cells: &dyn Fn(usize) -> Cell| {
        let mut line = String::new();
        for at in &shown {
            let (Column { width, is_left, .. }, cell) = (columns[*at], cells(*at));
            let padded =
                if is_left { format!("{:<width$}", cell.text) } else { format!("{:>width$}", cell.text) };
            let gap = if line.is_empty() { "" } else { " " };
            let _ = write!(line, "{gap}{}", style.paint(&padded, cell.emphasis));
        }
        let _ = writeln!(text, "{}", line.trim_end());
    };
    for line in 0..2 {
        if columns.iter().any(|column| !column.heading[line].is_empty()) {
            put_row(&|at| columns[at].heading[line].into());
        }
    }
    for row in rows {
        put_row(&|at| row.get(at).cloned().unwrap_or_default());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn style(width: usize) -> Style {
        Style { width, is_coloured: false }
    }

    #[test]
    fn lines_wrap_at_gaps_and_then_at_words() {
        let line = "merged   room covered 81.2%   consistency 94.0% (98.1% within one cell)";
        assert_eq!(style(100).wrap(line, 9), format!("{line}\n"));
        let narrow = style(40).wrap(line, 9);
        let expected =
            ["merged   room covered 81.2%", "         consistency 94.0% (98.1% within", "         one cell)"];
        assert_eq!(narrow.lines().collect::<Vec<_>>(), expected);
        for width in 20..120 {
            assert!(style(width).wrap(line, 2).lines().all(|line| line.chars().count() <= width), "{width}");
        }
    }

    #[test]
    fn tables_of_values_become_lines_where_they_do_not_fit() {
        let rows = [["consistency", "94.1 %", "61.0 %"], ["shared area, mean of pairs", "12.3 m2", ""]];
        let rows = rows.map(|row| row.map(str::to_owned));
        let all = |width| style(width).value_table(["agreement", "this run", "by chance"], &rows);
        assert_eq!(
            all(80),
            "agreement                  this run by chance\nconsistency                94.1 %   61.0 %\n\
             shared area, mean of pairs 12.3 m2\n"
        );
        assert_eq!(
            all(39),
            "agreement\nconsistency: 94.1 %   by chance: 61.0 %\nshared area, mean of pairs: 12.3 m2\n"
        );
        for width in 20..60 {
            assert!(all(width).lines().all(|line| line.chars().count() <= width), "{width}: {}", all(width));
        }
    }

    #[test]
    fn narrow_tables_drop_columns_in_their_order() {
        let column =
            |heading, drop_order| Column { heading: [heading, ""], width: 6, is_left: true, drop_order };
        let columns = [column("robot", 0), column("first", 2), column("last", 1)];
        let rows = [vec!["1".into(), "2".into(), Cell::alarm_if(true, "3")]];
        assert_eq!(table(&columns, &rows, &style(20)), "robot  first  last\n1      2      3\n");
        assert_eq!(table(&columns, &rows, &style(19)), "robot  last\n1      3\n");
        assert_eq!(table(&columns, &rows, &style(5)), "robot\n1\n");
        let coloured = table(&columns, &rows, &Style { width: 20, is_coloured: true });
        assert!(coloured.ends_with("\x1b[1;31m3     \x1b[0m\n"), "{coloured:?}");
    }
}
