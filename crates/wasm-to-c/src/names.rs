//! Names of Rust functions as identifiers in C.

use std::collections::HashSet;

/// The path of a function in Rust, from the symbol that the compiler made of it. Within angle brackets, types have only
/// their names.
pub fn rust_path(symbol: &str) -> String {
    // LLVM adds numbers to the symbols of functions that it copies.
    let symbol =
        symbol.trim_end_matches(|c: char| c.is_ascii_digit()).strip_suffix('.').unwrap_or(symbol);
    let path = format!("{:#}", rustc_demangle::demangle(symbol));
    let (mut text, mut depth, mut begin) = (String::new(), 0, 0);
    for (i, c) in path.char_indices() {
        match c {
            '<' => depth += 1,
            '>' if !path[..i].ends_with('-') => depth -= 1,
            _ => {}
        }
        text.push(c);
        if depth > 0 && text.ends_with("::") {
            text.truncate(begin);
        }
        if !c.is_alphanumeric() && c != '_' && c != ':' {
            begin = text.len();
        }
    }
    text
}

/// Turns paths into identifiers, each of which is made once.
pub struct Identifiers {
    used: HashSet<String>,
}

impl Identifiers {
    /// Avoids `reserved`.
    pub fn new<'a>(reserved: impl Iterator<Item = &'a str>) -> Self {
        Identifiers { used: reserved.map(str::to_owned).collect() }
    }

    /// An identifier of the last parts of a path.
    pub fn of_path(&mut self, path: &str) -> String {
        let mut parts = segments(path);
        let last = parts.split_off(parts.len().saturating_sub(3));
        // A name of one part may be one of the C library, or a keyword.
        let name = match last.as_slice() {
            [] => "function".to_owned(),
            [name] => format!("rust_{name}"),
            // A long name says enough, and no function of the C library has it.
            [.., name] if name.len() >= 10 && name.contains('_') => name.clone(),
            [_, end @ ..] if last.join("_").len() > 24 => end.join("_"),
            _ => last.join("_"),
        };
        let name = if name.starts_with(|c: char| c.is_ascii_digit() || c == '_') {
            format!("f{name}")
        } else {
            name
        };
        self.unique(name)
    }

    /// The name, with a number if it is in use.
    pub fn unique(&mut self, name: String) -> String {
        let unique = (2..)
            .map(|number| format!("{name}_{number}"))
            .find(|numbered| !self.used.contains(numbered))
            .filter(|_| self.used.contains(&name))
            .unwrap_or(name);
        self.used.insert(unique.clone());
        unique
    }
}

/// A name with an underscore for each run of characters that identifiers in C cannot have.
pub fn sanitized(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_")
}

/// The parts of a path without generic arguments; of `<Type as Trait>`, the last part of the type.
fn segments(path: &str) -> Vec<String> {
    let mut parts = Vec::new();
    for part in split(path, "::") {
        let part = match part.strip_prefix('<').and_then(|rest| rest.strip_suffix('>')) {
            // The arguments of a function follow its name, as in `name::<u8>`.
            Some(_) if !parts.is_empty() => continue,
            Some(qualified) => segments(split(qualified, " as ")[0]).pop().unwrap_or_default(),
            None => sanitized(part.split('<').next().unwrap_or(part)),
        };
        if !part.is_empty() {
            parts.push(part);
        }
    }
    parts
}

/// Splits at a separator outside of angle brackets.
fn split<'a>(text: &'a str, separator: &str) -> Vec<&'a str> {
    let (mut parts, mut depth, mut begin) = (Vec::new(), 0, 0);
    for (i, c) in text.char_indices() {
        match c {
            '<' => depth += 1,
            '>' if !text[..i].ends_with('-') => depth -= 1,
            _ if depth == 0 && i >= begin && text[i..].starts_with(separator) => {
                parts.push(&text[begin..i]);
                begin = i + separator.len();
            }
            _ => {}
        }
    }
    parts.push(&text[begin.min(text.len())..]);
    parts
}

/// Whether an identifier is in the text.
pub fn mentions(text: &str, identifier: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.match_indices(identifier).any(|(i, _)| {
        !text[..i].ends_with(is_part) && !text[i + identifier.len()..].starts_with(is_part)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_are_the_last_parts_of_paths() {
        let mut identifiers = Identifiers::new(["f64_bits"].into_iter());
        let cases = [
            ("_RNvCs1234_7control4step", "control_step"),
            ("_ZN11fmu_control4fast10plain_step17h0123456789abcdefE", "plain_step"),
            ("_ZN3pid4step17h0123456789abcdefE.12", "pid_step"),
            ("<pid::Pid as core::fmt::Debug>::fmt", "Pid_fmt"),
            ("<pid::Pid as core::fmt::Debug>::fmt", "Pid_fmt_2"),
            ("values::<impl Instance<dyn Any>>::get::{{closure}}", "values_get_closure"),
            ("f64::bits", "f64_bits_2"),
            ("memcpy", "rust_memcpy"),
            ("", "function"),
            ("<>::>><", "function_2"),
        ];
        for (symbol, identifier) in cases {
            assert_eq!(identifiers.of_path(&rust_path(symbol)), identifier, "{symbol}");
        }
    }

    #[test]
    fn types_in_brackets_have_only_their_names() {
        let path = "<alloc::vec::Vec<core::option::Option<u8>> as core::ops::Drop>::drop";
        assert_eq!(rust_path(path), "<Vec<Option<u8>> as Drop>::drop");
    }
}
