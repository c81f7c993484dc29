//! Finds the line of a TOML file that an error is about.

use std::path::Path;

use anyhow::Error;
use toml::de::{DeTable, DeValue};

/// Adds the file to an error that was found after parsing it, and the line if the message starts with
/// something in the file: a key, or a name such as `plant.theta`.
pub fn locate(error: Error, file: &Path, text: &str) -> Error {
    let message = format!("{error:#}");
    let message = message.strip_prefix("component ").unwrap_or(&message);
    let name = message.split([' ', ':', ',']).next().unwrap_or_default();
    let file = file.display();
    match line(text, name) {
        Some(line) => error.context(format!("{file}:{line}")),
        None => error.context(file.to_string()),
    }
}

/// The line of the first key or string that has this word.
fn line(text: &str, word: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let offset = in_table(document.get_ref(), word)?;
    Some(1 + text.get(..offset)?.matches('\n').count())
}

fn in_table(table: &DeTable<'_>, word: &str) -> Option<usize> {
    let offsets = table.iter().filter_map(|(key, value)| match key.get_ref() {
        key_text if key_text == word => Some(key.span().start),
        _ => in_value(value.get_ref(), value.span().start, word),
    });
    offsets.min()
}

fn in_value(value: &DeValue<'_>, start: usize, word: &str) -> Option<usize> {
    match value {
        DeValue::String(text) => text
            .split_whitespace()
            .any(|part| part == word)
            .then_some(start),
        DeValue::Table(table) => in_table(table, word),
        DeValue::Array(values) => values
            .iter()
            .find_map(|value| in_value(value.get_ref(), value.span().start, word)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::anyhow;

    #[test]
    fn an_error_names_the_line_of_what_it_is_about() {
        let text = "stop = 1.0\nconnections = [\n  'a.y -> b.u',\n]\n[[component]]\nname = 'a'\n\
                    [[component]]\nname = 'b'\nstart = { k = 1 }\n";
        let located = |message: &'static str| {
            let error = locate(anyhow!(message), Path::new("f.toml"), text);
            format!("{error:#}")
        };
        for (message, line) in [
            ("stop = inf, expected a finite number", 1),
            ("b.u is connected twice", 3),
            ("component b: no such file", 8),
            ("k = 1 is wrong", 9),
        ] {
            assert_eq!(located(message), format!("f.toml:{line}: {message}"));
        }
        assert_eq!(located("step is missing"), "f.toml: step is missing");
    }
}
