//! The names in a package. OMSimulator requires identifiers.

use anyhow::{Result, bail};

/// The name in a package: other characters than ASCII letters, digits and `_` become `_`, and `c_` comes
/// before one that does not begin with a letter.
pub fn identifier(name: &str) -> String {
    let valid = name.replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    match valid.chars().next() {
        Some(first) if first.is_ascii_alphabetic() => valid,
        _ => format!("c_{valid}"),
    }
}

/// The names of components in a package.
///
/// # Errors
/// Two of them would be equal.
pub fn distinct(names: &[&str]) -> Result<Vec<String>> {
    let converted: Vec<String> = names.iter().map(|name| identifier(name)).collect();
    for (i, name) in converted.iter().enumerate() {
        if let Some(other) = converted[..i].iter().position(|known| known == name) {
            bail!(
                "the components {:?} and {:?} would both have the name {name} in the package; rename one",
                names[other],
                names[i]
            );
        }
    }
    Ok(converted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_identifiers() {
        for (name, expected) in [
            ("supervisor_plant", "supervisor_plant"),
            ("pid-rbf", "pid_rbf"),
            ("2nd stage", "c_2nd_stage"),
            ("_a", "c__a"),
            ("Régler", "R_gler"),
            ("", "c_"),
        ] {
            assert_eq!(identifier(name), expected);
        }
    }

    #[test]
    fn names_that_would_be_equal_are_rejected() {
        assert_eq!(distinct(&["a-b", "a b2"]).unwrap(), ["a_b", "a_b2"]);
        let error = distinct(&["a-b", "c", "a b"]).unwrap_err().to_string();
        assert!(error.contains(r#""a-b" and "a b" would both have the name a_b"#));
    }
}
