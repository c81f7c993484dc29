//! Names and descriptions.

use fmu_description::words::is_identifier;
use syn::{Attribute, Error, Expr, ExprLit, Lit, LitStr, Meta, Result};

/// The first paragraph of the doc comments as plain text, without backticks and a final period; `None`
/// if there is none.
pub fn description(attributes: &[Attribute]) -> Option<String> {
    let mut words = Vec::new();
    for attribute in attributes.iter().filter(|a| a.path().is_ident("doc")) {
        let Meta::NameValue(meta) = &attribute.meta else {
            continue;
        };
        let Expr::Lit(ExprLit {
            lit: Lit::Str(text),
            ..
        }) = &meta.value
        else {
            continue;
        };
        for line in text.value().split('\n') {
            let is_empty = line.trim().is_empty();
            if is_empty && !words.is_empty() {
                return finish(&words);
            }
            words.extend(line.split_whitespace().map(str::to_owned));
        }
    }
    finish(&words)
}

fn finish(words: &[String]) -> Option<String> {
    let text = words.join(" ").replace('`', "");
    let text = text.strip_suffix('.').unwrap_or(&text);
    (!text.is_empty()).then(|| text.to_owned())
}

/// Checks a structured name of FMI: identifiers separated by periods.
pub fn check(name: &LitStr) -> Result<()> {
    let text = name.value();
    if text.split('.').all(is_identifier) {
        return Ok(());
    }
    Err(Error::new(
        name.span(),
        format!(
            "{text:?} is not a name; expected letters, digits and underscores, with periods between parts"
        ),
    ))
}

/// Checks a C identifier.
pub fn check_identifier(name: &LitStr) -> Result<()> {
    let text = name.value();
    if is_identifier(&text) {
        return Ok(());
    }
    Err(Error::new(
        name.span(),
        format!("{text:?} is not a name; expected letters, digits and underscores"),
    ))
}

/// `TransferFunction` as `transfer_function`.
pub fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for (index, c) in name.chars().enumerate() {
        if c.is_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.extend(c.to_lowercase());
    }
    snake
}

#[cfg(test)]
mod tests {
    use super::*;
    use syn::parse_quote;

    #[test]
    fn descriptions_are_the_first_paragraph_without_its_period() {
        let item: syn::ItemStruct = parse_quote! {
            /// An amplifier,
            /// with a `gain`.
            ///
            /// More.
            struct Gain;
        };
        let text = description(&item.attrs);
        assert_eq!(text.as_deref(), Some("An amplifier, with a gain"));
        assert_eq!(description(&[]), None);
    }

    #[test]
    fn variants_become_names_in_snake_case() {
        assert_eq!(snake_case("TransferFunction"), "transfer_function");
        assert_eq!(snake_case("Own"), "own");
    }
}
