//! The words of a bench's command line.

/// Fails at a word that the bench does not know: `values` are followed by a value, `flags` stand alone.
///
/// # Errors
/// Says which word is wrong, and which are expected.
pub fn check(words: &[String], values: &[&str], flags: &[&str]) -> Result<(), String> {
    let mut rest = words.iter().skip(1).map(String::as_str);
    while let Some(word) = rest.next() {
        let is_value = values.contains(&word);
        // `cargo bench` passes `--bench` to every bench.
        let is_known = is_value || flags.contains(&word) || word == "--bench";
        if !is_known || (is_value && rest.next().is_none()) {
            let values: Vec<String> = values.iter().map(|name| format!("{name} VALUE")).collect();
            return Err(format!(
                "{word}: expected {}",
                [&values.join(", "), ", ", &flags.join(", ")].concat()
            ));
        }
    }
    Ok(())
}
