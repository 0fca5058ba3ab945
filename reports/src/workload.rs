//! Workload of the people who drove: answers to the raw NASA-TLX form, and their table.

use crate::html::{Page, Row};
use bridge::TlxAnswer;
use serde::{Deserialize, Serialize};

/// An answer to the form, and when it came.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TlxEntry {
    /// Time of the run, seconds.
    pub time_s: f64,
    /// The six ratings.
    pub answer: TlxAnswer,
}

/// Adds the table of the answers, or that there is no data.
pub fn add_workload(page: &mut Page, entries: &[TlxEntry]) {
    page.heading("Workload: raw NASA-TLX");
    if entries.is_empty() {
        page.paragraph("no data: nobody filled in the form, /tlx on the operator's page");
        return;
    }
    let mut heads = vec!["person"];
    heads.extend(TlxAnswer::SCALES);
    heads.push("raw TLX");
    let row = |(index, entry): (usize, &TlxEntry)| -> Row {
        let mut row = vec![(index + 1).to_string()];
        row.extend(entry.answer.ratings().map(|rating| rating.to_string()));
        row.push(format!("{:.1}", entry.answer.raw()));
        row
    };
    page.table(&heads, &entries.iter().enumerate().map(row).collect::<Vec<_>>());
    page.paragraph(
        "Ratings from 0 to 100 in steps of 5, without weights; raw TLX is their mean. Performance: 0 is perfect. Hart and \
         Staveland, Development of NASA-TLX, 1988.",
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_a_table_and_none_is_no_data_and_not_zero() {
        let mut page = Page::part();
        add_workload(&mut page, &[]);
        let html = page.into_part();
        assert!(html.contains("no data") && !html.contains("<table"), "{html}");
        let answer = TlxAnswer::parse(
            br#"{"mental_demand":70,"physical_demand":5,"temporal_demand":40,"performance":20,"effort":60,"frustration":0}"#,
        );
        let mut page = Page::part();
        add_workload(&mut page, &[TlxEntry { time_s: 60.0, answer: answer.unwrap() }]);
        let html = page.into_part();
        assert!(html.contains("<td class=\"n\">32.5</td>") && html.contains("frustration"), "{html}");
    }
}
